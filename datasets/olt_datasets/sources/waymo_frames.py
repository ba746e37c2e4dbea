"""One frame of the Waymo Open data set for end-to-end driving: what of an `E2EDFrame` message is used.

Field numbers are those of Waymo's `end_to_end_driving_data.proto` and `dataset.proto`. The rig is Waymo's vehicle frame
(x forward, y left, z up, rear axle) at the time of the frame. Waymo's camera axes are x forward, y left, z up.
"""

import re
from dataclasses import dataclass

import numpy as np

from olt_datasets.sources.wire_format import Message
from olt_generator.cameras import BrownConradyCamera
from olt_generator.errors import InputError
from olt_generator.poses import R_FORWARD_CAMERA, Array, make_pose
from olt_toolkit.rigs.rig import MountedCamera

CAMERAS = {
    1: "FRONT",
    2: "FRONT_LEFT",
    3: "FRONT_RIGHT",
    4: "SIDE_LEFT",
    5: "SIDE_RIGHT",
    6: "REAR_LEFT",
    7: "REAR",
    8: "REAR_RIGHT",
}
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


@dataclass(frozen=True)
class FrameStates:
    """What a frame tells beside its images.

    Attributes:
        sequence: name of the drive.
        index: number of the frame in the drive.
        past: (n, 2) x and y in the rig of this frame, one every `STATE_US`, the last is now.
        future: (m, 2) the same from `STATE_US` after now on; empty in the test split.
        cameras: names of the cameras that have an image.
        rated: whether people rated trajectories at this frame.
    """

    sequence: str
    index: int
    past: Array
    future: Array
    cameras: tuple[str, ...]
    rated: bool


@dataclass(frozen=True)
class FrameImages:
    """Images of one frame by camera, as JPEG files, and the cameras."""

    jpegs: dict[str, memoryview]
    cameras: dict[str, MountedCamera]


def read_states(record: memoryview, where: str) -> FrameStates:
    """What a record tells beside its images, which are jumped over.

    Raises:
        InputError: it is no frame of this data set; names the field.
    """
    message = Message(record, (1, 5, 6, 8), where)
    frame = Message(message.data(1), (1, 4), f"{where}: frame")
    name = Message(frame.data(1), (1,), f"{where}: frame.context").text(1)
    match = _NAME.fullmatch(name)
    if match is None:
        raise InputError(f"{where}: frame.context.name {name!r} is not SEQUENCE-INDEX; give records of Waymo's E2E set")
    images = [Message(image, (1,), f"{where}: frame.images").number(1) for image in frame.all_data(4)]
    if len(set(images)) < len(images):
        raise InputError(f"{where}: frame.images holds a camera twice; copy the file again")
    past = _positions(message.data(6), _MOST_PAST, f"{where}: past_states")
    if len(past) < 2 or np.linalg.norm(past[-1]) > _NOW_TOLERANCE:
        raise InputError(f"{where}: past_states are fewer than 2 or do not end at the origin; copy the file again")
    return FrameStates(
        sequence=match["sequence"],
        index=int(match["index"]),
        past=past,
        future=_positions(message.data(5), _MOST_FUTURE, f"{where}: future_states"),
        cameras=tuple(_camera_name(number, where) for number in sorted(images)),
        rated=_is_rated(message.all_data(8), f"{where}: preference_trajectories"),
    )


def read_images(record: memoryview, where: str) -> FrameImages:
    """The images of a record, still coded, and their cameras, matched by name.

    Raises:
        InputError: it is no frame of this data set, or an image has no calibration; names the field.
    """
    frame = Message(Message(record, (1,), where).data(1), (1, 4), f"{where}: frame")
    context = Message(frame.data(1), (2,), f"{where}: frame.context")
    cameras = dict(_calibration(data, f"{where}: camera_calibrations") for data in context.all_data(2))
    jpegs = {}
    for data in frame.all_data(4):
        image = Message(data, (1, 2), f"{where}: frame.images")
        name = _camera_name(image.number(1), where)
        if name not in cameras:
            raise InputError(f"{where}: camera {name} has an image and no calibration; copy the file again")
        jpegs[name] = image.data(2)
    return FrameImages(jpegs, {name: cameras[name] for name in jpegs})


def _camera_name(number: int, where: str) -> str:
    if number not in CAMERAS:
        raise InputError(f"{where}: frame.images.name {number} is no camera of Waymo's; copy the file again")
    return CAMERAS[number]


def _positions(content: memoryview, most: int, where: str) -> Array:
    """Positions (n, 2), n up to `most`."""
    states = Message(content, (1, 2), where)
    x, y = states.floats(1), states.floats(2)
    if len(x) != len(y) or len(x) > most:
        raise InputError(f"{where}: {len(x)} pos_x and {len(y)} pos_y; up to {most} of each are expected")
    if not np.all(np.abs([x, y]) < _FARTHEST):
        raise InputError(f"{where}: a position is not finite, or kilometres away; copy the file again")
    return np.stack([x, y], axis=-1)


def _is_rated(trajectories: list[memoryview], where: str) -> bool:
    """Whether any trajectory has a valid score, 0 to 10; -1 stands for none."""
    scores = [Message(content, (8,), where).floats(8) for content in trajectories]
    return any(len(score) == 1 and score[0] >= 0.0 for score in scores)


def _calibration(content: memoryview, where: str) -> tuple[str, MountedCamera]:
    message = Message(content, (1, 2, 3, 4, 5), where)
    name = _camera_name(message.number(1), where)
    intrinsic = message.doubles(2)
    extrinsic = Message(message.data(3), (1,), where).doubles(1)
    width, height = message.number(4), message.number(5)
    if len(intrinsic) != 9 or not np.all(np.abs(intrinsic) < _LARGEST_INTRINSIC) or min(intrinsic[:2]) < 1.0:
        raise InputError(f"{where}: intrinsic of {name} is not f_u, f_v, c_u, c_v, k1, k2, p1, p2, k3; copy it again")
    if not 1 <= min(width, height) <= max(width, height) <= _LARGEST_SIDE:
        raise InputError(f"{where}: {name} is {width} x {height} pixels; copy the file again")
    fx, fy, cx, cy = intrinsic[:4].tolist()
    k1, k2, p1, p2, k3 = np.where(np.abs(intrinsic[4:]) < _NO_DISTORTION, 0.0, intrinsic[4:]).tolist()
    # Waymo's pixel 0 is the left edge of the first pixel (dataset.proto, camera_projection), ours is its centre.
    camera = BrownConradyCamera(width, height, fx, fy, cx - 0.5, cy - 0.5, k1, k2, p1, p2, k3)
    return name, MountedCamera(camera, _mounting(extrinsic, f"{where}: extrinsic of {name}"))


def _mounting(extrinsic: Array, where: str) -> Array:
    """T_rig_camera (4, 4) with our camera axes."""
    if len(extrinsic) != 16:
        raise InputError(f"{where} has {len(extrinsic)} numbers instead of 16; copy the file again")
    pose = extrinsic.reshape(4, 4)
    rotation = pose[:3, :3]
    is_small = np.all(np.abs(pose) < _FARTHEST)
    if not is_small or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4) or np.linalg.det(rotation) < 0.0:
        raise InputError(f"{where} is no rigid motion; copy the file again")
    return make_pose(rotation @ R_FORWARD_CAMERA, pose[:3, 3])
