"""Faults that only a look at the images finds, planted into what a good clip shows and says once it is decoded.

Files, checksums and tables play no part: whoever made these mistakes made them fit. Faults of the files themselves are
those of `planted_faults`.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from olt_generator.poses import Array, invert, make_pose
from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.clip import EgoMotion
from olt_toolkit.clips.verification.camera_checks import TELE_TIMES, check_names, check_own_videos, check_tele
from olt_toolkit.clips.verification.clip_evidence import ClipEvidence
from olt_toolkit.clips.verification.findings import Finding, Verdict, not_compared
from olt_toolkit.clips.verification.hypotheses import motion_of
from olt_toolkit.clips.verification.image_evidence import ImageEvidence
from olt_toolkit.clips.verification.image_steps import CameraImages, follow_points
from olt_toolkit.clips.verification.motion_checks import (
    MOTION,
    MOTION_OF_CLIP,
    MOTION_SCALE,
    MOTION_SIDES,
    MOTION_TIMES,
    check_frame_order,
    check_frame_times,
    check_mirrored,
    check_motion,
    check_this_clip,
)
from olt_toolkit.clips.verification.neighbour_checks import check_neighbours
from olt_toolkit.rigs.rig import CROSS_LEFT, CROSS_RIGHT, FRONT_TELE, FRONT_WIDE

Generator = np.random.Generator
Plant = Callable[[ClipEvidence, ClipEvidence, Generator], ClipEvidence]
"""From a good clip and another one to a bad clip."""
Look = Callable[[ClipEvidence], Iterable[Finding]]
Frames = NDArray[np.uint8]

# Left becomes right.
_MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])


@dataclass(frozen=True)
class ImageFault:
    """One kind of fault.

    Attributes:
        name: in words.
        plant: makes a bad clip of a good one.
        looks: the checks that should find it; one that fails is enough.
        groups: name of the group of these checks.
    """

    name: str
    plant: Plant
    looks: tuple[Look, ...]
    groups: tuple[str, ...] = ("images",)


def _with_images(clip: ClipEvidence, changed: dict[str, CameraImages]) -> ClipEvidence:
    followed = {camera: ImageEvidence(follow_points(images), clip.ego_motion) for camera, images in changed.items()}
    return replace(clip, images=clip.images | changed, evidence=clip.evidence | followed)


def _with_motion(clip: ClipEvidence, motion: EgoMotion) -> ClipEvidence:
    evidence = {camera: ImageEvidence(each.steps, motion) for camera, each in clip.evidence.items()}
    return replace(clip, ego_motion=motion, evidence=evidence)


def _showing(camera: CameraImages, other: CameraImages) -> CameraImages:
    """A camera with the images of another one, as many as both have."""
    count = min(len(camera.times_us), len(other.times_us))
    seen = None if other.seen is None else other.seen[:count]
    return replace(camera, times_us=camera.times_us[:count], grays=other.grays[:count], seen=seen)


def _frames(camera: str, change: Callable[[Frames, Generator], Frames]) -> Plant:
    def plant(clip: ClipEvidence, _: ClipEvidence, generator: Generator) -> ClipEvidence:
        images = clip.images[camera]
        changed = np.ascontiguousarray(change(images.grays, generator))
        return _with_images(clip, {camera: replace(images, grays=changed)})

    return plant


def _cameras(*shown: tuple[str, str]) -> Plant:
    """Cameras that show what others do: pairs of the camera and the other one."""
    return lambda clip, _, __: _with_images(
        clip, {camera: _showing(clip.images[camera], clip.images[other]) for camera, other in shown}
    )


def _of_other(camera: str) -> Plant:
    return lambda clip, other, _: _with_images(clip, {camera: _showing(clip.images[camera], other.images[camera])})


def _late(frames: int) -> Callable[[Frames, Generator], Frames]:
    """Images that show what was so many frames before."""
    return lambda images, _: images[np.maximum(np.arange(len(images)) - frames, 0)]


def _poses(change: Callable[[Array], Array]) -> Plant:
    def plant(clip: ClipEvidence, _: ClipEvidence, __: Generator) -> ClipEvidence:
        said = clip.ego_motion.trajectory
        changed = Trajectory(said.timestamps_us, change(said.T_world_rig))
        return _with_motion(clip, EgoMotion.from_trajectory(changed))

    return plant


def _delayed(seconds: float) -> Plant:
    def plant(clip: ClipEvidence, _: ClipEvidence, __: Generator) -> ClipEvidence:
        said = clip.ego_motion
        late = Trajectory(said.trajectory.timestamps_us + round(seconds * 1e6), said.trajectory.T_world_rig)
        return _with_motion(clip, replace(said, trajectory=late))

    return plant


def _scaled(factor: float) -> Plant:
    return _poses(lambda poses: make_pose(poses[:, :3, :3], factor * poses[:, :3, 3]))


def _motion_of_other(clip: ClipEvidence, other: ClipEvidence, _: Generator) -> ClipEvidence:
    exchanged = {other.clip_id: motion_of(clip.ego_motion)}
    return replace(_with_motion(clip, other.ego_motion), other_motions=exchanged)


def _one(check: Callable[[ClipEvidence, str], Finding], camera: str) -> Look:
    return lambda clip: [check(clip, camera)]


def _names(*cameras: str) -> Look:
    return lambda clip: [each for each in check_names(clip) if each.where in cameras]


def _motion(*checks: str) -> Look:
    return lambda clip: [each for each in check_motion(clip) if each.check in checks]


def _of_shift(look: Look, seconds: float) -> Look:
    """Checks of times that pass but rule out only longer shifts say nothing of this one."""

    def looked(clip: ClipEvidence) -> Iterable[Finding]:
        for each in look(clip):
            passed = each.check == TELE_TIMES and each.verdict is Verdict.PASSED
            coarse = passed and each.measured is not None and each.measured > seconds
            yield not_compared(each.check, each.where, each.detail) if coarse else each

    return looked


_NAMES_OF_SIDES = (_names(CROSS_LEFT, CROSS_RIGHT), _one(check_mirrored, CROSS_LEFT), _one(check_mirrored, CROSS_RIGHT))
_LEFT_TIMES = (_one(check_frame_times, CROSS_LEFT), check_neighbours)

IMAGE_FAULTS: tuple[ImageFault, ...] = (
    ImageFault(
        "left and right video exchanged",
        _cameras((CROSS_LEFT, CROSS_RIGHT), (CROSS_RIGHT, CROSS_LEFT)),
        _NAMES_OF_SIDES,
    ),
    ImageFault(
        "front and left video exchanged",
        _cameras((FRONT_WIDE, CROSS_LEFT), (CROSS_LEFT, FRONT_WIDE)),
        (_names(FRONT_WIDE, CROSS_LEFT), check_tele),
    ),
    ImageFault(
        "front and tele video exchanged", _cameras((FRONT_WIDE, FRONT_TELE), (FRONT_TELE, FRONT_WIDE)), (check_tele,)
    ),
    ImageFault("left video in place of the right", _cameras((CROSS_RIGHT, CROSS_LEFT)), (check_own_videos,)),
    ImageFault(
        "left images mirrored",
        _frames(CROSS_LEFT, lambda frames, _: frames[:, :, ::-1]),
        (_one(check_mirrored, CROSS_LEFT), check_neighbours),
    ),
    ImageFault(
        "front images mirrored",
        _frames(FRONT_WIDE, lambda frames, _: frames[:, :, ::-1]),
        (check_tele, _one(check_mirrored, FRONT_WIDE)),
    ),
    ImageFault(
        "left frames reversed",
        _frames(CROSS_LEFT, lambda frames, _: frames[::-1]),
        (_one(check_frame_order, CROSS_LEFT), check_neighbours),
    ),
    ImageFault(
        "front frames reversed",
        _frames(FRONT_WIDE, lambda frames, _: frames[::-1]),
        (_one(check_frame_order, FRONT_WIDE), check_tele),
    ),
    ImageFault(
        "right frames shuffled",
        _frames(CROSS_RIGHT, lambda frames, generator: frames[generator.permutation(len(frames))]),
        (_one(check_frame_order, CROSS_RIGHT),),
    ),
    ImageFault(
        "left frames frozen half way",
        _frames(CROSS_LEFT, lambda frames, _: frames[np.minimum(np.arange(len(frames)), len(frames) // 2)]),
        (_one(check_frame_order, CROSS_LEFT),),
    ),
    ImageFault(
        "left video of another clip", _of_other(CROSS_LEFT), (_one(check_this_clip, CROSS_LEFT), check_neighbours)
    ),
    ImageFault("front video of another clip", _of_other(FRONT_WIDE), (check_tele, _one(check_this_clip, FRONT_WIDE))),
    ImageFault("tele video of another clip", _of_other(FRONT_TELE), (check_tele,)),
    ImageFault("tele 0.1 s late", _frames(FRONT_TELE, _late(1)), (_of_shift(check_tele, 0.1),)),
    ImageFault("tele 0.3 s late", _frames(FRONT_TELE, _late(3)), (check_tele,)),
    ImageFault("tele 1 s late", _frames(FRONT_TELE, _late(10)), (check_tele,)),
    ImageFault("left 0.3 s late", _frames(CROSS_LEFT, _late(3)), _LEFT_TIMES),
    ImageFault("left 1 s late", _frames(CROSS_LEFT, _late(10)), _LEFT_TIMES),
    ImageFault(
        "left at half the rate",
        _frames(CROSS_LEFT, lambda frames, _: frames[np.arange(len(frames)) // 2]),
        (_one(check_frame_order, CROSS_LEFT), _one(check_frame_times, CROSS_LEFT)),
    ),
    ImageFault("motion left-handed", _poses(lambda poses: _MIRROR @ poses @ _MIRROR), (_motion(MOTION_SIDES),)),
    ImageFault(
        "rotations transposed",
        _poses(lambda poses: make_pose(np.swapaxes(poses[:, :3, :3], 1, 2), poses[:, :3, 3])),
        (_motion(MOTION_SIDES),),
    ),
    ImageFault("motion backward in time", _poses(lambda poses: invert(poses[-1]) @ poses[::-1]), (_motion(MOTION),)),
    ImageFault("motion in cm", _scaled(100.0), (_motion(MOTION_SCALE),)),
    ImageFault("motion in feet", _scaled(3.281), (_motion(MOTION_SCALE),)),
    ImageFault("motion of half the length", _scaled(0.5), (_motion(MOTION_SCALE),)),
    ImageFault("motion of twice the length", _scaled(2.0), (_motion(MOTION_SCALE),)),
    ImageFault("motion 0.3 s late", _delayed(0.3), (_motion(MOTION_TIMES),)),
    ImageFault("motion 1 s late", _delayed(1.0), (_motion(MOTION_TIMES),)),
    ImageFault("motion of another clip", _motion_of_other, (_motion(MOTION_OF_CLIP),)),
)
