"""What may be wrong with a clip's images and motion, as hypotheses that its images can be held against."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from olt_generator.poses import Array, make_pose
from olt_toolkit.clips.clip import EgoMotion
from olt_toolkit.clips.verification.image_evidence import Hypothesis, Poses, Times

PoseAt = Callable[[Times], Poses]

# Left becomes right.
_MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])


@lru_cache
def shifted(seconds: float) -> Hypothesis:
    """The images were taken so much later than the clip says."""
    return Hypothesis(times=lambda times_us: times_us + round(seconds * 1e6))


@lru_cache
def at_rate(factor: float) -> Hypothesis:
    """Time passes so many times as fast as the clip says, from the first image on."""
    return Hypothesis(times=lambda times_us: times_us[0] + np.rint((times_us - times_us[0]) * factor).astype(np.int64))


@lru_cache
def scaled(factor: float) -> Hypothesis:
    """The vehicle drove so many times as far as the clip says."""

    def motion(poses: PoseAt, times_us: Times) -> Poses:
        said = poses(times_us)
        return make_pose(said[:, :3, :3], factor * said[:, :3, 3])

    return Hypothesis(motion=motion)


FRAMES_REVERSED = Hypothesis(times=lambda times_us: times_us[::-1])
IMAGES_MIRRORED = Hypothesis(mirrored=True)
MOTION_MIRRORED = Hypothesis(motion=lambda poses, times_us: _MIRROR @ poses(times_us) @ _MIRROR)


def _turned_back(said: Poses) -> Array:
    return make_pose(np.swapaxes(said[:, :3, :3], 1, 2), said[:, :3, 3])


TURNS_INVERTED = Hypothesis(motion=lambda poses, times_us: _turned_back(poses(times_us)))
"""Rotations are those from the rig to the world, or their sign is another."""


def motion_reversed(span_us: tuple[int, int]) -> Hypothesis:
    """The motion is given backward in time over its span."""
    total = span_us[0] + span_us[1]
    return Hypothesis(motion=lambda poses, times_us: poses(total - times_us))


def motion_of(other: EgoMotion) -> Hypothesis:
    """The vehicle moved as another clip says."""
    low, high = other.span_us
    return Hypothesis(motion=lambda _, times_us: other.interpolate(np.clip(times_us, low, high)), span_us=(low, high))
