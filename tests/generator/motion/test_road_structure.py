"""Planes on which followed points lie, as seen from a camera that drives over a road of known height."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_generator.motion.bundle_adjustment import AdjustedPoses, FeatureTracks
from olt_generator.motion.road_structure import find_planes
from olt_generator.poses import camera_pose_in_rig

HEIGHT = 1.5
MOUNTING = camera_pose_in_rig([1.5, 0.0, HEIGHT], 0.0, 0.0, 0.0)
KEYFRAMES, STEP, RAY_SIGMA = 10, 0.8, 1e-3
POSES = np.tile(np.eye(4), (KEYFRAMES, 1, 1))
POSES[:, 2, 3] = STEP * np.arange(KEYFRAMES)
METRIC = np.ones(KEYFRAMES)


def place(random, count, low, high):
    """Points (count, 3) in camera axes between two corners."""
    return random.uniform(low, high, (count, 3))


def on_plane(random, count, down):
    """Points on a plane so far below (or above) the camera."""
    return place(random, count, [-3.0, down, 5.0], [3.0, down, 16.0])


def follow(points, moving=0.0):
    """Tracks of points found in the first keyframe and seen in four more; they drive by `moving` metres a step."""
    count = len(points)
    frame = np.tile(np.arange(1, 5), count)
    point = np.repeat(np.arange(count), 4)
    seen = points[point] + np.outer(moving * frame, [0.3, 0.0, 1.0]) - POSES[frame, :3, 3]
    distance = np.linalg.norm(points, axis=1)
    rays = seen / np.linalg.norm(seen, axis=1, keepdims=True)
    tracks = FeatureTracks(np.zeros(count, np.int64), points / distance[:, None], point, frame, rays)
    return tracks, AdjustedPoses(POSES, 1.0 / distance, np.zeros((3 * KEYFRAMES, 3 * KEYFRAMES)))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000), st.floats(0.3, 1.5))
def test_the_road_lies_one_camera_height_down_if_the_scale_is_right(seed, factor):
    tracks, adjusted = follow(on_plane(np.random.default_rng(seed), 100, HEIGHT))
    below, above = find_planes(tracks, adjusted, factor * METRIC, RAY_SIGMA, MOUNTING)
    assert below.place == pytest.approx(np.log(factor), abs=1e-6)
    assert below.share == 1.0
    assert below.share_at_road == float(abs(np.log(factor)) < 0.15)
    assert above is None


def test_scattered_points_lie_on_no_plane():
    random = np.random.default_rng(1)
    points = place(random, 300, [-3.0, 0.0, 5.0], [3.0, 3.0, 16.0])
    points[:, 1] = 0.1 * 40.0 ** random.random(300)
    below, _ = find_planes(*follow(points), METRIC, RAY_SIGMA, MOUNTING)
    assert below.share < 0.2


def test_above_and_below_are_told_apart():
    random = np.random.default_rng(2)
    points = np.concatenate([on_plane(random, 90, HEIGHT), on_plane(random, 60, -2.0 * HEIGHT)])
    below, above = find_planes(*follow(points), METRIC, RAY_SIGMA, MOUNTING)
    assert (below.points, above.points) == (90, 60)
    assert (below.place, above.place) == pytest.approx((0.0, np.log(2.0)), abs=1e-6)


def test_the_mounting_says_where_down_is():
    pitched = camera_pose_in_rig([1.5, 0.0, HEIGHT], 0.0, 0.1, 0.0)
    level = on_plane(np.random.default_rng(3), 100, HEIGHT)
    points = level @ (MOUNTING[:3, :3].T @ pitched[:3, :3])
    below, _ = find_planes(*follow(points), METRIC, RAY_SIGMA, pitched)
    assert below.place == pytest.approx(0.0, abs=1e-6) and below.share == 1.0


def test_what_moves_by_itself_and_what_does_not_turn_are_left_out():
    random = np.random.default_rng(4)
    road, vehicle = on_plane(random, 50, HEIGHT), on_plane(random, 50, 0.4)
    tracks, adjusted = follow(np.concatenate([road, vehicle]))
    drives_off, _ = follow(np.concatenate([road, vehicle]), moving=0.2)
    moves = tracks.point >= 50
    ray = np.where(moves[:, None], drives_off.ray, tracks.ray)
    below, _ = find_planes(replace(tracks, ray=ray), adjusted, METRIC, RAY_SIGMA, MOUNTING)
    assert (below.points, below.share) == (50, 1.0)
    # A camera that hardly moved tells no distance.
    still = replace(adjusted, poses=np.tile(np.eye(4), (KEYFRAMES, 1, 1)))
    standing = replace(tracks, ray=tracks.anchor_ray[tracks.point])
    assert find_planes(standing, still, METRIC, RAY_SIGMA, MOUNTING) == (None, None)


def test_a_few_points_are_no_plane():
    assert find_planes(*follow(on_plane(np.random.default_rng(5), 19, HEIGHT)), METRIC, RAY_SIGMA, MOUNTING) == (
        None,
        None,
    )
