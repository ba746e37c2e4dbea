"""Which clips may show the drive of a clip: those with thumbnails that share keys with its own and look alike.

All clips of a part are looked up at once, without a loop over clips. What shares a key is compared bit by bit; what is
alike then is laid on each other in time, roughly (`rough_alignment`). Only what passes is worth
a comparison in full.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import polars as pl
from numpy.typing import NDArray

from olt_datasets.tables.rough_alignment import align_roughly
from olt_datasets.tables.thumbnail_index import Index, Places, Thumbnails
from olt_datasets.tables.thumbnail_keys import Packed, make_probes, pack, pack_probes

_OF_A_KEY = 8
"""Thumbnails that are taken of those that share a key."""
_COMPARED = 8
"""Clips, the ones that share most keys, that are compared with one."""
_MANY_KEYS = 8
"""Shared keys; a clip that shares fewer is seldom a copy."""
_LEAST_CORRELATION = 0.4
"""Of two images that share a key; those of one place have more."""


@dataclass(frozen=True)
class Candidates:
    """Pairs of clips that may be alike, those of one clip in turn, and those first that share most keys.

    Attributes:
        clips: (m,) of the part.
        others: (m,) of the index.
        mirrored: (m,) whether the first is mirrored.
        crowded: (c,) clips of the part that have more candidates than are looked at: one that shares many keys is cut
            off, or most of its keys are shared by more thumbnails than are taken.
    """

    clips: Places
    others: Places
    mirrored: NDArray[np.bool_]
    crowded: Places


@dataclass(frozen=True)
class _Looks:
    """Thumbnails of a part as each probe sees them (`thumbnail_keys.pack_probes`).

    Attributes:
        signs: (probes, n, 4).
        filled: (probes, 4) cells that the probe fills.
        cells: (probes,) how many.
    """

    signs: Packed
    filled: Packed
    cells: NDArray[np.int64]


def find_candidates(part: Thumbnails, index: Index) -> Candidates:
    """Clips of an index that may show the drives of the clips of a part."""
    signs = part.signs()
    looks, filled = pack_probes(signs, index.effort)
    seen = _Looks(looks, filled, np.bitwise_count(filled).sum(axis=1, dtype=np.int64))
    owners = part.owners()
    full_keys, met_keys = np.zeros(len(part.clips), np.int64), np.zeros(len(part.clips), np.int64)
    met: list[pl.DataFrame] = []
    for table, keys in zip(make_probes(signs, index.middle, index.effort), index.keys, strict=True):
        wanted = table.ravel() << np.uint64(32)
        low = np.searchsorted(keys, wanted)
        counts = np.searchsorted(keys, wanted + np.uint64(1 << 32)) - low
        probe, image = np.divmod(np.arange(table.size), table.shape[1])
        met_keys += np.bincount(owners[image[counts > 0]], minlength=len(met_keys))
        full_keys += np.bincount(owners[image[counts > _OF_A_KEY]], minlength=len(full_keys))
        for places, theirs in _take_evenly(keys, low, counts):
            met.append(_keep_alike(part, index, seen, owners, probe[places], image[places], theirs))
    ranked = (
        _rank(pl.concat(met)) if met else _rank(_keep_alike(part, index, seen, owners, *np.empty((3, 0), np.int64)))
    )
    ranks = pl.int_range(pl.len()).over("clip")
    cut = ranked.filter((ranks >= _COMPARED) & (pl.col("len") >= _MANY_KEYS))["clip"].to_numpy()
    taken = ranked.filter(ranks < _COMPARED)
    clips, others, probes = (taken[name].to_numpy().astype(np.int64) for name in ("clip", "candidate", "probe"))
    passed = align_roughly(part, index.thumbnails, clips, others, seen.signs, seen.filled, probes)
    mostly_full = np.flatnonzero(2 * full_keys > met_keys)
    return Candidates(clips[passed], others[passed], probes[passed] % 2 == 1, np.union1d(mostly_full, cut))


def _take_evenly(keys: Packed, low: Places, counts: Places) -> Iterator[tuple[Places, Places]]:
    """Which lookups (m,) meet a thumbnail, and which one (m,): of those that share a key a few, evenly."""
    for taken in range(min(_OF_A_KEY, int(counts.max(initial=0)))):
        more = np.flatnonzero(counts > taken)
        step = low[more] + taken * counts[more] // np.minimum(counts[more], _OF_A_KEY)
        yield more, (keys[step] & np.uint64(0xFFFFFFFF)).astype(np.int64)


def _keep_alike(
    part: Thumbnails,
    index: Index,
    seen: _Looks,
    owners: NDArray[np.int32],
    probe: Places,
    image: Places,
    theirs: Places,
) -> pl.DataFrame:
    """Of images that share a key, those that are alike and not of one scene: clip, candidate, probe, correlation."""
    clips, others = owners[image], index.owners[theirs]
    scenes = part.scenes[clips]
    elsewhere = np.flatnonzero((scenes == 0) | (scenes != index.thumbnails.scenes[others]))
    probe, image, theirs = probe[elsewhere], image[elsewhere], theirs[elsewhere]
    different = (seen.signs[probe, image] ^ pack(index.thumbnails.records["signs"][theirs])) & seen.filled[probe]
    correlations = 1.0 - 2.0 * np.bitwise_count(different).sum(axis=1, dtype=np.int64) / seen.cells[probe]
    alike = correlations >= _LEAST_CORRELATION
    columns = {"clip": clips[elsewhere], "candidate": others[elsewhere], "probe": probe.astype(np.int8)}
    return pl.DataFrame(columns | {"correlation": correlations.astype(np.float32)}).filter(pl.Series(alike))


def _rank(met: pl.DataFrame) -> pl.DataFrame:
    """Candidates by the keys they share, each with the probe under which most alike."""
    return (
        met.group_by("clip", "candidate", mirrored=pl.col("probe") % 2 == 1)
        .agg(pl.len(), probe=pl.col("probe").sort_by("correlation", "probe").last())
        .sort("clip", "len", "candidate", "probe", descending=[False, True, False, False])
    )
