"""A quick look at many pairs of clips at once: whether they are alike enough for `thumbnail_alignment`.

Each pair is laid on each other under the one warp that suits the two images that are most alike, along the same lines
in time as in the comparison in full. Times are rounded to a quarter of the images' spacing, so that most pairs share
their lines.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from olt_datasets.tables.thumbnail_index import Places, Thumbnails
from olt_datasets.tables.thumbnail_warps import Warp, list_crops, stack_warps
from olt_datasets.tables.time_lines import list_lines
from olt_toolkit.clips.fingerprint import COLUMNS, IMAGES, ROWS, unpack_signs

_LEAST_SCORE = 0.2
"""Of pairs that are compared in full. Copies have more; of a hundred pairs of other places by day, one has."""
_LEAST_ALIKE, _STANDING = 0.8, 0.12
_WARPS = (*list_crops((0.87, 1.0, 1.15), (-1.0, 0.0, 1.0)), Warp(1.0, turn=-0.04), Warp(1.0, turn=0.04))
_PAIRS_AT_ONCE = 512
_RATIO_STEP = 0.02
_TINY = 1e-6

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class RoughPairs:
    """Pairs of clips of a part and of an index, with the two images of each that are most alike.

    Attributes:
        clips, others: (m,) of the part and of the index.
        mirrored: (m,) whether the first is mirrored.
        images, theirs: (m,) of the thumbnails of the part and of the index.
    """

    clips: Places
    others: Places
    mirrored: NDArray[np.bool_]
    images: Places
    theirs: Places


def align_roughly(part: Thumbnails, index: Thumbnails, pairs: RoughPairs) -> NDArray[np.bool_]:
    """Which pairs (m,) are worth a comparison in full."""
    passed = np.zeros(len(pairs.clips), bool)
    warps = np.empty(len(pairs.clips), np.int64)
    for start in range(0, len(warps), _PAIRS_AT_ONCE):
        some = slice(start, start + _PAIRS_AT_ONCE)
        mine = _signs(part, pairs.images[some, None], pairs.mirrored[some])[:, 0]
        warps[some] = _choose_warps(mine, _signs(index, pairs.theirs[some]))
    for some, lines in _group(part, index, pairs):
        count, other_count = lines.shape[1:]
        mine = _signs(part, part.starts[pairs.clips[some], None] + np.arange(count), pairs.mirrored[some])
        theirs = _signs(index, index.starts[pairs.others[some], None] + np.arange(other_count))
        warped, filled = _warp_each(mine, warps[some])
        passed[some] = _is_near(warped, theirs * filled[:, None], lines)
    return passed


def _choose_warps(mine: Floats, theirs: Floats) -> Places:
    """Under which warp (m,) images (m, cells) and (m, cells) are most alike."""
    stacked, filled = stack_warps(_WARPS)
    warped = (stacked @ mine.T).reshape(len(_WARPS), -1, len(mine))
    products = np.einsum("wcm,mc->wm", warped, theirs)
    norms = np.sqrt(np.einsum("wcm,wcm->wm", warped, warped) * filled.sum(axis=1)[:, None])
    return (products / norms).argmax(axis=0)


def _warp_each(images: Floats, warps: Places) -> tuple[Floats, Floats]:
    """Images (g, k, cells), each g under its own warp (g,), and the cells (g, cells) that each fills."""
    warped, all_filled = np.empty_like(images), stack_warps(_WARPS)[1]
    for warp in np.unique(warps):
        some = np.flatnonzero(warps == warp)
        matrix, _ = stack_warps((_WARPS[warp],))
        warped[some] = (matrix @ images[some].reshape(-1, images.shape[2]).T).T.reshape(-1, *images.shape[1:])
    return warped, all_filled[warps]


def _signs(thumbnails: Thumbnails, places: Places, mirrored: NDArray[np.bool_] | None = None) -> Floats:
    """-1 or 1 (..., cells) of thumbnails at places (m, ...)."""
    signs = unpack_signs(thumbnails.records["signs"][places])
    if mirrored is not None:
        images = signs[mirrored].reshape(-1, ROWS, COLUMNS)
        signs[mirrored] = images[..., ::-1].reshape(-1, *signs.shape[1:])
    return signs


def measure_rough_scores(mine: Floats, theirs: Floats, lines: Floats) -> tuple[Floats, Floats, Floats]:
    """Scores, mean correlations (g,) on the best line and shares of change (g,) of images (g, k, cells), (g, n, cells).

    Args:
        lines: (lines, k, n), 1 where images lie on each other.
    """
    count, flat = lines.sum(axis=(1, 2))[:, None], lines.reshape(len(lines), -1)
    on_mine, on_theirs = lines.sum(axis=2), lines.sum(axis=1)
    norms = [np.sqrt(np.einsum("gkc,gkc->g", each, each) / each.shape[1]) for each in (mine, theirs)]
    changes, other_changes = (each - each.mean(axis=1, keepdims=True) for each in (mine, theirs))
    energy, other_energy = (np.einsum("gkc,gkc->kg", each, each) for each in (changes, other_changes))
    alike, moving = (
        flat @ (first @ second.transpose(0, 2, 1)).reshape(len(mine), -1).T
        for first, second in ((mine, theirs), (changes, other_changes))
    )
    alike /= count * norms[0] * norms[1]
    moving /= np.sqrt((on_mine @ energy) * (on_theirs @ other_energy)) + _TINY
    scores = moving + 0.25 * alike - 0.6 / np.sqrt(count)
    activity = np.minimum(energy.mean(axis=0) / norms[0] ** 2, other_energy.mean(axis=0) / norms[1] ** 2)
    return scores.max(axis=0), alike.max(axis=0), activity


def _is_near(mine: Floats, theirs: Floats, lines: Floats) -> NDArray[np.bool_]:
    scores, alike, activity = measure_rough_scores(mine, theirs, lines)
    return (scores >= _LEAST_SCORE) | ((activity < _STANDING) & (alike >= _LEAST_ALIKE))


def _group(part: Thumbnails, index: Thumbnails, pairs: RoughPairs) -> Iterator[tuple[Places, Floats]]:
    """Pairs (g,) with as many images at like times, and their lines (lines, k, n)."""
    mine, my_step = _round_times(part, pairs.clips)
    theirs, their_step = _round_times(index, pairs.others)
    ratio = np.round(np.log(their_step / my_step) / _RATIO_STEP).astype(np.int32)
    kinds, kind_of = np.unique(np.column_stack([mine, theirs, ratio]), axis=0, return_inverse=True)
    for number, kind in enumerate(kinds):
        lines = _lines(kind[:IMAGES].tobytes(), kind[IMAGES:-1].tobytes(), int(kind[-1]))
        some = np.flatnonzero(kind_of == number)
        for start in range(0, len(some), _PAIRS_AT_ONCE):
            yield some[start : start + _PAIRS_AT_ONCE], lines


def _round_times(thumbnails: Thumbnails, clips: Places) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Times (m, 16) of each clip's images in quarters of their mean spacing, -1 for none, and the spacings (m,)."""
    counts = thumbnails.starts[clips + 1] - thumbnails.starts[clips]
    there = np.arange(IMAGES) < counts[:, None]
    at = np.minimum(thumbnails.starts[clips, None] + np.arange(IMAGES), len(thumbnails.records) - 1)
    since = thumbnails.records["time_ms"][at].astype(float)
    since -= since[:, :1]
    step = np.maximum(np.where(there, since, 0.0).max(axis=1) / np.maximum(counts - 1, 1), 1.0)
    return np.where(there, np.round(4.0 * since / step[:, None]), -1).astype(np.int32), step


@lru_cache(maxsize=256)
def _lines(mine: bytes, theirs: bytes, ratio: int) -> Floats:
    """Lines (lines, k, n) of images at such times, on both sides of equal length in time or the first the shorter."""
    my_times, their_times = (
        times[times >= 0] / 4.0 for times in (np.frombuffer(each, np.int32) for each in (mine, theirs))
    )
    their_times = their_times * np.exp(_RATIO_STEP * ratio)
    if my_times[-1] > their_times[-1]:
        return np.ascontiguousarray(_spread(their_times, my_times).transpose(0, 2, 1))
    return _spread(my_times, their_times)


def _spread(short: NDArray[np.float64], long: NDArray[np.float64]) -> Floats:
    """Lines (lines, k, n) of 1 where the image of the longer sequence lies on that of the shorter."""
    return (list_lines(short, long)[..., None] == np.arange(len(long))).astype(np.float32)
