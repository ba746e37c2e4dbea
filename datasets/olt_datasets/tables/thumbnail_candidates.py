"""Which clips may show the drive of a clip: those with thumbnails that share keys with its own and look alike.

All clips of a part are looked up at once, without a loop over clips. What shares a key is compared bit by bit; what is
alike then is laid on each other in time, roughly (`rough_alignment`). Only what passes is worth a comparison in full.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from olt_datasets.tables.rough_alignment import RoughPairs, align_roughly
from olt_datasets.tables.thumbnail_index import Index, Places, Thumbnails
from olt_datasets.tables.thumbnail_keys import Packed, make_probes, pack, pack_probes
from olt_toolkit.clips.fingerprint import IMAGES

_OF_A_KEY = 8
"""Thumbnails that are taken of those that share a key."""
_COMPARED = 8
"""Clips, the ones that share most keys, that are compared with one."""
_CROWD = 4
"""A key is crowded if so many times more thumbnails share it than are taken."""
_LEAST_CORRELATION = 0.4
"""Of two images that share a key; those of one place have more."""
_LIKENESS_STEPS = 250
_GOLDEN_RATIO = 0.618034


@dataclass(frozen=True)
class Candidates:
    """Pairs of clips that may be alike, those of one clip in turn, and those first that share most keys.

    Attributes:
        clips: (m,) of the part.
        others: (m,) of the index.
        mirrored: (m,) whether the first is mirrored.
        crowded: (c,) clips of the part that may have more like clips than are looked at: there are more candidates than
            are compared, most of which are roughly alike, or most keys are shared by many more thumbnails than are
            taken.
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
        owners: (n,) the clip of each thumbnail.
    """

    signs: Packed
    filled: Packed
    cells: NDArray[np.int64]
    owners: NDArray[np.int32]


def find_candidates(part: Thumbnails, index: Index) -> Candidates:
    """Clips of an index that may show the drives of the clips of a part."""
    signs = part.signs()
    looks, filled = pack_probes(signs, index.effort)
    seen = _Looks(looks, filled, np.bitwise_count(filled).sum(axis=1, dtype=np.int64), part.owners())
    full_keys, met_keys = np.zeros(len(part.clips), np.int64), np.zeros(len(part.clips), np.int64)
    hits = [np.empty((4, 0), np.int64)]
    for table, keys in zip(make_probes(signs, index.middle, index.effort), index.keys, strict=True):
        wanted = table.ravel() << np.uint64(32)
        low = np.searchsorted(keys, wanted)
        counts = np.searchsorted(keys, wanted + np.uint64(1 << 32)) - low
        probe, image = np.divmod(np.arange(table.size), table.shape[1])
        # Counted within its clip: what is found of a clip does not depend on the others that are looked up with it.
        lookup = probe * IMAGES + image - part.starts[seen.owners[image]]
        met_keys += np.bincount(seen.owners[image[counts > 0]], minlength=len(met_keys))
        full_keys += np.bincount(seen.owners[image[counts > _CROWD * _OF_A_KEY]], minlength=len(full_keys))
        hits += [
            _keep_alike(part, index, seen, probe[places], image[places], theirs)
            for places, theirs in _take_evenly(keys, low, counts, lookup)
        ]
    pairs, left_out = _choose(index, seen, np.concatenate(hits, axis=1))
    passed = align_roughly(part, index.thumbnails, pairs)
    compared, near = (np.bincount(each, minlength=len(part.clips)) for each in (pairs.clips, pairs.clips[passed]))
    crowded = (2 * full_keys > met_keys) | (left_out & (2 * near >= compared))
    return Candidates(pairs.clips[passed], pairs.others[passed], pairs.mirrored[passed], np.flatnonzero(crowded))


def _take_evenly(keys: Packed, low: Places, counts: Places, lookup: Places) -> Iterator[tuple[Places, Places]]:
    """Which lookups (m,) meet a thumbnail, and which one (m,): of those that share a key a few, evenly.

    `lookup` (n,) numbers the lookups of a clip, so that those which meet the same thumbnails take others of them.
    """
    phase = lookup * _GOLDEN_RATIO % 1.0
    for taken in range(min(_OF_A_KEY, int(counts.max(initial=0)))):
        more = np.flatnonzero(counts > taken)
        stride = counts[more] / np.minimum(counts[more], _OF_A_KEY)
        step = low[more] + ((taken + phase[more]) * stride).astype(np.int64)
        yield more, (keys[step] & np.uint64(0xFFFFFFFF)).astype(np.int64)


def _keep_alike(part: Thumbnails, index: Index, seen: _Looks, probe: Places, image: Places, theirs: Places) -> Places:
    """Of images that share a key, those alike and not of one scene: image, theirs, mirrored, likeness (4, n)."""
    scenes = part.scenes[seen.owners[image]]
    elsewhere = np.flatnonzero((scenes == 0) | (scenes != index.thumbnails.scenes[index.owners[theirs]]))
    probe, image, theirs = probe[elsewhere], image[elsewhere], theirs[elsewhere]
    different = (seen.signs[probe, image] ^ pack(index.thumbnails.records["signs"][theirs])) & seen.filled[probe]
    correlations = 1.0 - 2.0 * np.bitwise_count(different).sum(axis=1, dtype=np.int64) / seen.cells[probe]
    likeness = np.round(_LIKENESS_STEPS * correlations).astype(np.int64)
    return np.stack([image, theirs, probe % 2, likeness])[:, correlations >= _LEAST_CORRELATION]


def _choose(index: Index, seen: _Looks, hits: Places) -> tuple[RoughPairs, NDArray[np.bool_]]:
    """Of each clip's candidates those that share most keys, and which clips have more.

    Args:
        hits: image, theirs, mirrored and likeness of two thumbnails that share a key (4, n).
    """
    image, theirs, mirrored, likeness = hits
    others = len(index.thumbnails.clips)
    pair = 2 * (seen.owners[image].astype(np.int64) * others + index.owners[theirs]) + mirrored
    order = np.argsort(pair * (_LIKENESS_STEPS + 1) + likeness, kind="stable")
    # The last of a pair's hits is of the images that are most alike.
    ends = np.flatnonzero(np.diff(pair[order], append=-1))
    shared, best = np.diff(ends, prepend=-1), order[ends]
    clips = seen.owners[image[best]].astype(np.int64)
    ranked = np.lexsort((-shared, clips))
    clips, best = clips[ranked], best[ranked]
    rank = np.arange(len(clips)) - np.searchsorted(clips, clips)
    left_out = np.zeros(int(seen.owners[-1]) + 1, bool)
    left_out[clips[rank >= _COMPARED]] = True
    clips, best = clips[rank < _COMPARED], best[rank < _COMPARED]
    chosen = RoughPairs(
        clips, index.owners[theirs[best]].astype(np.int64), mirrored[best] == 1, image[best], theirs[best]
    )
    return chosen, left_out
