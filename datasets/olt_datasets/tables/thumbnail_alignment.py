"""Whether two sequences of thumbnails show one drive: at any offset and half to double speed, cropped, turned.

All thumbnails of one sequence are warped alike, and laid on those of the other along a straight line in time, as
SeqSLAM does (M. Milford, G. Wyeth: SeqSLAM, ICRA 2012). Of the warp and line on which they are most alike, two numbers
are told: the mean correlation of the images, and that of what changes in them, of their differences from the mean of
the matched images. Drives of one camera have the bonnet, the horizon, the lane and the words on the image in common,
but none of what passes by.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from olt_datasets.tables.thumbnail_warps import SparseMatrix, Warp, list_crops, stack_warps
from olt_datasets.tables.time_lines import list_lines
from olt_toolkit.clips.fingerprint import COLUMNS, ROWS

SCALES = (0.8, 0.9, 1.0, 1.11, 1.25)
SHIFTS = (-1.0, -0.5, 0.0, 0.5, 1.0)
# Warps that are tried along lines in time: those that are best with each image on any other.
_WARPS_KEPT = 6
# A mean over few images is high by chance more often: by this over the root of their number.
_FEW_IMAGES = 0.35
_LEAST_SCORE, _LEAST_SCORE_OF_DIM = 0.55, 0.8
# What is less alike before the second is stretched, moved and turned is not so after.
_LEAST_ROUGH_SCORE = 0.25
_STANDING = 0.06
_LEAST_ALIKE_STANDING = 0.94
_WEIGHT_OF_CHANGES = 2.0
_TINY = 1e-6
# A crop's sides need not be equal, so that it may stretch what is left.
_NEAR = tuple(
    Warp(1.0 + enlarged, along, down, stretch=1.0 + stretched)
    for enlarged in (-0.06, 0.0, 0.06)
    for stretched in (-0.1, 0.0, 0.1)
    for along in (-0.5, 0.0, 0.5)
    for down in (-0.5, 0.0, 0.5)
)

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class Sequence:
    """Thumbnails (k, cells), -1 or 1, at ascending times (k,) in seconds; dim where most of them are (night)."""

    signs: Floats
    seconds: NDArray[np.float64]
    dim: bool = False

    @property
    def mirrored(self) -> "Sequence":
        """The same of mirrored images."""
        images = self.signs.reshape(-1, ROWS, COLUMNS)[:, :, ::-1]
        return Sequence(np.ascontiguousarray(images).reshape(self.signs.shape), self.seconds, self.dim)


@dataclass(frozen=True)
class Likeness:
    """How alike two sequences are.

    Attributes:
        alike: mean correlation of the matched images, -1 ... 1.
        moving: correlation of their differences from the mean of the matched images, -1 ... 1.
        activity: those differences' share of the energy, in the sequence where it is smaller: 0 for a standing clip.
        matched: how many images of the shorter sequence were matched.
        lag_s: how much later the second shows what the first shows, as the median over the matched images.
    """

    alike: float
    moving: float
    activity: float
    matched: int
    lag_s: float = 0.0

    @property
    def score(self) -> float:
        """What decides, between about 0 for other places and 1.25 for the same images; less where few are matched."""
        return float(self.moving + 0.25 * self.alike + 0.5 * min(self.activity, 0.3) - 0.6 / np.sqrt(self.matched))


def find_likeness(first: Sequence, second: Sequence) -> Likeness | None:
    """How alike two sequences are if they show one drive: what changes is alike, or next to nothing changes and all is.

    None where they do not. The limits are chosen on drives of KITTI and a dashcam and on synthetic worlds, among them
    pairs by night and pairs with the same bonnet and words on them; docs/benchmarks.md tells what they give on others.
    """
    rough, warp, line = _find_warp_and_line(*sorted((first, second), key=_duration))
    if rough < _LEAST_ROUGH_SCORE:
        return None
    found = _refine(first, second, warp, line)
    least = _LEAST_SCORE_OF_DIM if first.dim or second.dim else _LEAST_SCORE
    standing = found.activity < _STANDING and found.alike >= _LEAST_ALIKE_STANDING
    return found if found.score >= least or standing else None


def compare(first: Sequence, second: Sequence) -> Likeness:
    """How alike two sequences are where they are most so; mirrored ones are for the caller to try."""
    _, warp, line = _find_warp_and_line(*sorted((first, second), key=_duration))
    return _refine(first, second, warp, line)


def _find_warp_and_line(short: Sequence, long: Sequence) -> tuple[float, Warp, NDArray[np.int64]]:
    """A score, the crop, and which image of the longer sequence lies on each of the shorter (k,), its length for none.

    The score is infinite where one of them stands.
    """
    crops = list_crops(SCALES, SHIFTS)
    stacked, filled = stack_warps(crops)
    warped = _warp(stacked, short.signs)
    norms = np.sqrt(np.einsum("wkc,wkc->wk", warped, warped))
    # Of signs, where the warp fills cells.
    other_norms = np.sqrt(filled.sum(axis=1, keepdims=True))
    correlations = (warped @ long.signs.T) / (norms * other_norms + _TINY)[..., None]
    kept = np.argsort(_bounds(correlations))[-_WARPS_KEPT:]
    lines = _lines(short.seconds.tobytes(), long.seconds.tobytes())
    counts = (lines < len(long.signs)).sum(axis=1)
    alike = _sum_along(correlations[kept], lines) / counts
    moving = _correlate_changes_along(warped[kept], long.signs * filled[kept, None], lines)
    score = (alike + _WEIGHT_OF_CHANGES * moving) * (1.0 - _FEW_IMAGES / np.sqrt(counts))
    warp, line = np.unravel_index(score.argmax(), score.shape)
    standing = min(_activity(short), _activity(long)) < 2.0 * _STANDING
    rough = np.inf if standing else np.max(moving + 0.25 * alike - 0.6 / np.sqrt(counts))
    return float(rough), crops[kept[warp]], lines[line]


def _refine(first: Sequence, second: Sequence, warp: Warp, line: NDArray[np.int64]) -> Likeness:
    """How alike they are along a line where the longer is stretched, moved and turned a little as well."""
    short, long = sorted((first, second), key=_duration)
    hit = line < len(long.signs)
    mine, theirs = short.signs[hit], long.signs[line[hit]]
    stacked, filled = stack_warps((warp,))
    warped = _warp(stacked, mine)
    best, _ = _try(warped, filled, theirs, _NEAR)
    lag_s = float(np.median(long.seconds[line[hit]] - short.seconds[hit]))
    likeness = _try(warped, filled, theirs, _list_turned(best))[1]
    return replace(likeness, lag_s=lag_s if short is first else -lag_s)


def _try(warped: Floats, filled: Floats, theirs: Floats, near: tuple[Warp, ...]) -> tuple[Warp, Likeness]:
    """The best of some warps of `theirs` (n, cells) on images (1, n, cells) that fill cells (1, cells)."""
    stacked, near_filled = stack_warps(near)
    found = _measure(warped * near_filled[:, None], _warp(stacked, theirs) * filled[:, None])
    place = int(np.argmax([each.alike + _WEIGHT_OF_CHANGES * each.moving for each in found]))
    return near[place], found[place]


@lru_cache(maxsize=len(_NEAR))
def _list_turned(warp: Warp) -> tuple[Warp, ...]:
    """A warp turned by up to 3 degrees, and moved by a quarter of a cell."""
    return tuple(
        replace(warp, along=warp.along + along, down=warp.down + down, turn=turn)
        for along in (-0.25, 0.0, 0.25)
        for down in (-0.25, 0.0, 0.25)
        for turn in (-0.05, -0.025, 0.0, 0.025, 0.05)
    )


def _activity(sequence: Sequence) -> float:
    """Share of the energy that is in the differences from the mean image."""
    return float(1.0 - np.mean(sequence.signs.mean(axis=0) ** 2))


def _duration(sequence: Sequence) -> float:
    return float(sequence.seconds[-1] - sequence.seconds[0])


def _warp(stacked: SparseMatrix, signs: Floats) -> Floats:
    """Images (warps, k, cells) of thumbnails (k, cells)."""
    return (stacked @ signs.T).reshape(-1, signs.shape[1], len(signs)).transpose(0, 2, 1)


def _bounds(correlations: Floats) -> Floats:
    """For each warp, the mean over the better half of the images of the best correlation of each."""
    best = np.sort(correlations.max(axis=2), axis=1)
    return best[:, best.shape[1] // 2 :].mean(axis=1)


@lru_cache(maxsize=256)
def _lines(short: bytes, long: bytes) -> NDArray[np.int64]:
    """`time_lines.list_lines` of times as bytes, so that sequences with equal times share their lines."""
    return list_lines(np.frombuffer(short), np.frombuffer(long))


def _sum_along(values: Floats, lines: NDArray[np.int64]) -> Floats:
    """Sums (warps, lines) of values (warps, k, m) along lines (lines, k), m for no value."""
    padded = np.pad(values, ((0, 0), (0, 0), (0, 1)))
    return padded[:, np.arange(values.shape[1]), lines].sum(axis=2)


def _correlate_changes_along(mine: Floats, theirs: Floats, lines: NDArray[np.int64]) -> Floats:
    """Correlation (warps, lines) of images (warps, k, cells), (warps, m, cells) without the mean of each sequence."""
    changes, other_changes = mine - mine.mean(axis=1, keepdims=True), theirs - theirs.mean(axis=1, keepdims=True)
    hit = (lines < theirs.shape[1]).astype(np.float32)
    energy = (changes**2).sum(axis=2) @ hit.T
    other_energy = np.pad((other_changes**2).sum(axis=2), ((0, 0), (0, 1)))[:, lines].sum(axis=2)
    products = changes @ other_changes.transpose(0, 2, 1)
    return _sum_along(products, lines) / (np.sqrt(energy * other_energy) + _TINY)


def _measure(mine: Floats, theirs: Floats) -> list[Likeness]:
    """How alike matched images (warps, n, cells) are, for each warp."""
    norms = np.sqrt((mine**2).sum(axis=2) * (theirs**2).sum(axis=2))
    alike = ((mine * theirs).sum(axis=2) / (norms + _TINY)).mean(axis=1)
    changes, other_changes = (each - each.mean(axis=1, keepdims=True) for each in (mine, theirs))
    energy, other_energy = ((each**2).sum(axis=(1, 2)) for each in (changes, other_changes))
    moving = (changes * other_changes).sum(axis=(1, 2)) / (np.sqrt(energy * other_energy) + _TINY)
    shares = [part / ((each**2).sum(axis=(1, 2)) + _TINY) for part, each in ((energy, mine), (other_energy, theirs))]
    columns = (alike.tolist(), moving.tolist(), np.minimum(*shares).tolist())
    return [Likeness(*row, mine.shape[1]) for row in zip(*columns, strict=True)]
