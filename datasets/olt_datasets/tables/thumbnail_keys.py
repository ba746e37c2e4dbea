"""Keys under which thumbnails that look alike meet: candidates for near-duplicates without comparing all pairs.

Each table of keys has a few dozen bits a thumbnail, and each bit tells on which side of a random plane it lies
(locality sensitive hashing: M. Charikar, Similarity estimation techniques from rounding algorithms, STOC 2002). Planes
are random in the space of the thumbnail's low spatial frequencies, which a crop, a turn or a few metres of driving
change least, without those that are even along a row: sky above and road below are alike in all drives. They go through
the middle of the thumbnails that are indexed, so that what most of them have in common, such as lanes that meet at the
horizon, tells nothing either.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from olt_datasets.tables.thumbnail_warps import list_crops, stack_warps
from olt_generator.seeds import make_generator
from olt_toolkit.clips.fingerprint import COLUMNS, IMAGES, ROWS

WAVES_ALONG, WAVES_DOWN = 6, 4
_FEWEST_BITS, _MOST_BITS = 10, 32
# Bits beyond those that number all thumbnails: every other one meets another by chance, which costs little.
_SPARE_BITS = 1
_PROBED_SCALES = (0.85, 1.0, 1.18)

_COMMON_SHARE, _FEW_CLIPS = 0.8, 100

Signs = NDArray[np.float32]
Keys = NDArray[np.uint64]
Packed = NDArray[np.uint64]


@dataclass(frozen=True)
class Effort:
    """How much is spent on candidates; what is asked of small tables would take too long for large ones.

    Attributes:
        tables: tables of keys.
        bits: bits of a key.
        scales: sizes at which thumbnails are looked up, each as it is and mirrored.
    """

    tables: int
    bits: int
    scales: tuple[float, ...]

    @property
    def probes(self) -> int:
        """Keys of a table under which a thumbnail is looked up."""
        return 2 * len(self.scales)


LARGE_TABLE = 100_000
"""Clips, above which fewer keys are looked up."""


def choose_effort(clips: int) -> Effort:
    """The effort for a search among so many clips."""
    bits = int(np.clip(np.ceil(np.log2(IMAGES * max(clips, 1))) + _SPARE_BITS, _FEWEST_BITS, _MOST_BITS))
    return Effort(8, bits, _PROBED_SCALES) if clips <= LARGE_TABLE else Effort(8, bits, (1.0,))


def measure_middle(signs: Signs, clips: int) -> Signs:
    """What thumbnails (n, cells) of so many clips have in common: amplitudes (waves,). Of few clips, little."""
    return (_COMMON_SHARE * clips / (clips + _FEW_CLIPS)) * (signs.mean(axis=0) @ _waves().T)


def make_keys(signs: Signs, middle: Signs, effort: Effort) -> Keys:
    """Keys (tables, n) of thumbnails (n, cells)."""
    return _round_to_keys(signs @ _waves().T - middle, effort)


def make_probes(signs: Signs, middle: Signs, effort: Effort) -> Keys:
    """Keys (tables, probes, n) under which what looks like thumbnails (n, cells) may be; odd probes are mirrored."""
    stacked, _ = stack_warps(list_crops(effort.scales, (0.0,)))
    waves = _waves()
    parity: Signs = np.repeat([(-1.0) ** wave for wave in range(1, WAVES_ALONG + 1)], WAVES_DOWN).astype(np.float32)
    probes = []
    for warp in np.split(stacked.toarray(), len(effort.scales)):
        amplitudes: Signs = signs @ (waves @ warp).T
        probes += [_round_to_keys(each - middle, effort) for each in (amplitudes, amplitudes * parity)]
    return np.stack(probes, axis=1)


def pack_probes(signs: Signs, effort: Effort) -> tuple[Packed, Packed]:
    """Thumbnails (n, cells) as each probe sees them: their signs (probes, n, 4), and the cells it fills (probes, 4)."""
    stacked, filled = stack_warps(list_crops(effort.scales, (0.0,)))
    warped = (stacked @ signs.T).reshape(len(filled), -1, len(signs)).transpose(0, 2, 1) > 0.0
    return _pack_with_mirrored(warped), _pack_with_mirrored(filled[:, None] > 0.0)[:, 0]


def pack(signs: NDArray[np.uint8]) -> Packed:
    """Bits (..., cells / 8) as words (..., 4), the last ones zero."""
    words = np.zeros((*signs.shape[:-1], -(-signs.shape[-1] // 8)), np.uint64)
    words.view(np.uint8)[..., : signs.shape[-1]] = signs
    return words


def _pack_with_mirrored(cells: NDArray[np.bool_]) -> Packed:
    """Bits (2 x warps, n, 4) of cells (warps, n, cells): odd ones of the mirrored image."""
    images = cells.reshape(*cells.shape[:2], ROWS, COLUMNS)
    both = np.stack([images, images[..., ::-1]], axis=1)
    return pack(np.packbits(both.reshape(-1, *cells.shape[1:]), axis=2))


@lru_cache(maxsize=1)
def _waves() -> Signs:
    """Cosines (waves, cells): those along a row slowest, without the constant along a row."""
    along = np.cos(np.pi * np.arange(1, WAVES_ALONG + 1)[:, None] * (np.arange(COLUMNS) + 0.5) / COLUMNS)
    down = np.cos(np.pi * np.arange(WAVES_DOWN)[:, None] * (np.arange(ROWS) + 0.5) / ROWS)
    down[0] /= np.sqrt(2.0)
    return np.einsum("ax,dy->adyx", along, down).reshape(-1, ROWS * COLUMNS).astype(np.float32)


@lru_cache(maxsize=4)
def _planes(tables: int, bits: int) -> Signs:
    planes = make_generator("planes of thumbnail keys").standard_normal((8 * _MOST_BITS, WAVES_ALONG * WAVES_DOWN))
    return planes[: tables * bits].astype(np.float32)


def _round_to_keys(amplitudes: Signs, effort: Effort) -> Keys:
    sides = (amplitudes @ _planes(effort.tables, effort.bits).T > 0.0).reshape(len(amplitudes), effort.tables, -1)
    padded = np.zeros((*sides.shape[:2], 32), bool)
    padded[..., : effort.bits] = sides
    keys = np.packbits(padded, axis=2).view(">u4")[..., 0]
    return keys.T.astype(np.uint64)
