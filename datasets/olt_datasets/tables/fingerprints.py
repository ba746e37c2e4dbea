"""Near-duplicates: clips whose front images look alike, found by their perceptual hashes.

Two images are alike where their 64-bit hashes differ in at most `LARGEST_DISTANCE` bits. The search for such pairs is
exact and not quadratic: with the bits dealt out to `LARGEST_DISTANCE` + 1 bands, a pair that differs in no more bits
than there are bands less one agrees in a whole band, so only hashes that share a band are compared (M. Manku, A. Jain,
A. Das Sarma: Detecting near-duplicates for web crawling, WWW 2007).
"""

from collections.abc import Iterator

import numpy as np
import polars as pl
from numpy.typing import NDArray

LARGEST_DISTANCE = 3
ALIKE_IMAGES = 3
"""As many of the five images of each of two clips must have a like one in the other."""

# An image whose brightness hardly ever falls to the right (fog, night, a plain wall) has next to nothing to compare.
LEAST_SET_BITS = 8
_BANDS = LARGEST_DISTANCE + 1
_BAND_VALUES = 1 << (64 // _BANDS)
_PAIRS_AT_ONCE = 1 << 21

Hashes = NDArray[np.uint64]
Pairs = NDArray[np.int64]


def is_telling(fingerprints: pl.Series) -> pl.Series:
    """Whether each clip can be compared at all: not one without a fingerprint, and none that shows fog or a wall."""
    owners, _ = _flatten(fingerprints)
    return pl.Series("telling", np.isin(np.arange(len(fingerprints)), owners))


def find_near_duplicates(first: pl.Series, second: pl.Series) -> Pairs:
    """Places (m, 2), ascending, of the clips of two lists that are near-duplicates.

    A fingerprint is what `fingerprint_images` gives, None where a clip has none.
    """
    owners, hashes = _flatten(first)
    other_owners, other_hashes = _flatten(second)
    image, other = find_close_hashes(hashes, other_hashes).T
    table = pl.DataFrame({"clip": owners[image], "other": other_owners[other], "image": image, "other_image": other})
    # The pairs of clips of which enough images, on both sides, have a like one.
    alike = (
        table.group_by("clip", "other")
        .agg(pl.col("image").n_unique(), pl.col("other_image").n_unique())
        .filter(pl.min_horizontal("image", "other_image") >= ALIKE_IMAGES)
        .sort("clip", "other")
    )
    return alike.select("clip", "other").to_numpy()


def find_close_hashes(first: Hashes, second: Hashes) -> Pairs:
    """Places (m, 2) of the hashes (n,) and (k,) that differ in at most `LARGEST_DISTANCE` bits, ascending."""
    bands, other_bands = _bands(first), _bands(second)
    close = [np.empty((0, 2), np.int64)]
    for band, other_band in zip(bands, other_bands, strict=True):
        for pairs in _pairs_sharing(band, other_band):
            distance = np.bitwise_count(first[pairs[:, 0]] ^ second[pairs[:, 1]])
            close.append(pairs[distance <= LARGEST_DISTANCE])
    return np.unique(np.concatenate(close), axis=0)


def _flatten(fingerprints: pl.Series) -> tuple[NDArray[np.int64], Hashes]:
    """All hashes (n,) that can be compared, and the places (n,) of their clips."""
    known = pl.DataFrame({"hash": fingerprints}).with_row_index("clip").drop_nulls()
    hashes = np.frombuffer(b"".join(known["hash"]), ">u8").astype(np.uint64)
    clips = np.repeat(known["clip"].to_numpy().astype(np.int64), known["hash"].bin.size().to_numpy() // 8)
    telling = np.bitwise_count(hashes) >= LEAST_SET_BITS
    return clips[telling], hashes[telling]


def _bands(hashes: Hashes) -> list[NDArray[np.int64]]:
    """The bits of each band (n,); a band takes every fourth bit, so that no band is all sky."""
    bits = np.unpackbits(hashes.astype(">u8").view(np.uint8).reshape(-1, 8), axis=1)
    packed = [np.packbits(bits[:, band::_BANDS], axis=1) for band in range(_BANDS)]
    return [np.ascontiguousarray(part).view(">u2")[:, 0].astype(np.int64) for part in packed]


def _pairs_sharing(band: NDArray[np.int64], other_band: NDArray[np.int64]) -> Iterator[Pairs]:
    """Places of all pairs that agree in a band, in parts of bounded size."""
    order = np.argsort(band, kind="stable")
    ends = np.cumsum(np.bincount(band, minlength=_BAND_VALUES))
    counts = np.diff(ends, prepend=0)
    totals = np.cumsum(counts[other_band])
    start = 0
    while start < len(other_band):
        done = totals[start - 1] if start else 0
        end = max(start + 1, int(np.searchsorted(totals, done + _PAIRS_AT_ONCE, side="right")))
        others = np.arange(start, end)
        repeats = counts[other_band[others]]
        within = np.arange(repeats.sum()) - np.repeat(np.cumsum(repeats) - repeats, repeats)
        firsts = np.repeat((ends - counts)[other_band[others]], repeats) + within
        yield np.stack([order[firsts], np.repeat(others, repeats)], axis=1)
        start = end
