"""A quick look at many pairs of clips at once: whether they are alike enough for `thumbnail_alignment`.

Each pair is laid on each other under one warp, that of the key under which it met, along the same lines in time as in
the comparison in full. Times are rounded to a quarter of the images' spacing, so that most pairs share their lines.
"""

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from olt_datasets.tables.thumbnail_index import Places, Thumbnails
from olt_datasets.tables.thumbnail_keys import Packed
from olt_datasets.tables.time_lines import list_lines
from olt_toolkit.clips.fingerprint import COLUMNS, IMAGES, ROWS, unpack_signs

_LEAST_SCORE = 0.2
"""Of pairs that are compared in full. Copies have 0.27 and more; of a hundred pairs of other places, one by day."""
_LEAST_ALIKE, _STANDING = 0.8, 0.12
_PAIRS_AT_ONCE = 512
_RATIO_STEP = 0.02
_TINY = 1e-6

Floats = NDArray[np.float32]


def align_roughly(
    part: Thumbnails, index: Thumbnails, clips: Places, others: Places, looks: Packed, filled: Packed, probes: Places
) -> NDArray[np.bool_]:
    """Which pairs (m,) of clips of a part and others of an index are worth a comparison in full.

    Args:
        clips, others: (m,).
        looks, filled: thumbnails of the part as each probe sees them, and which cells it fills
            (`thumbnail_keys.pack_probes`).
        probes: (m,) the probe of each pair.
    """
    passed = np.zeros(len(clips), bool)
    for pairs, mine_at, theirs_at, lines in _group(part, index, clips, others):
        cells = _unpack(filled[probes[pairs]])[:, None] > 0.0
        mine = _unpack(looks[probes[pairs, None], part.starts[clips[pairs], None] + mine_at]) * cells
        theirs = unpack_signs(index.records["signs"][index.starts[others[pairs], None] + theirs_at]) * cells
        passed[pairs] = _is_near(mine, theirs, lines)
    return passed


def measure_rough_scores(mine: Floats, theirs: Floats, lines: Floats) -> tuple[Floats, Floats, Floats]:
    """Scores, mean correlations (g,) on the best line and shares of change (g,) of images (g, k, cells), (g, n, cells).

    Args:
        lines: (lines, k, n), 1 where images lie on each other.
    """
    count, flat = lines.sum(axis=(1, 2))[:, None], lines.reshape(len(lines), -1)
    on_mine, on_theirs = lines.sum(axis=2), lines.sum(axis=1)
    cells = np.abs(mine[:, 0]).sum(axis=1)
    changes, other_changes = (each - each.mean(axis=1, keepdims=True) for each in (mine, theirs))
    energy, other_energy = (np.einsum("gkc,gkc->kg", each, each) for each in (changes, other_changes))
    alike, moving = (
        flat @ (first @ second.transpose(0, 2, 1)).reshape(len(mine), -1).T
        for first, second in ((mine, theirs), (changes, other_changes))
    )
    alike /= count * cells
    moving /= np.sqrt((on_mine @ energy) * (on_theirs @ other_energy)) + _TINY
    scores = moving + 0.25 * alike - 0.6 / np.sqrt(count)
    activity = np.minimum(energy.mean(axis=0), other_energy.mean(axis=0)) / cells
    return scores.max(axis=0), alike.max(axis=0), activity


def _is_near(mine: Floats, theirs: Floats, lines: Floats) -> NDArray[np.bool_]:
    scores, alike, activity = measure_rough_scores(mine, theirs, lines)
    return (scores >= _LEAST_SCORE) | ((activity < _STANDING) & (alike >= _LEAST_ALIKE))


def _group(
    part: Thumbnails, index: Thumbnails, clips: Places, others: Places
) -> Iterator[tuple[Places, Places, Places, Floats]]:
    """Pairs (g,) with as many images at like times, which images (k,), (n,), and their lines (lines, k, n)."""
    mine, my_step = _round_times(part, clips)
    theirs, their_step = _round_times(index, others)
    ratio = np.round(np.log(their_step / my_step) / _RATIO_STEP).astype(np.int32)
    kinds, kind_of = np.unique(np.column_stack([mine, theirs, ratio]), axis=0, return_inverse=True)
    for number, kind in enumerate(kinds):
        pairs = np.flatnonzero(kind_of == number)
        lines = _lines(kind[:IMAGES].tobytes(), kind[IMAGES:-1].tobytes(), int(kind[-1]))
        for start in range(0, len(pairs), _PAIRS_AT_ONCE):
            yield pairs[start : start + _PAIRS_AT_ONCE], *map(np.arange, lines.shape[1:]), lines


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


def _unpack(words: Packed) -> Floats:
    """-1 or 1 (..., cells) of packed bits (..., 4)."""
    return unpack_signs(np.ascontiguousarray(words).view(np.uint8)[..., : ROWS * COLUMNS // 8])
