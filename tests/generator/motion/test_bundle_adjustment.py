"""Bundle adjustment on points whose motion is known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from olt_generator.motion.bundle_adjustment import FeatureTracks, StepPriors, adjust_poses, track_residuals
from olt_generator.poses import invert, make_pose

KEYFRAMES, POINTS = 12, 300
RAY_SIGMA = 5e-4


def true_poses():
    """A camera that drives ahead, turns to the right and pitches."""
    k = np.arange(KEYFRAMES)
    turned = Rotation.from_euler("YX", np.stack([0.02 * k, 0.01 * np.sin(k)], axis=-1)).as_matrix()
    poses = make_pose(turned, np.stack([0.06 * k**2 / KEYFRAMES, 0.02 * np.sin(k), 1.0 * k], axis=-1))
    return invert(poses[0]) @ poses


def observe(poses, random, wrong=0.0, noise=0.3):
    """Tracks of random points, each followed over five keyframes; a share of the observations is nonsense."""
    anchor = random.integers(0, KEYFRAMES - 3, POINTS)
    ray = random.normal(size=(POINTS, 3)) * [0.6, 0.4, 0.0] + [0.0, 0.0, 1.0]
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    place = poses[anchor, :3, 3] + random.uniform(6.0, 60.0, POINTS)[:, None] * np.einsum(
        "nij,nj->ni", poses[anchor, :3, :3], ray
    )
    point, later = (array.ravel() for array in np.meshgrid(np.arange(POINTS), np.arange(1, 5), indexing="ij"))
    frame = anchor[point] + later
    point, frame = point[frame < KEYFRAMES], frame[frame < KEYFRAMES]
    seen = np.einsum("nji,nj->ni", poses[frame, :3, :3], place[point] - poses[frame, :3, 3])
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    seen += noise * RAY_SIGMA * random.normal(size=seen.shape)
    lost = random.random(len(seen)) < wrong
    seen[lost] += 0.05 * random.normal(size=(np.count_nonzero(lost), 3))
    return FeatureTracks(anchor, ray, point, frame, seen / np.linalg.norm(seen, axis=1, keepdims=True))


def disturb(poses, random):
    steps = invert(poses[:-1]) @ poses[1:]
    error = make_pose(
        Rotation.from_rotvec(0.002 * random.normal(size=(len(steps), 3))).as_matrix(),
        0.02 * random.normal(size=(len(steps), 3)),
    )
    chained = [np.eye(4)]
    for step in steps @ error:
        chained.append(chained[-1] @ step)
    return np.stack(chained)


def priors_of(poses, speed_share=0.05):
    steps = invert(poses[:-1]) @ poses[1:]
    length = np.linalg.norm(steps[:, :3, 3], axis=1)
    sigmas = np.full(len(steps), 0.005), speed_share * length + 1e-3, 0.05 * length + 1e-3
    return StepPriors(steps, *sigmas)


def shape_error(poses, true):
    """Largest distance of a position from the true one once both paths have the same length."""
    scale = np.linalg.norm(true[-1, :3, 3]) / np.linalg.norm(poses[-1, :3, 3])
    return np.linalg.norm(scale * poses[:, :3, 3] - true[:, :3, 3], axis=1).max()


@pytest.mark.parametrize("wrong", [0.0, 0.25])
def test_disturbed_poses_come_back(wrong):
    random = np.random.default_rng(3)
    true = true_poses()
    start = disturb(true, random)
    found = adjust_poses(start, observe(true, random, wrong), RAY_SIGMA, priors_of(start), rounds=10).poses
    turn = Rotation.from_matrix(np.swapaxes(true[:, :3, :3], -1, -2) @ found[:, :3, :3]).magnitude()
    assert shape_error(found, true) < 0.1 * shape_error(start, true)
    assert turn.max() < 3e-4
    assert np.array_equal(found[0], np.eye(4))


def test_true_poses_stay():
    random = np.random.default_rng(4)
    true = true_poses()
    found = adjust_poses(true, observe(true, random), RAY_SIGMA, priors_of(true), rounds=10).poses
    assert np.allclose(found, true, atol=0.01)


def test_the_scale_is_that_of_the_steps_given():
    random = np.random.default_rng(5)
    true = true_poses()
    stretched = true.copy()
    stretched[:, :3, 3] *= 1.3
    found = adjust_poses(stretched, observe(true, random), RAY_SIGMA, priors_of(stretched), rounds=10).poses
    assert np.linalg.norm(found[-1, :3, 3]) == pytest.approx(np.linalg.norm(stretched[-1, :3, 3]), rel=0.01)


def test_no_rounds_change_nothing():
    random = np.random.default_rng(6)
    start = disturb(true_poses(), random)
    found = adjust_poses(start, observe(true_poses(), random), RAY_SIGMA, priors_of(start), rounds=0).poses
    assert np.array_equal(found, start)


def test_without_tracks_the_steps_decide():
    start = disturb(true_poses(), np.random.default_rng(7))
    nothing = np.zeros(0, np.int64)
    tracks = FeatureTracks(nothing, np.zeros((0, 3)), nothing, nothing, np.zeros((0, 3)))
    assert np.allclose(adjust_poses(start, tracks, RAY_SIGMA, priors_of(start), rounds=5).poses, start, atol=1e-9)


def test_the_stated_covariance_of_rotations_covers_their_errors():
    true, squares = true_poses(), []
    for seed in range(15):
        random = np.random.default_rng(seed)
        # What was known beforehand errs as it says.
        start = disturb(true, random)
        sigma = np.full(KEYFRAMES - 1, 0.002), np.full(KEYFRAMES - 1, 0.02), np.full(KEYFRAMES - 1, 0.02)
        priors = StepPriors(invert(start[:-1]) @ start[1:], *sigma)
        found = adjust_poses(start, observe(true, random, noise=1.0), RAY_SIGMA, priors, rounds=10)
        errors = Rotation.from_matrix(found.poses[:, :3, :3] @ np.swapaxes(true[:, :3, :3], -1, -2)).as_rotvec()
        turned = errors[1:].ravel()
        squares.append(turned @ np.linalg.solve(found.rotation_covariance[3:, 3:], turned) / len(turned))
        assert not found.rotation_covariance[:3].any()
    assert 0.7 < np.sqrt(np.mean(squares)) < 1.3


def test_distances_are_those_of_the_points():
    true, random = true_poses(), np.random.default_rng(8)
    tracks = observe(true, random, noise=0.0)
    found = adjust_poses(true, tracks, RAY_SIGMA, priors_of(true), rounds=3)
    assert np.abs(track_residuals(found, tracks, RAY_SIGMA)).max() < 1e-2
    seen = np.unique(tracks.point)
    assert 1.0 / found.inverse_distance[seen].max() > 5.9
    assert 1.0 / found.inverse_distance[seen].min() < 60.1


def test_residuals_are_in_sigmas_of_a_ray():
    true, random = true_poses(), np.random.default_rng(9)
    tracks = observe(true, random, noise=1.0)
    found = adjust_poses(true, tracks, RAY_SIGMA, priors_of(true), rounds=5)
    assert np.sqrt(np.mean(track_residuals(found, tracks, RAY_SIGMA) ** 2)) == pytest.approx(1.0, abs=0.1)
