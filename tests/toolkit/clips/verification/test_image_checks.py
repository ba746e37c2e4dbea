"""Images that are what their clip says pass; each mix-up is found and named; what cannot be told is not told."""

from dataclasses import replace

import numpy as np
import pytest

from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.clip import EgoMotion
from olt_toolkit.clips.verification.camera_checks import CAMERA_NAME, OWN_VIDEO, TELE_INSIDE, TELE_TIMES
from olt_toolkit.clips.verification.findings import Verdict
from olt_toolkit.clips.verification.motion_checks import (
    FRAME_ORDER,
    FRAME_TIMES,
    MIRRORED,
    MOTION,
    MOTION_OF_CLIP,
    MOTION_SCALE,
    MOTION_SIDES,
    MOTION_TIMES,
    THIS_CLIP,
)
from olt_toolkit.clips.verification.neighbour_checks import NEIGHBOURS
from olt_toolkit.rigs.rig import CROSS_LEFT, CROSS_RIGHT, FRONT_TELE, FRONT_WIDE

from .blob_world import bend_motion, blob_clip, failed, look

ALL_CHECKS = {CAMERA_NAME, OWN_VIDEO, TELE_INSIDE, TELE_TIMES, NEIGHBOURS}
ALL_CHECKS |= {
    MOTION_OF_CLIP,
    MOTION_SCALE,
    MOTION_SIDES,
    MOTION_TIMES,
    FRAME_ORDER,
    FRAME_TIMES,
    MIRRORED,
    MOTION,
    THIS_CLIP,
}
MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])


@pytest.fixture(scope="module")
def clip():
    return blob_clip()


@pytest.fixture(scope="module")
def other():
    return blob_clip("other", 1, motion=lambda times_us: bend_motion(times_us, -1.0, 0.6))


def with_frames(clip, **frames):
    return replace(
        clip,
        streams=clip.streams
        | {camera: replace(clip.streams[camera], frames=np.ascontiguousarray(new)) for camera, new in frames.items()},
    )


def with_poses(clip, poses):
    times_us = clip.ego_motion.trajectory.timestamps_us
    return replace(clip, ego_motion=EgoMotion.from_trajectory(Trajectory(times_us, poses)))


def passed(findings):
    return {each.check for each in findings if each.verdict is Verdict.PASSED}


def frames(clip, camera):
    return clip.streams[camera].frames


def test_a_good_clip_passes(clip, other, tmp_path):
    findings = look(tmp_path, clip, other)
    assert failed(findings) == set()
    assert passed(findings) == ALL_CHECKS
    assert all(clip.clip_id in each.where and each.detail for each in findings)


def swap_crosses(clip, _):
    return with_frames(clip, **{CROSS_LEFT: frames(clip, CROSS_RIGHT), CROSS_RIGHT: frames(clip, CROSS_LEFT)})


def swap_fronts(clip, _):
    return with_frames(clip, **{FRONT_WIDE: frames(clip, FRONT_TELE), FRONT_TELE: frames(clip, FRONT_WIDE)})


def double_left(clip, _):
    return with_frames(clip, **{CROSS_RIGHT: frames(clip, CROSS_LEFT)})


def mirror_left(clip, _):
    return with_frames(clip, **{CROSS_LEFT: frames(clip, CROSS_LEFT)[:, :, ::-1]})


def mirror_tele(clip, _):
    return with_frames(clip, **{FRONT_TELE: frames(clip, FRONT_TELE)[:, :, ::-1]})


def reverse_right(clip, _):
    return with_frames(clip, **{CROSS_RIGHT: frames(clip, CROSS_RIGHT)[::-1]})


def shuffle_front(clip, _):
    order = np.random.default_rng(0).permutation(len(frames(clip, FRONT_WIDE)))
    return with_frames(clip, **{FRONT_WIDE: frames(clip, FRONT_WIDE)[order]})


def exchange_some(clip, _):
    order = np.arange(len(frames(clip, FRONT_WIDE)))
    for first in (12, 20, 30):
        order[[first, first + 1]] = [first + 1, first]
    return with_frames(clip, **{FRONT_WIDE: frames(clip, FRONT_WIDE)[order]})


def freeze_half(clip, _):
    return with_frames(clip, **{CROSS_LEFT: frames(clip, CROSS_LEFT)[np.minimum(np.arange(45), 15)]})


def freeze_all(clip, _):
    return with_frames(clip, **{CROSS_LEFT: frames(clip, CROSS_LEFT)[np.zeros(45, int)]})


def delay_tele(clip, _):
    return with_frames(clip, **{FRONT_TELE: frames(clip, FRONT_TELE)[np.maximum(np.arange(45) - 2, 0)]})


def delay_left(clip, _):
    return with_frames(clip, **{CROSS_LEFT: frames(clip, CROSS_LEFT)[np.maximum(np.arange(45) - 10, 0)]})


def tele_of_other(clip, other):
    return with_frames(clip, **{FRONT_TELE: frames(other, FRONT_TELE)})


def left_of_other(clip, other):
    return with_frames(clip, **{CROSS_LEFT: frames(other, CROSS_LEFT)})


def mirror_motion(clip, _):
    return with_poses(clip, MIRROR @ clip.ego_motion.trajectory.T_world_rig @ MIRROR)


def reverse_motion(clip, _):
    return with_poses(clip, clip.ego_motion.trajectory.T_world_rig[::-1])


def scale_motion(factor):
    def scale(clip, _):
        poses = clip.ego_motion.trajectory.T_world_rig.copy()
        poses[:, :3, 3] *= factor
        return with_poses(clip, poses)

    return scale


def motion_of_other(clip, other):
    return replace(clip, ego_motion=other.ego_motion)


FAULTS = [
    (swap_crosses, {CAMERA_NAME}),
    (mirror_tele, {TELE_INSIDE}),
    (reverse_right, {FRAME_ORDER}),
    (freeze_all, {FRAME_ORDER}),
    (mirror_motion, {MOTION_SIDES}),
]
MORE_FAULTS = [
    (swap_fronts, {TELE_INSIDE}),
    (double_left, {OWN_VIDEO}),
    (mirror_left, {MIRRORED}),
    (shuffle_front, {FRAME_ORDER}),
    (exchange_some, {FRAME_ORDER}),
    (freeze_half, {FRAME_ORDER}),
    (delay_tele, {TELE_TIMES}),
    (delay_left, {NEIGHBOURS}),
    (tele_of_other, {TELE_INSIDE}),
    (left_of_other, {THIS_CLIP}),
    (reverse_motion, {MOTION}),
    (scale_motion(100.0), {MOTION_SCALE}),
    (scale_motion(0.01), {MOTION_SCALE}),
    (scale_motion(2.0), {MOTION_SCALE}),
    (motion_of_other, {MOTION_OF_CLIP}),
]


@pytest.mark.parametrize(
    ("fault", "checks"), FAULTS + [pytest.param(*each, marks=pytest.mark.slow) for each in MORE_FAULTS]
)
def test_a_fault_is_found_by_its_check(clip, other, tmp_path, fault, checks):
    assert checks <= failed(look(tmp_path, fault(clip, other), other))


def test_a_standing_vehicle_is_not_compared(tmp_path):
    still = blob_clip("still", motion=lambda times_us: np.repeat(np.eye(4)[None], len(times_us), axis=0))
    findings = look(tmp_path, still)
    assert failed(findings) == set()
    motion = next(each for each in findings if each.check == MOTION)
    assert motion.verdict is Verdict.NOT_COMPARED and "stands" in motion.detail
    # Where the cameras look is told without motion.
    assert TELE_INSIDE in passed(findings)


def test_small_images_are_not_compared(make_clip, tmp_path):
    findings = look(tmp_path, make_clip())
    assert {each.verdict for each in findings} == {Verdict.NOT_COMPARED}
    assert all("too small" in each.detail for each in findings)
