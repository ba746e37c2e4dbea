"""When what was recorded is there: times, gaps, and motion that no road user makes.

Between two samples an agent moves on a line. Across a gap of more than MOST_GAP_US, and between samples that nothing on
a road gets from one to the other, nobody knows that it was there: it ends and begins anew, as another agent, so that no
ghost is driven around, filmed or hit. The ego has one drive: of one with such a gap the longest stretch is kept.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scenes.presence import FASTEST, jumps, stretches_between
from olt_closed_loop.scenes.scene import Agent
from olt_generator.errors import InputError
from olt_generator.poses import Array
from olt_generator.trajectory import Trajectory

MOST_GAP_US = 500_000
"""Time between annotations by hand at 2 Hz (nuScenes): no recording is known better. Half a second of a 3 m/s^2 bend is
0.09 m off its chord."""
FARTHEST_FROM_EGO = 20_000.0
"""Metres from the start of the drive: what is farther away is in another frame or unit."""
LARGEST_BOX = 100.0
"""Metres; the longest on roads are trams."""
_STEP_SECONDS = (0.01, 0.25)
_SHORTEST_WAY = 5.0
_ALONG = float(np.cos(np.pi / 4.0))

Times = NDArray[np.int64]


@dataclass(frozen=True)
class Track:
    """What a file says of a road user or object, before it is checked; the fields are those of `scene.Agent`."""

    id: str
    label: str
    length: float
    width: float
    height: float
    timestamps_us: Times
    poses: Array


def check_times(times_us: Times, where: str) -> None:
    """Raise an `InputError` unless times increase in steps that recordings of drives have."""
    if len(times_us) < 2:
        raise InputError(f"{where}: {len(times_us)} times; a drive has more")
    steps = np.diff(times_us)
    if steps.min() <= 0:
        index = int(np.argmax(steps <= 0)) + 1
        what = "repeats" if steps[index - 1] == 0 else "is before"
        raise InputError(f"{where}: time {index} ({times_us[index] * 1e-6:.6f} s) {what} the one before it")
    typical = float(np.median(steps)) * 1e-6
    if not _STEP_SECONDS[0] <= typical <= _STEP_SECONDS[1]:
        low, high = _STEP_SECONDS
        raise InputError(f"{where}: steps of {typical:g} s, {low:g} to {high:g} s are expected; is it another unit?")


def whole_microseconds(seconds: Array) -> Times:
    """Times (n,) in microseconds from the first on, cut to 1e12 s, as far as integers reach."""
    return np.round(np.clip(seconds - seconds[0], -1e12, 1e12) * 1e6).astype(np.int64)


def check_motion(ego: Trajectory, where: str) -> None:
    """Raise an `InputError` unless the ego moves as a car can, forwards or backwards along its heading."""
    ways = np.diff(ego.positions[:, :2], axis=0)
    lengths, seconds = np.linalg.norm(ways, axis=1), np.diff(ego.times)
    if np.any(lengths > FASTEST * seconds):
        index = int(np.argmax(lengths > FASTEST * seconds))
        raise InputError(
            f"{where}: the ego moves {lengths[index]:.0f} m in the {seconds[index]:.2f} s before "
            f"{ego.times[index + 1]:.2f} s; positions are metres, and steps without a pose are not valid"
        )
    heading = ego.T_world_rig[:-1, :2, 0]
    along = np.abs(np.einsum("ni,ni->n", ways, heading)).sum()
    if lengths.sum() > _SHORTEST_WAY and along < _ALONG * lengths.sum():
        raise InputError(f"{where}: the ego does not drive where its heading points; headings are radians from x")


def longest_stretch(times_us: Times) -> slice:
    """The samples of the longest stretch without a gap of more than MOST_GAP_US; the first of several."""
    stretches = stretches_between(np.diff(times_us) > MOST_GAP_US)
    return max(stretches, key=lambda part: int(times_us[part][-1] - times_us[part][0]))


def agents_of(track: Track, end_us: int, where: str) -> Iterator[Agent]:
    """The agent of a track in stretches without gaps, from time 0 to `end_us`, called `id`, `id#2`, `id#3`, ...

    Samples are those of the drive's frame, whose origin is the ego's first position.

    Raises:
        InputError: times do not increase, a sample is not finite or too far away, or the box has no usual size.
    """
    # A row that is there twice is one.
    same = np.all(np.diff(track.poses, axis=0) == 0.0, axis=1) & (np.diff(track.timestamps_us) == 0)
    once = np.concatenate([[True], ~same])
    times_us, poses = track.timestamps_us[once], track.poses[once]
    size = track.length, track.width, track.height
    check_samples(times_us, poses, where)
    check_box(size, where)
    away = (np.diff(times_us) > MOST_GAP_US) | jumps(times_us, poses[:, :2])
    number = 0
    for part in stretches_between(away):
        inside = np.flatnonzero((times_us[part] >= 0) & (times_us[part] <= end_us)) + part.start
        if len(inside):
            number += 1
            name = track.id if number == 1 else f"{track.id}#{number}"
            yield Agent(name, track.label, *size, times_us[inside], poses[inside])


def check_box(size: tuple[float, float, float], where: str) -> None:
    """Raise an `InputError` unless length, width and height in metres are those of something on a road."""
    if not all(0.0 < side <= LARGEST_BOX for side in size):
        raise InputError(f"{where}: a box of {' x '.join(f'{side:g}' for side in size)} m")


def check_samples(times_us: Times, poses: Array, where: str) -> None:
    """Raise an `InputError` unless poses (n, 4) from the ego's start are finite and near, at times (n,) that rise."""
    wrong = ~(np.abs(poses) <= FARTHEST_FROM_EGO).all(axis=1)
    if wrong.any():
        index = int(np.argmax(wrong))
        place = ", ".join(f"{value:g}" for value in poses[index])
        raise InputError(f"{where} at {times_us[index] * 1e-6:.2f} s: x, y, z, heading {place} from the ego")
    if np.any(np.diff(times_us) <= 0):
        index = int(np.argmax(np.diff(times_us) <= 0))
        raise InputError(f"{where}: two samples at {times_us[index] * 1e-6:.2f} s that differ")


def listed(names: Sequence[str]) -> str:
    """The first few names in words."""
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return ", ".join(f"{name:.40}" for name in names[:3]) + more


def word_away(names: Sequence[str]) -> str:
    """What was done with agents that are away for a while."""
    return (
        f"{len(names)} agents ({listed(names)}) are away for more than {MOST_GAP_US * 1e-6:g} s or jump: each is "
        "another agent (#2, ...) when it is back"
    )
