"""Relative motion of two views on points whose motion is known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from olt_generator.motion.two_view import TwoViewMotion, epipolar_sines, estimate_motion, parallax_forward

SIGMA = 1e-3


def make_rays(rotation, displacement, seed, far_share=0.0, outliers=0, noise=0.0, count=200):
    """Unit rays to the same points from both places; far points are seen in one direction from anywhere."""
    random = np.random.default_rng(seed)
    points = random.uniform([-15, -6, 4], [15, 3, 40], (count, 3))
    points[: int(far_share * count)] *= 1e6
    rays_a, rays_b = points, (points - displacement) @ rotation.as_matrix()
    rays_b = rays_b + noise * np.linalg.norm(rays_b, axis=1, keepdims=True) * random.standard_normal(rays_b.shape)
    if outliers:
        rays_b[-outliers:] = random.uniform([-10, -5, 5], [10, 5, 30], (outliers, 3))
    return tuple(rays / np.linalg.norm(rays, axis=1, keepdims=True) for rays in (rays_a, rays_b))


def angle(first, second):
    """Degrees between two lines: the direction of a motion holds up to its sign."""
    return np.degrees(np.arccos(min(abs(first @ second) / np.linalg.norm(second), 1.0)))


@settings(max_examples=20, deadline=None)
@given(
    turn=st.tuples(*[st.floats(-0.05, 0.05)] * 3),
    sideways=st.tuples(st.floats(-0.4, 0.4), st.floats(-0.2, 0.2)),
    forward=st.sampled_from([1.0, -1.0]),
    seed=st.integers(0, 100),
)
def test_exact_rays_give_the_exact_motion(turn, sideways, forward, seed):
    rotation = Rotation.from_rotvec(turn)
    displacement = np.array([*sideways, forward])
    motion = estimate_motion(*make_rays(rotation, displacement, seed), SIGMA)
    assert np.degrees((Rotation.from_matrix(motion.R_b_a) * rotation).magnitude()) < 1e-3
    assert angle(motion.direction_a, displacement) < 1e-2
    assert motion.inliers.all()


@pytest.mark.parametrize("seed", range(10))
def test_a_sky_full_of_points_does_not_bend_the_direction(seed):
    rays_a, rays_b = make_rays(Rotation.identity(), np.array([0.0, 0.0, 1.0]), seed, far_share=0.85)
    # Tracks of clouds close in by less than their noise: each votes, weakly, for driving backward.
    rays_b[:170, :2] *= 1.0 - 1e-4
    assert angle(estimate_motion(rays_a, rays_b, SIGMA).direction_a, np.array([0.0, 0.0, 1.0])) < 3.0


@settings(max_examples=30, deadline=None)
@given(st.tuples(*[st.floats(-0.05, 0.05)] * 3), st.sampled_from([1.0, -1.0]), st.integers(0, 1000))
def test_rays_to_what_stands_turn_as_the_motion_says(turn, forward, seed):
    rotation, displacement = Rotation.from_rotvec(turn), np.array([0.1, -0.05, forward])
    rays = make_rays(rotation, displacement, seed)
    direction = displacement / np.linalg.norm(displacement)
    true, opposite = (
        TwoViewMotion(rotation.inv().as_matrix(), sign * direction, np.ones(200, np.bool_)) for sign in (1.0, -1.0)
    )
    parallax = parallax_forward(true, *rays)
    assert parallax.min() > 0.0
    assert parallax_forward(opposite, *rays) == pytest.approx(-parallax)
    # With the turn taken out, a ray turns by the angle between where it points and where it did.
    between = np.linalg.norm(np.cross(rays[1], rotation.inv().apply(rays[0])), axis=1)
    assert parallax == pytest.approx(between, abs=1e-9)


def test_what_overtakes_a_driving_camera_turns_the_other_way():
    displacement = np.array([0.0, 0.0, 1.0])
    points = np.array([[3.0, 0.5, 12.0], [-3.0, 0.5, 12.0], [2.0, -1.0, 30.0]])
    moved = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 2.0], [0.0, 0.0, 1.0]])
    later = points + moved - displacement
    rays = [each / np.linalg.norm(each, axis=1, keepdims=True) for each in (points, later)]
    motion = TwoViewMotion(np.eye(3), displacement, np.ones(3, np.bool_))
    stands, overtakes, keeps_its_distance = parallax_forward(motion, *rays)
    assert stands > 0.01
    assert overtakes < -0.01
    assert keeps_its_distance == pytest.approx(0.0, abs=1e-12)


def test_a_quarter_of_outliers_is_left_out():
    rotation = Rotation.from_rotvec([0.0, 0.02, 0.0])
    displacement = np.array([0.1, 0.0, 1.0])
    rays_a, rays_b = make_rays(rotation, displacement, 3, outliers=50, noise=3e-4)
    motion = estimate_motion(rays_a, rays_b, SIGMA)
    assert np.degrees((Rotation.from_matrix(motion.R_b_a) * rotation).magnitude()) < 0.05
    assert angle(motion.direction_a, displacement) < 1.0
    assert motion.inliers[:150].mean() > 0.95
    assert motion.inliers[150:].mean() < 0.2


def test_epipolar_sine_is_the_distance_from_the_plane():
    rays_a, t = np.array([[0.0, 0.0, 1.0]]), np.array([1.0, 0.0, 0.0])
    tilted = np.array([[0.1, np.sin(0.02), np.cos(0.02)]])
    tilted[0, 1:] *= np.sqrt(1 - 0.01)
    expected = np.sqrt(1 - 0.01) * np.sin(0.02)
    assert np.abs(epipolar_sines(rays_a, tilted, np.eye(3), t)) == pytest.approx(expected)


def test_too_few_rays_give_nothing():
    rays = np.tile([[0.0, 0.0, 1.0]], (4, 1))
    assert estimate_motion(rays, rays, SIGMA) is None
