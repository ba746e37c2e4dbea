"""Normal equations of poses and distances, held against dense matrices of differences."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from olt_generator.motion.bundle_adjustment import StepPriors, adjust_poses
from olt_generator.motion.track_equations import (
    INVERSE_DISTANCE_SIGMA,
    FeatureTracks,
    form_equations,
    sort_tracks,
)
from olt_generator.poses import invert, make_pose

KEYFRAMES, POINTS = 6, 20
RAY_SIGMA = 5e-4
STEP = 1e-6


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def make_tracks(seed):
    """Poses (n, 4, 4), inverse distances and noisy tracks of different lengths, in no order."""
    random = np.random.default_rng(seed)
    poses = make_pose(
        Rotation.from_rotvec(0.05 * random.normal(size=(KEYFRAMES, 3))).as_matrix(),
        np.arange(KEYFRAMES)[:, None] * [0.1, 0.0, 1.0] + 0.1 * random.normal(size=(KEYFRAMES, 3)),
    )
    anchor = random.integers(0, KEYFRAMES - 1, POINTS)
    ray = unit(random.normal(size=(POINTS, 3)) * [0.6, 0.4, 0.0] + [0.0, 0.0, 1.0])
    inverse_distance = 1.0 / random.uniform(4.0, 50.0, POINTS)
    seen = [(p, k) for p in range(POINTS) for k in range(anchor[p] + 1, KEYFRAMES) if random.random() < 0.7]
    point, frame = random.permutation(np.array(seen)).T
    start = poses[anchor[point]]
    place = start[:, :3, 3] + np.einsum("nij,nj->ni", start[:, :3, :3], ray[point]) / inverse_distance[point][:, None]
    towards = unit(np.einsum("nji,nj->ni", poses[frame, :3, :3], place - poses[frame, :3, 3]))
    towards = unit(towards + RAY_SIGMA * random.normal(size=towards.shape))
    return poses, inverse_distance, FeatureTracks(anchor, ray, point, frame, towards)


def move(poses, step):
    """Poses after errors (n, 6): rotation vectors and positions in world axes."""
    turned = Rotation.from_rotvec(step[:, :3]).as_matrix() @ poses[:, :3, :3]
    return make_pose(turned, poses[:, :3, 3] + step[:, 3:])


def plain_residuals(poses, inverse_distance, tracks):
    """Residuals (m, 2) in sigmas, in axes that stay fixed to the observing camera."""
    rows = []
    for point, frame, ray in zip(tracks.point, tracks.frame, tracks.ray, strict=True):
        start, here = poses[tracks.anchor[point]], poses[frame]
        place = start[:3, 3] + start[:3, :3] @ tracks.anchor_ray[point] / inverse_distance[point]
        across = np.linalg.svd(ray[None])[2][1:]
        rows.append(across @ unit(here[:3, :3].T @ (place - here[:3, 3])) / RAY_SIGMA)
    return np.array(rows)


def dense_jacobian(poses, inverse_distance, tracks):
    """Derivatives (2 m, 6 n + points) of the residuals, by differences."""
    columns = []
    for index in range(6 * len(poses) + len(inverse_distance)):
        change = np.zeros(6 * len(poses) + len(inverse_distance))
        change[index] = STEP
        step, shift = change[: 6 * len(poses)].reshape(-1, 6), change[6 * len(poses) :]
        ends = (
            plain_residuals(move(poses, sign * step), inverse_distance + sign * shift, tracks) for sign in (1.0, -1.0)
        )
        columns.append(np.subtract(*ends).ravel() / (2.0 * STEP))
    return np.stack(columns, axis=-1)


def dense_blocks(blocks):
    """The symmetric matrix (6 n, 6 n) of blocks (n, span, 6, 6) below its diagonal."""
    n, span = blocks.shape[:2]
    matrix = np.zeros((n, 6, n, 6))
    for key in range(n):
        for later in range(min(span, n - key)):
            matrix[key + later, :, key] = blocks[key, later]
            matrix[key, :, key + later] = blocks[key, later].T
    return matrix.reshape(6 * n, 6 * n)


@pytest.mark.parametrize("seed", range(2))
def test_equations_are_those_of_dense_matrices(seed):
    poses, inverse_distance, tracks = make_tracks(seed)
    tracks, number = sort_tracks(tracks)
    inverse_distance = inverse_distance[number]
    residual = plain_residuals(poses, inverse_distance, tracks)
    weight = np.repeat(1.0 / (1.0 + (residual**2).sum(axis=1)), 2)
    J = weight[:, None] * dense_jacobian(poses, inverse_distance, tracks)
    r = weight * residual.ravel()
    J_pose, J_distance = J[:, : 6 * KEYFRAMES], J[:, 6 * KEYFRAMES :]
    information = J_distance.T @ J_distance + INVERSE_DISTANCE_SIGMA**-2 * np.eye(POINTS)
    eliminated = J_pose.T @ J_distance @ np.linalg.inv(information)
    found, distances = form_equations(poses, inverse_distance, tracks, RAY_SIGMA)
    expected = J_pose.T @ J_pose - eliminated @ J_distance.T @ J_pose
    assert dense_blocks(found.blocks) == pytest.approx(expected, abs=1e-5 * np.abs(expected).max())
    gradient = J_pose.T @ r - eliminated @ J_distance.T @ r
    assert found.gradient.ravel() == pytest.approx(gradient, abs=1e-5 * np.abs(gradient).max())
    step = 1e-3 * np.random.default_rng(seed).normal(size=(KEYFRAMES, 6))
    change = -np.linalg.solve(information, J_distance.T @ (r + J_pose @ step.ravel()))
    assert distances.solve(step, tracks.anchor) == pytest.approx(change, rel=1e-4, abs=1e-8)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_order_of_observations_does_not_matter(seed):
    poses, _, tracks = make_tracks(seed % 50)
    random = np.random.default_rng(seed)
    points, seen = random.permutation(POINTS), random.permutation(len(tracks.point))
    renamed = np.argsort(points)
    shuffled = FeatureTracks(
        tracks.anchor[points],
        tracks.anchor_ray[points],
        renamed[tracks.point[seen]],
        tracks.frame[seen],
        tracks.ray[seen],
    )
    steps = invert(poses[:-1]) @ poses[1:]
    priors = StepPriors(steps, *np.full((3, KEYFRAMES - 1), 0.01))
    first, second = (adjust_poses(poses, each, RAY_SIGMA, priors, 3) for each in (tracks, shuffled))
    assert second.poses == pytest.approx(first.poses, abs=1e-9)
    assert second.inverse_distance == pytest.approx(first.inverse_distance[points], abs=1e-9)
    assert second.rotation_covariance == pytest.approx(first.rotation_covariance, rel=1e-6, abs=1e-15)
