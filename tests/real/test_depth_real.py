"""Distances on real recordings. The bounds are generous: what is reached is printed (`pytest -s`)."""

import cv2
import numpy as np
import pytest

from olt_generator.cameras import pixel_rays
from olt_generator.distance.depth import FAR_DISTANCE, DistanceOrigin, estimate_distance
from olt_generator.poses import invert, transform
from olt_toolkit import OpenOptions, open_recording

pytestmark = pytest.mark.slow


def visible_points(points_camera, camera):
    """Pixels (k, 2) and distances (k,) of LiDAR points that no clearly nearer point hides."""
    pixels, seen = camera.project(points_camera)
    distance = np.linalg.norm(points_camera, axis=1)
    column, row = np.rint(pixels[seen]).astype(int).T
    nearest = np.full((camera.height, camera.width), np.inf, np.float32)
    np.minimum.at(nearest, (row, column), distance[seen].astype(np.float32))
    surface = cv2.erode(nearest, np.ones((11, 11), np.uint8))
    kept = distance[seen] < 1.1 * surface[row, column]
    return row[kept], column[kept], distance[seen][kept]


def test_distances_agree_with_lidar(six_cameras):
    front = six_cameras.camera("front")
    estimate = estimate_distance(front.frames, front.camera, front.trajectory, front.T_rig_camera, frame_indices=[0])
    points_camera = transform(invert(front.T_world_camera[0]), six_cameras.lidar())
    row, column, truth = visible_points(points_camera, front.camera)
    found, confidence = estimate.distance[0, row, column], estimate.confidence[0, row, column]
    origin = estimate.origin[0, row, column]
    error = np.abs(found - np.minimum(truth, FAR_DISTANCE)) / truth
    print(f"\n{len(truth)} points, median error {np.median(error):.3f}, within a tenth {np.mean(error < 0.1):.3f}")
    for rule in DistanceOrigin:
        here = origin == rule
        if here.any():
            print(f"{rule.name}: {here.mean():.2f} of points, median error {np.median(error[here]):.3f}")
    for low, high in ((0.0, 0.3), (0.3, 0.6), (0.6, 0.9), (0.9, 1.0)):
        here = (confidence >= low) & (confidence <= high)
        print(
            f"confidence {low} to {high}: {here.mean():.2f} of points, within a tenth {np.mean(error[here] < 0.1):.2f}"
        )
    assert len(truth) > 1000
    road = origin == DistanceOrigin.PLANE
    assert np.median(error) < 0.12
    assert np.median(error[road]) < 0.1
    assert np.median(error[origin == DistanceOrigin.PARALLAX]) < 0.12
    assert np.median(error[confidence > 0.9]) < np.median(error[confidence < 0.3])


def test_kitti_distances_agree_between_frames(shared_real):
    recording = open_recording(shared_real / "kitti_raw_2011_09_26_drive_0013", OpenOptions(duration=4.0))
    shown = [12, 15]
    estimate = estimate_distance(
        recording.frames, recording.camera, recording.reference, recording.T_rig_camera, frame_indices=shown
    )
    first, second = (recording.reference.T_world_rig[index] @ recording.T_rig_camera for index in shown)
    points = pixel_rays(recording.camera) * estimate.distance[0][..., None]
    trusted = (estimate.confidence[0] > 0.5) & (estimate.distance[0] < 60.0) & ~estimate.moving[0]
    moved = transform(invert(second) @ first, points[trusted])
    pixels, seen = recording.camera.project(moved)
    column, row = np.rint(pixels[seen]).astype(int).T
    expected = np.linalg.norm(moved[seen], axis=1)
    error = np.abs(estimate.distance[1][row, column] - expected) / expected
    agree = np.mean(error < 0.1)
    print(f"\ntrusted {trusted.mean():.2f} of the picture, of which {agree:.3f} agree within a tenth")
    assert trusted.mean() > 0.2
    assert agree > 0.6
