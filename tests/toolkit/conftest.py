"""Small clips for the tests of the clip store."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from olt_generator.poses import make_pose
from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.clip import CameraStream, Clip, ClipOrigin, EgoMotion, ViewProvenance, make_clip_id
from olt_toolkit.rigs.rig import (
    CROSS_LEFT,
    CROSS_RIGHT,
    DEFAULT_VEHICLE,
    FRONT_TELE,
    FRONT_WIDE,
    POLICY_CAMERAS,
)
from olt_toolkit.rigs.rig_files import pav_rig

WIDTH, HEIGHT = 128, 72

# Frames a second, and microseconds to the first frame. The earliest frame of a sample is that of the third camera.
TIMING = {CROSS_LEFT: (10, 81_000), FRONT_WIDE: (10, 0), CROSS_RIGHT: (20, 17_000), FRONT_TELE: (30, 9_000)}


def _flat_frames(count: int, camera: int) -> np.ndarray:
    """Frames of one grey level each, so that a decoded frame tells its number: level = 8 + 3 k + camera."""
    levels = (8 + 3 * (np.arange(count) % 80) + camera).astype(np.uint8)
    return np.repeat(levels, HEIGHT * WIDTH * 3).reshape(count, HEIGHT, WIDTH, 3)


@pytest.fixture(scope="session")
def bend_poses() -> Callable[[np.ndarray], np.ndarray]:
    """Poses (n, 4, 4) at clip times (n,) of a left bend of 50 m radius at 8 m/s, rolling and pitching all the way."""

    def poses(times_us: np.ndarray) -> np.ndarray:
        seconds = times_us * 1e-6
        yaw, pitch, roll = 0.16 * seconds, 0.04 + 0.02 * np.sin(0.7 * seconds), 0.09 * np.cos(0.5 * seconds) - 0.03
        rotation = Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=-1)).as_matrix()
        return make_pose(rotation, np.stack([np.sin(yaw), 1 - np.cos(yaw), np.zeros_like(yaw)], axis=-1) / 0.02)

    return poses


@pytest.fixture(scope="session")
def make_clip(bend_poses) -> Callable[..., Clip]:
    """Builds a clip of the bend, its cameras out of step with each other; every keyword replaces one attribute."""

    def build(name: str = "bend", seconds: float = 9.0, **changes: object) -> Clip:
        timestamps_us = 100_000 * np.arange(round(10 * seconds), dtype=np.int64)
        rig, streams = pav_rig().fitted(WIDTH, HEIGHT), {}
        for index, camera in enumerate(POLICY_CAMERAS):
            rate, first_us = TIMING[camera]
            count = round(rate * seconds)
            times_us = first_us + np.arange(count, dtype=np.int64) * (1_000_000 // rate)
            streams[camera] = CameraStream(
                _flat_frames(count, index), times_us, float(rate), rig[camera].camera, rig[camera].T_rig_camera
            )
        clip = Clip(
            clip_id=make_clip_id(name),
            name=name,
            scene_id="bend",
            source="test",
            origin=ClipOrigin("bend", 0, 8_900_000, "DE", "CC0"),
            kind="GT",
            category="nominal",
            factors=("rain",),
            split="train",
            streams=streams,
            ego_motion=EgoMotion.from_trajectory(Trajectory(timestamps_us, bend_poses(timestamps_us))),
            vehicle=DEFAULT_VEHICLE,
            provenance={camera: ViewProvenance("rendered", "test", "1", 7, 1.0, 0.0) for camera in streams},
        )
        return replace(clip, **changes)

    return build
