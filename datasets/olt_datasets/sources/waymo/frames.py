"""One frame of the Waymo Open data set for end-to-end driving: what of an `E2EDFrame` message is used.

The rig is Waymo's vehicle frame (x forward, y left, z up, rear axle) at the time of the frame. Waymo's camera axes are
x forward, y left, z up.
"""

import re
from typing import Any

import numpy as np

from olt_datasets.sources.waymo.messages import read_frame
from olt_generator import BrownConradyCamera, InputError
from olt_generator.poses import R_FORWARD_CAMERA, Array, make_pose
from olt_toolkit.rigs.rig import MountedCamera

_CAMERAS = ("FRONT", "FRONT_LEFT", "FRONT_RIGHT", "SIDE_LEFT", "SIDE_RIGHT", "REAR_LEFT", "REAR", "REAR_RIGHT")
CAMERAS = dict(enumerate(_CAMERAS, start=1))
STATE_US = 250_000
"""Time between two states of the past or of the future, microseconds."""
_MOST_PAST, _MOST_FUTURE = 16, 20
# How far from the origin the last past state may be, metres: it is the position at the time of the frame.
_NOW_TOLERANCE = 0.5
# Beyond these a calibration is damaged: pixels, and coefficients of any lens.
_LARGEST_SIDE, _LARGEST_INTRINSIC = 20_000, 1e6
# A smaller coefficient moves no pixel.
_NO_DISTORTION = 1e-12
# Nothing that a frame tells is farther from the vehicle, metres.
_FARTHEST = 1e4
_NAME = re.compile(r"(?P<sequence>.+)-(?P<index>\d{1,6})")


def read_states(record: memoryview, where: str) -> dict[str, Any]:
    """What a record tells beside its images, which are jumped over; InputError names the field that is wrong.

    `sequence` and `index` name the drive and the frame in it; `past` (n, 2) holds x and y in the rig of this frame, one
    every `STATE_US` up to now, and `future` (m, 2) the same from then on, empty in the test split; `cameras` are those
    that have an image, and `rated` is whether people rated trajectories at this frame.
    """
    message = read_frame(record, where)
    name = message.frame.context.name.decode(errors="replace")
    match = _NAME.fullmatch(name)
    if match is None:
        raise InputError(f"{where}: frame.context.name {name!r} is not SEQUENCE-INDEX; give records of Waymo's E2E set")
    images = [image.name for image in message.frame.images]
    if len(set(images)) < len(images):
        raise InputError(f"{where}: frame.images holds a camera twice; copy the file again")
    past = _positions(message.past_states, _MOST_PAST, f"{where}: past_states")
    if len(past) < 2 or np.linalg.norm(past[-1]) > _NOW_TOLERANCE:
        raise InputError(f"{where}: past_states are fewer than 2 or do not end at the origin; copy the file again")
    return {
        "sequence": match["sequence"],
        "index": int(match["index"]),
        "past": past,
        "future": _positions(message.future_states, _MOST_FUTURE, f"{where}: future_states"),
        "cameras": [_camera_name(number, where) for number in sorted(images)],
        # A trajectory has a valid score, 0 to 10, or -1 for none.
        "rated": any(
            rated.HasField("preference_score") and rated.preference_score >= 0.0
            for rated in message.preference_trajectories
        ),
    }


def read_images(
    record: bytes | memoryview, where: str, with_images: bool = True
) -> tuple[dict[str, bytes], dict[str, MountedCamera]]:
    """The images of a record, JPEG files by camera, and their cameras; InputError names a field that is wrong.

    Without images their bytes are jumped over, and each is empty.
    """
    frame = read_frame(record, where, with_images).frame
    cameras = dict(_calibration(each, f"{where}: camera_calibrations") for each in frame.context.camera_calibrations)
    jpegs = {_camera_name(image.name, where): image.image for image in frame.images}
    for name in jpegs:
        if name not in cameras:
            raise InputError(f"{where}: camera {name} has an image and no calibration; copy the file again")
    return jpegs, {name: cameras[name] for name in jpegs}


def _camera_name(number: int, where: str) -> str:
    if number not in CAMERAS:
        raise InputError(f"{where}: frame.images.name {number} is no camera of Waymo's; copy the file again")
    return CAMERAS[number]


def _positions(states: Any, most: int, where: str) -> Array:
    """Positions (n, 2), n up to `most`."""
    x, y = np.array(states.pos_x), np.array(states.pos_y)
    if len(x) != len(y) or len(x) > most:
        raise InputError(f"{where}: {len(x)} pos_x and {len(y)} pos_y; up to {most} of each are expected")
    if not np.all(np.abs([x, y]) < _FARTHEST):
        raise InputError(f"{where}: a position is not finite, or kilometres away; copy the file again")
    return np.stack([x, y], axis=-1)


def _calibration(message: Any, where: str) -> tuple[str, MountedCamera]:
    name = _camera_name(message.name, where)
    intrinsic = np.array(message.intrinsic)
    width, height = message.width, message.height
    if len(intrinsic) != 9 or not np.all(np.abs(intrinsic) < _LARGEST_INTRINSIC) or min(intrinsic[:2]) < 1.0:
        raise InputError(f"{where}: intrinsic of {name} is not f_u, f_v, c_u, c_v, k1, k2, p1, p2, k3; copy it again")
    if not 1 <= min(width, height) <= max(width, height) <= _LARGEST_SIDE:
        raise InputError(f"{where}: {name} is {width} x {height} pixels; copy the file again")
    fx, fy, cx, cy = intrinsic[:4].tolist()
    k1, k2, p1, p2, k3 = np.where(np.abs(intrinsic[4:]) < _NO_DISTORTION, 0.0, intrinsic[4:]).tolist()
    # Waymo's pixel 0 is the left edge of the first pixel (dataset.proto, camera_projection), ours is its centre.
    camera = BrownConradyCamera(width, height, fx, fy, cx - 0.5, cy - 0.5, k1, k2, p1, p2, k3)
    extrinsic = np.array(message.extrinsic.transform)
    if len(extrinsic) != 16:
        raise InputError(
            f"{where}: extrinsic of {name} has {len(extrinsic)} numbers instead of 16; copy the file again"
        )
    pose = extrinsic.reshape(4, 4)
    rotation = pose[:3, :3]
    is_small = np.all(np.abs(pose) < _FARTHEST)
    if not is_small or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4) or np.linalg.det(rotation) < 0.0:
        raise InputError(f"{where}: extrinsic of {name} is no rigid motion; copy the file again")
    return name, MountedCamera(camera, make_pose(rotation @ R_FORWARD_CAMERA, pose[:3, 3]))
