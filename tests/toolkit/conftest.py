"""Small clips for the tests of the clip store."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from olt_generator.poses import planar_pose
from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.clip import CameraStream, Clip, ClipOrigin, EgoMotion, ViewProvenance, make_clip_id
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE, POLICY_CAMERAS, pav_rig

WIDTH, HEIGHT = 128, 72


def _flat_frames(count: int, camera: int) -> np.ndarray:
    """Frames of one grey level each, so that a decoded frame tells its number: level = 8 + 3 k + camera."""
    levels = (8 + 3 * (np.arange(count) % 80) + camera).astype(np.uint8)
    return np.repeat(levels, HEIGHT * WIDTH * 3).reshape(count, HEIGHT, WIDTH, 3)


@pytest.fixture(scope="session")
def make_clip() -> Callable[..., Clip]:
    """Builds a clip that drives a left bend at 8 m/s and 10 Hz; every keyword replaces one attribute."""

    def build(name: str = "bend", seconds: float = 9.0, **changes: object) -> Clip:
        count = round(10 * seconds)
        timestamps_us = 100_000 * np.arange(count, dtype=np.int64)
        yaw = 0.02 * 8.0 * timestamps_us * 1e-6
        trajectory = Trajectory(timestamps_us, planar_pose(np.sin(yaw) / 0.02, (1 - np.cos(yaw)) / 0.02, yaw))
        rig = pav_rig().fitted(WIDTH, HEIGHT)
        streams = {
            camera: CameraStream(
                _flat_frames(count, index), timestamps_us, 10.0, rig[camera].camera, rig[camera].T_rig_camera
            )
            for index, camera in enumerate(POLICY_CAMERAS)
        }
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
            ego_motion=EgoMotion.from_trajectory(trajectory),
            vehicle=DEFAULT_VEHICLE,
            provenance={camera: ViewProvenance("rendered", "test", "1", 7, 1.0, 0.0) for camera in streams},
        )
        return replace(clip, **changes)

    return build
