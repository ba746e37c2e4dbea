"""Frames that repeat the one before them: padding to another frame rate, pulldown, a recorder that hangs.

A repeated frame differs from the one before it only by what coding changed, while the frames around it move on. A
vehicle that stands looks as still, but it comes to rest and sets off by and by, and the noise of the camera goes on.
"""

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
# of 2.5 from frame to frame, repeated frames by 1/20 of the others after usual coding (docs/formats/video.md).
_STILL_SHARE = 0.2
# Frames around: those up to so many seconds away. Pictures that are held longer are a freeze.
_HELD_SECONDS = 0.25
# Changes in grey levels below which nothing is said about frames between, or about a freeze.
_LEAST_CHANGE, _LEAST_DRIVING = 0.5, 1.0
# A picture that freezes stops from full motion: the last so many changes are above this share of those of a second.
_ABRUPT_CHANGES, _ABRUPT_SHARE, _ABRUPT_SECONDS = 3, 0.5, 1.0
# And it is still at once: so many changes are below this share.
_REST_CHANGES, _REST_SHARE = 5, 0.05
# A pattern has at most so many frames, is seen so often, and followed by so many frames of each turn.
_LONGEST_PERIOD, _LEAST_PERIODS, _PATTERN_SHARE = 6, 5, 0.8


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
    repeats[1:], tells = _held_frames(changes, seconds)
    by_turns = _repeats_by_turns(repeats, tells)
    if by_turns is not None:
        # Frames that were coded anew change more, and slow ones less, than tells them; their turn does.
        repeats[1:] = by_turns[np.arange(1, len(frames)) % len(by_turns)]
    showings = None if by_turns is None else _showings(by_turns)
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


def _held_frames(
    changes: NDArray[np.float64], seconds: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether each change (n - 1,) is that of a repeated frame between frames that move on; and whether those do."""
    held, tells = np.zeros((2, len(changes)), bool)
    for index, change in enumerate(changes):
        start = np.searchsorted(seconds, seconds[index] - _HELD_SECONDS)
        end = np.searchsorted(seconds, seconds[index + 1] + _HELD_SECONDS, side="right") - 1
        # Near an end of the video only the other side tells.
        before, after = changes[start:index], changes[index + 1 : end]
        around = [
            side.max()
            for side, is_whole in ((before, start > 0), (after, end < len(changes)))
            if is_whole and len(side)
        ]
        tells[index] = bool(around) and min(around) > _LEAST_CHANGE
        held[index] = tells[index] and min(around) > change / _STILL_SHARE
    return held, tells


def _freezes(
    changes: NDArray[np.float64], seconds: NDArray[np.float64], repeats: NDArray[np.bool_]
) -> Iterator[Freeze]:
    """Stretches that begin and end abruptly, or lie at an end of the video and do so at the other end."""
    # Changes to repeated frames say nothing about motion.
    told = np.flatnonzero(~repeats[1:])
    changes, starts, ends = changes[told], seconds[told], seconds[told + 1]
    index = 0
    while index < len(told):
        level = _driving_level(changes[:index][::-1], starts[:index][::-1])
        if index == 0:
            begun = int(np.argmax(changes > _LEAST_DRIVING))
            level = _driving_level(changes[begun + 1 :], starts[begun + 1 :])
        end = index + _still_changes(changes[index:], level)
        if end > index and ends[end - 1] - starts[index] > _HELD_SECONDS:
            # The change with which the picture goes on is as large as what was missed.
            after = _driving_level(changes[end + 1 :], starts[end + 1 :])
            goes_on = end == len(told) or np.median(changes[index:end]) < _STILL_SHARE * after
            # Who comes to rest, or sets off, still moves a little for a while.
            next_to_motion = changes[index:end][:_REST_CHANGES] if index > 0 else changes[:end][-_REST_CHANGES:]
            is_abrupt = np.median(next_to_motion) < _REST_SHARE * level
            if goes_on and is_abrupt and end - index < len(told):
                # Coding may take one more frame to bring the first that repeats as near as the others.
                settles = index > 0 and changes[index - 1] < _ABRUPT_SHARE * level
                yield Freeze(int(told[index - settles]), int(told[end - 1]) + 1)
        index = max(end, index + 1)


def _still_changes(changes: NDArray[np.float64], level: float) -> int:
    """How many changes from the first on are far below the level of driving, but for single ones at key frames."""
    still = np.append(changes < _STILL_SHARE * level, False)
    is_single = still[:-2] & still[2:] & (changes[1:] < level)
    still[1:-1] |= is_single
    return int(np.argmin(still))


def _driving_level(changes: NDArray[np.float64], seconds: NDArray[np.float64]) -> float:
    """The median of the first changes if motion is as fast there as in the second that they begin, and 0 if it is not.

    Times may run backwards.
    """
    if len(changes) < _ABRUPT_CHANGES:
        return 0.0
    nearest = float(np.median(changes[:_ABRUPT_CHANGES]))
    around = float(np.median(changes[np.abs(seconds - seconds[0]) <= _ABRUPT_SECONDS]))
    return nearest if nearest > max(_LEAST_DRIVING, _ABRUPT_SHARE * around) else 0.0


def _repeats_by_turns(repeats: NDArray[np.bool_], tells: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """Whether frames repeat by their number modulo the shortest period that nearly all that tell follow; else None."""
    numbers = 1 + np.flatnonzero(tells)
    for period in range(2, _LONGEST_PERIOD + 1):
        if len(numbers) < _LEAST_PERIODS * period:
            return None
        counts = np.bincount(numbers % period, minlength=period)
        shares = np.bincount(numbers % period, repeats[numbers], minlength=period) / np.maximum(counts, 1)
        by_turns = shares > 0.5
        if counts.all() and by_turns.any() and np.all(np.abs(shares - by_turns) <= 1.0 - _PATTERN_SHARE):
            return by_turns
    return None


def _showings(by_turns: NDArray[np.bool_]) -> tuple[int, ...]:
    """How often each picture is shown, from the first that is not shown before."""
    firsts = np.flatnonzero(~by_turns)
    return tuple(np.diff(np.append(firsts, firsts[0] + len(by_turns))).tolist())
