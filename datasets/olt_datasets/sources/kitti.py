"""What the readers of KITTI's raw data and of its odometry benchmark share: the car, its images, how it travels."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.errors import InputError
from olt_generator.poses import Array, invert
from olt_generator.trajectory import Trajectory
from olt_toolkit.recordings.recording import Recording
from olt_toolkit.rigs.rig import VehicleDimensions

# VW Passat B6 estate, KITTI's car; the rear overhang places the centre of the box.
PASSAT = VehicleDimensions(
    length=4.774, width=1.820, height=1.517, rear_axle_to_bbox_center=1.36, wheelbase=2.709, track_width=1.551
)
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")
# Steps shorter than this, in metres, say nothing about the direction of travel.
MIN_TRAVEL_STEP = 0.2


def list_images(folder: Path) -> list[Path]:
    """The image files of a folder in the order of their names."""
    return sorted(file for file in folder.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES)


def decode_image(file: Path) -> NDArray[np.uint8]:
    """An image file as (H, W, 3) RGB.

    Raises:
        InputError: it cannot be decoded.
    """
    image = cv2.imread(str(file), cv2.IMREAD_COLOR)
    if image is None:
        raise InputError(f"{file}: cannot be decoded as an image; copy it again")
    return np.ascontiguousarray(image[..., ::-1], dtype=np.uint8)


def check_increasing(times: NDArray[np.int64], path: Path) -> NDArray[np.int64]:
    """The times (n,) as they are.

    Raises:
        InputError: one of them is not after the one before it.
    """
    wrong = np.flatnonzero(np.diff(times) <= 0)
    if len(wrong):
        raise InputError(f"{path}, line {wrong[0] + 2}: its time is not after the one before it; copy the drive again")
    return times


def usual_travel(T_world_body: Array) -> Array | None:
    """The usual direction of travel (3,) in the axes of a body with poses (n, 4, 4); None where it does not move."""
    steps = (invert(T_world_body[:-1]) @ T_world_body[1:])[:, :3, 3]
    length = np.linalg.norm(steps, axis=1)
    moving = length > MIN_TRAVEL_STEP
    return np.median(steps[moving] / length[moving, None], axis=0) if moving.any() else None


def trim_reference(recording: Recording) -> Recording:
    """The recording with its reference over the times of its images only, in the frame of the first."""
    if recording.reference is None:
        return recording
    times_us = recording.timestamps_us
    shown = Trajectory(times_us, recording.reference.interpolate(times_us))
    return replace(recording, reference=shown.in_first_frame())
