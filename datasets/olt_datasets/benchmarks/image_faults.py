"""Faults that only a look at the images finds, planted into a store of two rendered clips.

Everything else fits: the files have their checksums, the tables contradict neither themselves nor each other.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from olt_datasets.benchmarks.planted_faults import Fault, Generator, Plant
from olt_datasets.benchmarks.store_surgery import change_members, change_motion, trust
from olt_datasets.benchmarks.video_surgery import change_frames
from olt_toolkit.clips.pai_layout import EGOMOTION, STORED, VIDEO
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.verification.camera_checks import CAMERA_NAME, OWN_VIDEO, TELE_INSIDE, TELE_TIMES
from olt_toolkit.clips.verification.motion_checks import (
    FRAME_ORDER,
    FRAME_TIMES,
    MIRRORED,
    MOTION,
    MOTION_SCALE,
    MOTION_SIDES,
    MOTION_TIMES,
    THIS_CLIP,
)
from olt_toolkit.rigs.rig import CROSS_LEFT, CROSS_RIGHT, FRONT_TELE, FRONT_WIDE

Frames = NDArray[np.uint8]

IMAGES = ("images",)
_POSITION, _VELOCITY, _ACCELERATION = ["x", "y", "z"], ["vx", "vy", "vz"], ["ax", "ay", "az"]
_QUATERNION = ["qx", "qy", "qz", "qw"]


def _video(camera: str, change: Callable[[Frames, Generator], Frames]) -> Plant:
    def plant(root: Path, clip: str, _: str, generator: Generator) -> None:
        name = STORED[camera].member(VIDEO, clip)
        change_members(
            root,
            camera,
            lambda found: found | {name: change_frames(found[name], lambda frames: change(frames, generator))},
        )
        trust(root, clip)

    return plant


def _videos_of(first: str, second: str, exchange: bool) -> Plant:
    """The video of the second camera in place of the first one's, and the other way round where they are exchanged."""

    def plant(root: Path, clip: str, _: str, __: Generator) -> None:
        store, names = ClipStore(root), {camera: STORED[camera].member(VIDEO, clip) for camera in (first, second)}
        videos = {camera: store.read_member(clip, camera, VIDEO) for camera in (first, second)}
        change_members(root, first, lambda found: found | {names[first]: videos[second]})
        if exchange:
            change_members(root, second, lambda found: found | {names[second]: videos[first]})
        trust(root, clip)

    return plant


def _of_another_clip(feature: str, alias: str) -> Plant:
    def plant(root: Path, clip: str, other: str, _: Generator) -> None:
        first, second = (STORED[feature].member(alias, each) for each in (clip, other))
        change_members(root, feature, lambda found: found | {first: found[second], second: found[first]})
        for each in (clip, other):
            trust(root, each)

    return plant


def _late(frames: int) -> Callable[[Frames, Generator], Frames]:
    """Images that show what was so many frames before."""
    return lambda images, _: images[np.maximum(np.arange(len(images)) - frames, 0)]


def _motion(change: Callable[[pd.DataFrame], pd.DataFrame]) -> Plant:
    return lambda root, clip, _, __: change_motion(root, clip, change)


def _scaled(factor: float) -> Callable[[pd.DataFrame], pd.DataFrame]:
    """All lengths in another unit, so that no table contradicts another."""

    def change(table: pd.DataFrame) -> pd.DataFrame:
        table[[*_POSITION, *_VELOCITY, *_ACCELERATION]] *= factor
        return table.assign(curvature=table["curvature"] / factor)

    return change


def _mirrored(table: pd.DataFrame) -> pd.DataFrame:
    """Left-handed: y to the right, yaw and roll with the other sign, consistently."""
    for name in ("y", "vy", "ay", "qx", "qz", "curvature"):
        table[name] = -table[name]
    return table


def _backward(table: pd.DataFrame) -> pd.DataFrame:
    """The whole motion backward in time, begun at the origin, consistently."""
    for columns, sign in ((_POSITION, 1), (_QUATERNION, 1), (_VELOCITY, -1), (_ACCELERATION, 1), (["curvature"], -1)):
        table[columns] = sign * table[columns].to_numpy()[::-1]
    start = Rotation.from_quat(np.array(table[_QUATERNION].iloc[0])).inv()
    table[_POSITION] = start.apply(np.array(table[_POSITION] - table[_POSITION].iloc[0]))
    table[_QUATERNION] = (start * Rotation.from_quat(np.array(table[_QUATERNION]))).as_quat()
    for columns in (_VELOCITY, _ACCELERATION):
        table[columns] = start.apply(np.array(table[columns]))
    return table


def _delayed(seconds: float) -> Callable[[pd.DataFrame], pd.DataFrame]:
    return lambda table: table.assign(timestamp=table["timestamp"] + round(seconds * 1e6))


IMAGE_FAULTS: tuple[Fault, ...] = (
    Fault("left and right video exchanged", _videos_of(CROSS_LEFT, CROSS_RIGHT, True), (CAMERA_NAME, MIRRORED), IMAGES),
    Fault("front and left video exchanged", _videos_of(FRONT_WIDE, CROSS_LEFT, True), (CAMERA_NAME,), IMAGES),
    Fault("front and tele video exchanged", _videos_of(FRONT_WIDE, FRONT_TELE, True), (TELE_INSIDE,), IMAGES),
    Fault("left video in place of the right", _videos_of(CROSS_RIGHT, CROSS_LEFT, False), (OWN_VIDEO,), IMAGES),
    Fault("left images mirrored", _video(CROSS_LEFT, lambda frames, _: frames[:, :, ::-1]), (MIRRORED,), IMAGES),
    Fault("front images mirrored", _video(FRONT_WIDE, lambda frames, _: frames[:, :, ::-1]), (TELE_INSIDE,), IMAGES),
    Fault("left frames reversed", _video(CROSS_LEFT, lambda frames, _: frames[::-1]), (FRAME_ORDER,), IMAGES),
    Fault("front frames reversed", _video(FRONT_WIDE, lambda frames, _: frames[::-1]), (FRAME_ORDER,), IMAGES),
    Fault(
        "right frames shuffled",
        _video(CROSS_RIGHT, lambda frames, generator: frames[generator.permutation(len(frames))]),
        (FRAME_ORDER,),
        IMAGES,
    ),
    Fault(
        "left frames frozen half way",
        _video(CROSS_LEFT, lambda frames, _: frames[np.minimum(np.arange(len(frames)), len(frames) // 2)]),
        (FRAME_ORDER,),
        IMAGES,
    ),
    Fault("left video of another clip", _of_another_clip(CROSS_LEFT, VIDEO), (THIS_CLIP,), IMAGES),
    Fault("front video of another clip", _of_another_clip(FRONT_WIDE, VIDEO), (TELE_INSIDE, THIS_CLIP), IMAGES),
    Fault("tele video of another clip", _of_another_clip(FRONT_TELE, VIDEO), (TELE_INSIDE,), IMAGES),
    Fault("tele 0.1 s late", _video(FRONT_TELE, _late(1)), (TELE_TIMES,), IMAGES),
    Fault("tele 1 s late", _video(FRONT_TELE, _late(10)), (TELE_TIMES, TELE_INSIDE), IMAGES),
    Fault("left 0.3 s late", _video(CROSS_LEFT, _late(3)), (FRAME_TIMES,), IMAGES),
    Fault("left 1 s late", _video(CROSS_LEFT, _late(10)), (FRAME_TIMES,), IMAGES),
    Fault(
        "left at half the rate",
        _video(CROSS_LEFT, lambda frames, _: frames[np.arange(len(frames)) // 2]),
        (FRAME_ORDER, FRAME_TIMES),
        IMAGES,
    ),
    Fault("motion left-handed", _motion(_mirrored), (MOTION_SIDES,), IMAGES),
    Fault("motion backward in time", _motion(_backward), (MOTION,), IMAGES),
    Fault("motion in cm", _motion(_scaled(100.0)), (MOTION_SCALE,), IMAGES),
    Fault("motion of half the length", _motion(_scaled(0.5)), (MOTION_SCALE,), IMAGES),
    Fault("motion of twice the length", _motion(_scaled(2.0)), (MOTION_SCALE,), IMAGES),
    Fault("motion 0.3 s late", _motion(_delayed(0.3)), (MOTION_TIMES,), IMAGES),
    Fault("motion 1 s late", _motion(_delayed(1.0)), (MOTION_TIMES,), IMAGES),
    Fault("motion of another clip, trusted", _of_another_clip(EGOMOTION, EGOMOTION), (MOTION,), IMAGES),
)
