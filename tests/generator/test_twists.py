"""Exponential and logarithm of SE(3)."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from olt_generator.twists import adjoint, cross_matrix, exponential, logarithm, right_jacobian

components = st.floats(-1.5, 1.5)
twists = st.tuples(*6 * [components]).map(np.array)
scales = st.sampled_from([1e-9, 1e-4, 9.9e-3, 1.1e-2, 0.3, 1.0])


@given(twists, scales)
def test_exponential_is_that_of_the_matrix(twist, scale):
    generator = np.zeros((4, 4))
    generator[:3, :3], generator[:3, 3] = cross_matrix(scale * twist[3:]), scale * twist[:3]
    np.testing.assert_allclose(exponential(scale * twist), expm(generator), atol=1e-13)


@given(twists, scales)
def test_logarithm_undoes_the_exponential(twist, scale):
    np.testing.assert_allclose(logarithm(exponential(scale * twist)), scale * twist, rtol=1e-9, atol=1e-13)


def test_half_turns_have_a_logarithm():
    half = np.array([1.0, 2.0, 3.0, 0.0, 0.0, np.pi])
    np.testing.assert_allclose(exponential(logarithm(exponential(half))), exponential(half), atol=1e-12)


@given(twists, twists)
def test_adjoint_carries_a_motion_to_other_axes(place, twist):
    pose = exponential(place)
    np.testing.assert_allclose(pose @ exponential(twist), exponential(adjoint(pose) @ twist) @ pose, atol=1e-10)


@given(twists, twists)
def test_right_jacobian_is_the_derivative(twist, direction):
    twist = 0.3 * twist
    step = 1e-6 * direction
    moved = logarithm(np.linalg.inv(exponential(twist)) @ exponential(twist + step))
    np.testing.assert_allclose(moved, right_jacobian(twist) @ step, atol=1e-9)
