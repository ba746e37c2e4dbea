"""Frames that repeat the one before them: padding to another frame rate, pulldown, a recorder that hangs.

A repeated frame differs from the one before it only by what coding changed, while the frames around it move on. A
vehicle that stands looks as still, but it comes to rest and sets off by and by, and the noise of the camera goes on.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

# Changes of brightness are measured at this width, as the median over those blocks that have more texture than others,
# so that neither an even sky nor traffic or a wiper in a part of the picture decides.
_WORKING_WIDTH = 208
_BLOCK = 13
# A repeated frame changes less than this share of what the frames around it do. Driving changes by less than a factor
# of 2.5 from frame to frame, and repeated frames by 1/40 of the others even after coding (docs/formats/video.md).
_STILL_SHARE = 0.2
# Frames around: those up to so many seconds away. Pictures that are held longer are a freeze.
_HELD_SECONDS = 0.25
# Changes in grey levels below which nothing is said about frames between, or about a freeze.
_LEAST_CHANGE, _LEAST_DRIVING = 0.5, 1.0
# A picture that freezes stops from full motion: the last so many changes are not below this share of those of a second.
_ABRUPT_CHANGES, _ABRUPT_SHARE, _ABRUPT_SECONDS = 3, 0.5, 1.0
_LONGEST_PATTERN, _PATTERN_SHARE = 6, 0.9


@dataclass(frozen=True)
class Freeze:
    """The picture stands still from one frame to another, both included, while the vehicle drives."""

    first: int
    last: int


@dataclass(frozen=True)
class RepeatedFrames:
    """Which frames of a video repeat others.

    Attributes:
        repeats: (n,) whether a frame shows the picture of the one before it again.
        showings: how often each picture is shown, by turns: (2,) where every second frame repeats, (2, 3) for 24
            pictures in 60 frames; None where there is no such pattern or nothing repeats.
        freezes: where one picture is held for longer than a quarter of a second; its frames are among `repeats`.
    """

    repeats: NDArray[np.bool_]
    showings: tuple[int, ...] | None
    freezes: tuple[Freeze, ...]


def find_repeated_frames(frames: NDArray[np.uint8], timestamps_us: NDArray[np.int64]) -> RepeatedFrames:
    """Find the repeated frames among frames (n, H, W, 3) RGB, shown at times (n,)."""
    repeats = np.zeros(len(frames), bool)
    if len(frames) < 3:
        return RepeatedFrames(repeats, None, ())
    seconds = 1e-6 * (timestamps_us - timestamps_us[0])
    changes = _changes(frames)
    repeats[1:] = _held_frames(changes, seconds)
    showings = _showings_by_turns(repeats)
    freezes = tuple(_freezes(changes, seconds, repeats))
    for freeze in freezes:
        repeats[freeze.first + 1 : freeze.last + 1] = True
    return RepeatedFrames(repeats, showings, freezes)


def _changes(frames: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Grey levels (n - 1,) by which each frame differs from the one before it."""
    height, width = frames.shape[1:3]
    size = (width, height)
    if width > _WORKING_WIDTH:
        size = (_WORKING_WIDTH, max(1, round(height * _WORKING_WIDTH / width)))
    changes, before = np.empty(len(frames) - 1), None
    for number, frame in enumerate(frames):
        grey = cv2.resize(cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY), size, interpolation=cv2.INTER_AREA)
        grey = grey.astype(np.float32)
        if before is not None:
            slopes = np.abs(np.diff(before, axis=1, append=before[:, -1:]))
            texture, change = _block_means(slopes), _block_means(np.abs(grey - before))
            changes[number - 1] = np.median(change[texture >= np.median(texture)])
        before = grey
    return changes


def _block_means(image: NDArray[np.float32]) -> NDArray[np.float32]:
    size = tuple(max(1, round(side / _BLOCK)) for side in image.shape[::-1])
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32)


def _held_frames(changes: NDArray[np.float64], seconds: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether each change (n - 1,) is that of a repeated frame between frames that move on."""
    held = np.zeros(len(changes), bool)
    for index, change in enumerate(changes):
        start = np.searchsorted(seconds, seconds[index] - _HELD_SECONDS)
        end = np.searchsorted(seconds, seconds[index + 1] + _HELD_SECONDS, side="right") - 1
        around = [each.max() for each in (changes[start:index], changes[index + 1 : end]) if len(each)]
        held[index] = bool(around) and min(around) > max(_LEAST_CHANGE, change / _STILL_SHARE)
    return held


def _freezes(
    changes: NDArray[np.float64], seconds: NDArray[np.float64], repeats: NDArray[np.bool_]
) -> Iterator[Freeze]:
    """Stretches that begin and end abruptly, or lie at an end of the video and do so at the other end."""
    moving = np.flatnonzero(~repeats[1:])
    index = 0
    while index < len(changes):
        before = _driving_level(changes, seconds, moving[moving < index][::-1])
        still = _STILL_SHARE * (before if index > 0 else _first_driving_level(changes, seconds, moving))
        end = index
        while end < len(changes) and changes[end] < still:
            end += 1
        # The change with which the picture goes on is as large as what was missed.
        after = _driving_level(changes, seconds, moving[moving > end])
        goes_on = end == len(changes) or changes[index:end].max(initial=0.0) < _STILL_SHARE * after
        if seconds[end] - seconds[index] > _HELD_SECONDS and goes_on and (index > 0 or end < len(changes)):
            yield Freeze(index, end)
        index = max(end, index + 1)


def _driving_level(changes: NDArray[np.float64], seconds: NDArray[np.float64], moving: NDArray[np.int64]) -> float:
    """The least of the nearest changes if motion is as fast there as in the second around it, and 0 if it is not.

    `moving` are the changes that are no repeated frames', the nearest first.
    """
    if len(moving) < _ABRUPT_CHANGES:
        return 0.0
    within = moving[np.abs(seconds[moving] - seconds[moving[0]]) <= _ABRUPT_SECONDS]
    nearest = float(changes[moving[:_ABRUPT_CHANGES]].min())
    is_abrupt = nearest > max(_LEAST_DRIVING, _ABRUPT_SHARE * float(np.median(changes[within])))
    return nearest if is_abrupt else 0.0


def _first_driving_level(
    changes: NDArray[np.float64], seconds: NDArray[np.float64], moving: NDArray[np.int64]
) -> float:
    """The level at which a video that begins with a held picture goes on; 0 where it begins otherwise."""
    starts = moving[changes[moving] > _LEAST_DRIVING]
    return 0.0 if len(starts) == 0 else _driving_level(changes, seconds, moving[moving > starts[0]])


def _showings_by_turns(repeats: NDArray[np.bool_]) -> tuple[int, ...] | None:
    """The shortest pattern of showings that nearly all pictures follow; the first and last may be cut short."""
    shown_first = np.flatnonzero(~repeats)
    showings = np.diff(shown_first)[1:]
    if not repeats.any() or len(showings) < 3:
        return None
    for period in range(1, min(_LONGEST_PATTERN, len(showings) // 2) + 1):
        if np.mean(showings[period:] == showings[:-period]) >= _PATTERN_SHARE:
            turns = [Counter(showings[turn::period].tolist()).most_common(1)[0][0] for turn in range(period)]
            return tuple(turns) if max(turns) > 1 else None
    return None
