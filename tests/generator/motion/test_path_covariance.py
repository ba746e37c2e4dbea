"""Drift that is added up along a path, held against paths that were disturbed so."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from olt_generator.motion.path_covariance import (
    TURN_SHARE,
    UNSEEN_SPEED,
    USUAL_SLIP,
    add_up_drift,
    roll_on,
    turning_drift,
)

POSES, DRAWN = 8, 20_000


def bent_path():
    """Positions (POSES, 3) of a drive that turns and climbs."""
    heading = 0.15 * np.arange(POSES - 1)
    steps = 2.0 * np.stack([np.cos(heading), np.sin(heading), 0.05 * np.ones(POSES - 1)], axis=-1)
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def random_covariance(size, spread, random):
    """A full covariance matrix of this size, errors of about `spread` that go together."""
    root = random.standard_normal((size, size)) / np.sqrt(size)
    return spread**2 * root @ root.T


def test_disturbed_paths_scatter_as_is_stated():
    random, positions = np.random.default_rng(0), bent_path()
    turns = np.zeros((3 * POSES, 3 * POSES))
    turns[3:, 3:] = random_covariance(3 * POSES - 3, 0.004, random)
    stretch = random_covariance(POSES - 1, 0.02, random)
    w = random.multivariate_normal(np.zeros(3 * POSES), turns, DRAWN).reshape(DRAWN, POSES, 3)
    e = random.multivariate_normal(np.zeros(POSES - 1), stretch, DRAWN)
    steps = np.broadcast_to(np.diff(positions, axis=0), (DRAWN, POSES - 1, 3))
    turned = Rotation.from_rotvec(w[:, :-1].reshape(-1, 3)).apply(steps.reshape(-1, 3)).reshape(steps.shape)
    ends = np.cumsum(np.exp(e)[..., None] * turned, axis=1)
    stated = add_up_drift(positions, turns, stretch)
    # The first step has an error along itself alone.
    for pose in range(2, POSES):
        sample = np.cov(np.concatenate([ends[:, pose - 1], w[:, pose]], axis=1).T)
        spread = np.sqrt(np.diag(stated[pose]))
        assert sample / np.outer(spread, spread) == pytest.approx(stated[pose] / np.outer(spread, spread), abs=0.04)
    assert not stated[0].any()


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(1e-4, 0.1))
def test_covariances_are_symmetric_and_positive(seed, spread):
    random = np.random.default_rng(seed)
    turns = random_covariance(3 * POSES, spread, random)
    found = add_up_drift(bent_path(), turns, random_covariance(POSES - 1, spread, random))
    assert found == pytest.approx(np.swapaxes(found, -1, -2), abs=1e-15)
    assert np.linalg.eigvalsh(found).min() > -1e-9 * np.trace(found[-1])


def test_a_common_error_of_scale_grows_with_the_distance():
    positions = np.zeros((5, 3))
    positions[:, 0] = 3.0 * np.arange(5)
    found = add_up_drift(positions, np.zeros((15, 15)), np.full((4, 4), 0.01**2))
    assert np.sqrt(found[:, 0, 0]) == pytest.approx(0.01 * positions[:, 0])
    independent = add_up_drift(positions, np.zeros((15, 15)), 0.01**2 * np.eye(4))
    assert independent[-1, 0, 0] == pytest.approx(4 * 0.03**2)


def test_a_vehicle_that_stands_may_roll_along_the_way_it_looks():
    times, forward = np.array([0.0, 1.0, 4.0]), np.array([0.6, 0.0, 0.8])
    found = roll_on(times, forward)
    assert not found[0].any() and not found[:, 3:].any()
    variance = np.einsum("i,nij,j->n", forward, found[:, :3, :3], forward)
    assert np.sqrt(variance) == pytest.approx(UNSEEN_SPEED * times)
    assert np.trace(found[2]) == pytest.approx(variance[2])


def test_steps_that_slip_may_all_turn_alike():
    moved, up = np.array([True, False, True]), np.array([0.0, -1.0, 0.0])
    assert not turning_drift(USUAL_SLIP, moved, up).any()
    found = turning_drift(USUAL_SLIP + 0.01, moved, up).reshape(4, 3, 4, 3)
    about_up = np.sqrt([found[pose, 1, pose, 1] for pose in range(4)])
    assert about_up == pytest.approx(TURN_SHARE * 0.01 * np.array([0, 1, 1, 2]))
    assert found[1, 1, 3, 1] == pytest.approx(about_up[1] * about_up[3]), "they err together"
    assert not found[:, [0, 2]].any()
