"""Near-duplicates: clips whose front images show one drive, found by their fingerprints (`clips.fingerprint`).

For each clip of one list, a like clip of another is looked for: thumbnails that look alike meet under keys
(`thumbnail_keys`), the clips that share most keys are laid on each other in space and time (`thumbnail_alignment`), and
the first that is alike is told. So time and memory grow with the number of clips, also where thousands look alike: of
thumbnails that share a key, a few are taken, and clips for which that left some out without finding a like one are
counted (`Search.crowded`).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import polars as pl
from numpy.typing import NDArray

from olt_datasets.tables.thumbnail_alignment import Sequence, is_alike
from olt_datasets.tables.thumbnail_keys import Effort, choose_effort, make_keys, make_probes
from olt_datasets.tables.thumbnail_warps import list_crops, stack_warps
from olt_toolkit.clips.fingerprint import COLUMNS, IMAGES, RECORD, ROWS

# Keys of a block of the second list, held at once: 8 bytes each.
_KEYS_AT_ONCE = 1 << 25
_PROBES_AT_ONCE = 1 << 19
_OF_A_KEY = 8
"""Thumbnails that are taken of those that share a key."""
_COMPARED = 8
"""Clips, the ones that share most keys, that are compared with one."""
_MANY_KEYS = 8
"""Shared keys; a clip that shares fewer is seldom a copy."""
_LOOKED_AT = 6
"""Pairs of images, of those that share keys, that are correlated first."""
_LEAST_CORRELATION = 0.4
"""Of the best of these pairs; those of one place have more."""
_ROWS_AT_ONCE = 20_000

Pairs = NDArray[np.int64]
Places = NDArray[np.int64]


@dataclass(frozen=True)
class Search:
    """What a search has found.

    Attributes:
        pairs: places (m, 2), ascending, of clips of the first list and of a like clip of the second: one at most each.
        crowded: places (c,) of clips of the first list that share many keys with more clips than are compared, and for
            which no like clip is among those compared: not compared in full.
    """

    pairs: Pairs
    crowded: Places


def is_telling(fingerprints: pl.Series) -> pl.Series:
    """Whether each clip can be compared at all: not one without a fingerprint, and none that shows fog or a wall."""
    return (fingerprints.bin.size() > 0).fill_null(value=False).alias("telling")


def find_near_duplicates(
    first: pl.Series, second: pl.Series, first_scenes: pl.Series | None = None, second_scenes: pl.Series | None = None
) -> Pairs:
    """Places (m, 2), ascending, of clips of a list and of a like clip of another: not all pairs, one for each clip.

    Args:
        first, second: fingerprints, None where a clip has none.
        first_scenes, second_scenes: names of the clips' scenes; clips of one scene are no pair.
    """
    return search_near_duplicates(_frame(first, first_scenes), _frame(second, second_scenes)).pairs


def search_near_duplicates(first: pl.LazyFrame, second: pl.LazyFrame) -> Search:
    """For each clip of a table, a like clip of another scene in another table, with what was not compared.

    Tables have columns `fingerprint` and `scene_id`, and are read in parts: at most half a million clips of the second
    are held at once, and the first is read once for each of these blocks.
    """
    clips = second.select(pl.len()).collect(engine="streaming").item()
    effort = choose_effort(clips)
    found = np.full(first.select(pl.len()).collect(engine="streaming").item(), -1)
    crowded = np.zeros(len(found), bool)
    for index in _build_indexes(second, effort):
        for part in _read_parts(first, _PROBES_AT_ONCE // (IMAGES * effort.probes * effort.tables)):
            _search_part(part, index, found, crowded)
    places = np.flatnonzero(found >= 0)
    return Search(np.stack([places, found[places]], axis=1), np.flatnonzero(crowded & (found < 0)))


@dataclass(frozen=True)
class _Thumbnails:
    """Thumbnails of consecutive clips of a table that have some.

    Attributes:
        records: (n,) of all clips in turn.
        clips: (c,) places of the clips in the table.
        starts: (c + 1,) where the thumbnails of each clip start, and the end.
        scenes: (c,) hashes of their scenes.
    """

    records: NDArray[np.void]
    clips: Places
    starts: Places
    scenes: NDArray[np.uint64]

    def signs(self) -> NDArray[np.float32]:
        """-1 or 1 (n, cells)."""
        return _unpack(self.records["signs"])

    def owners(self) -> Places:
        """Which of the clips (c,) each thumbnail is of (n,)."""
        return np.repeat(np.arange(len(self.clips)), np.diff(self.starts))

    def sequence(self, clip: int) -> Sequence:
        """The thumbnails of one of the clips (c,)."""
        records = self.records[self.starts[clip] : self.starts[clip + 1]]
        return Sequence(_unpack(records["signs"]), records["time_ms"] / 1e3, bool(records["dim"].mean() > 0.5))


@dataclass(frozen=True)
class _Index:
    """Thumbnails by their keys.

    Attributes:
        thumbnails: those of a block of clips.
        owners: which clip of the block each is of.
        keys: (tables, n) ascending, a key in the upper and the place of the thumbnail in the lower 32 bits of each.
        effort: how much is spent on looking up.
    """

    thumbnails: _Thumbnails
    owners: Places
    keys: NDArray[np.uint64]
    effort: Effort


def _frame(fingerprints: pl.Series, scenes: pl.Series | None) -> pl.LazyFrame:
    names = pl.Series([None], dtype=pl.String).new_from_index(0, len(fingerprints)) if scenes is None else scenes
    return pl.LazyFrame({"fingerprint": fingerprints.cast(pl.Binary), "scene_id": names})


def _read_parts(table: pl.LazyFrame, clips: int) -> Iterator[_Thumbnails]:
    """Thumbnails of a table, some clips at a time."""
    start = 0
    for rows in table.select("fingerprint", "scene_id").collect_batches(chunk_size=_ROWS_AT_ONCE, engine="streaming"):
        telling = rows.with_row_index("clip", start).filter(is_telling(rows["fingerprint"]))
        start += len(rows)
        for part in telling.iter_slices(clips):
            yield _thumbnails(part)


def _thumbnails(rows: pl.DataFrame) -> _Thumbnails:
    records = np.frombuffer(b"".join(rows["fingerprint"]), RECORD)
    sizes = rows["fingerprint"].bin.size().to_numpy() // RECORD.itemsize
    # A clip of unknown scene is of a scene of its own.
    scenes = rows.select(pl.coalesce("scene_id", pl.lit("")).hash(0))["scene_id"].to_numpy().astype(np.uint64)
    scenes = np.where(rows["scene_id"].is_null().to_numpy(), 0, scenes)
    return _Thumbnails(
        records,
        rows["clip"].to_numpy().astype(np.int64),
        np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        scenes,
    )


def _build_indexes(table: pl.LazyFrame, effort: Effort) -> Iterator[_Index]:
    """Indexes of a table, a block of clips at a time."""
    most = _KEYS_AT_ONCE // (IMAGES * effort.tables)
    parts: list[_Thumbnails] = []
    for part in _read_parts(table, most):
        if sum(len(each.clips) for each in [*parts, part]) > most:
            yield _index(_join(parts), effort)
            parts = []
        parts.append(part)
    if parts:
        yield _index(_join(parts), effort)


def _join(parts: list[_Thumbnails]) -> _Thumbnails:
    sizes = np.concatenate([np.diff(part.starts) for part in parts])
    records, clips, scenes = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("records", "clips", "scenes")
    )
    return _Thumbnails(records, clips, np.concatenate([[0], np.cumsum(sizes)]), scenes)


def _index(block: _Thumbnails, effort: Effort) -> _Index:
    keys = np.empty((effort.tables, len(block.records)), np.uint64)
    for start in range(0, len(block.records), _ROWS_AT_ONCE):
        part = slice(start, start + _ROWS_AT_ONCE)
        keys[:, part] = make_keys(_unpack(block.records["signs"][part]), effort) << np.uint64(32)
    keys |= np.arange(keys.shape[1], dtype=np.uint64)
    keys.sort(axis=1)
    return _Index(block, block.owners(), keys, effort)


def _search_part(part: _Thumbnails, index: _Index, found: Places, crowded: NDArray[np.bool_]) -> None:
    """Write to `found` a like clip for each of those that have none (-1), and mark in `crowded` those not compared."""
    candidates, left_out = _find_candidates(part, index)
    crowded[part.clips[left_out]] = True
    for clip, candidate, mirrored in candidates.iter_rows():
        place = part.clips[clip]
        if found[place] >= 0:
            continue
        mine = part.sequence(clip)
        if is_alike(mine.mirrored if mirrored else mine, index.thumbnails.sequence(candidate)):
            found[place] = index.thumbnails.clips[candidate]


def _find_candidates(part: _Thumbnails, index: _Index) -> tuple[pl.DataFrame, Places]:
    """Clips, candidates of the index and whether mirrored, those first that share most keys; and clips with more.

    A clip has more candidates than these where one that shares many keys is cut off, or where most of its keys are
    shared by more thumbnails than are taken.
    """
    probes = make_probes(part.signs(), index.effort)
    owners = part.owners()
    hits, full_keys, met_keys = [], np.zeros(len(part.clips), np.int64), np.zeros(len(part.clips), np.int64)
    for table, keys in zip(probes, index.keys, strict=True):
        wanted = table.ravel() << np.uint64(32)
        low = np.searchsorted(keys, wanted)
        counts = np.searchsorted(keys, wanted + np.uint64(1 << 32)) - low
        probe, image = np.divmod(np.arange(table.size), table.shape[1])
        met_keys += np.bincount(owners[image[counts > 0]], minlength=len(met_keys))
        full_keys += np.bincount(owners[image[counts > _OF_A_KEY]], minlength=len(full_keys))
        # Evenly over those that share the key.
        for taken in range(min(_OF_A_KEY, int(counts.max(initial=0)))):
            more = np.flatnonzero(counts > taken)
            step = low[more] + taken * counts[more] // np.minimum(counts[more], _OF_A_KEY)
            theirs = (keys[step] & np.uint64(0xFFFFFFFF)).astype(np.int64)
            hits.append(np.stack([owners[image[more]], index.owners[theirs], probe[more], image[more], theirs]))
    met = np.concatenate([np.empty((5, 0), np.int64), *hits], axis=1)
    scenes, other_scenes = part.scenes[met[0]], index.thumbnails.scenes[met[1]]
    ranked = _rank(met[:, (scenes != other_scenes) | (scenes == 0)])
    likely = ranked.filter(_correlate(part, index, ranked) >= _LEAST_CORRELATION)
    ranks = pl.int_range(pl.len()).over("clip")
    cut = likely.filter((ranks >= _COMPARED) & (pl.col("len") >= _MANY_KEYS))
    mostly_full = np.flatnonzero(2 * full_keys > met_keys)
    candidates = likely.filter(ranks < _COMPARED).select("clip", "candidate", "mirrored")
    return candidates, np.union1d(mostly_full, cut["clip"].to_numpy()).astype(np.int64)


def _rank(met: NDArray[np.int64]) -> pl.DataFrame:
    """Candidates by the keys they share, of (clip, candidate, probe, image, their image) a key (5, n)."""
    keys = pl.DataFrame(met.T, ("clip", "candidate", "probe", "image", "theirs"))
    return (
        keys.group_by("clip", "candidate", (pl.col("probe") % 2 == 1).alias("mirrored"), maintain_order=True)
        .agg(pl.len(), pl.col("probe", "image", "theirs").sample(_LOOKED_AT, with_replacement=True, seed=0))
        .sort("clip", "len", "candidate", "mirrored", descending=[False, True, False, False])
    )


def _correlate(part: _Thumbnails, index: _Index, candidates: pl.DataFrame) -> pl.Series:
    """Highest correlation of a few pairs of images of each candidate that share a key, as the probe warps the first."""
    images = (
        candidates.with_row_index("row").select("row", "probe", "image", "theirs").explode("probe", "image", "theirs")
    )
    probes, mine, theirs = (images[name].to_numpy() for name in ("probe", "image", "theirs"))
    correlations = np.empty(len(images), np.float32)
    stacked, filled = stack_warps(list_crops(index.effort.scales, (0.0,)))
    for number, warp in enumerate(np.split(stacked.toarray(), len(filled))):
        for mirrored in (False, True):
            rows = np.flatnonzero(probes == 2 * number + mirrored)
            warped = _unpack(part.records["signs"][mine[rows]]) @ warp.T
            if mirrored:
                warped = warped.reshape(-1, ROWS, COLUMNS)[:, :, ::-1].reshape(warped.shape)
            signs = _unpack(index.thumbnails.records["signs"][theirs[rows]])
            norms = np.linalg.norm(warped, axis=1) * np.sqrt(filled[number].sum())
            correlations[rows] = np.einsum("nc,nc->n", warped, signs) / norms
    highest = images.with_columns(correlation=correlations).group_by("row").agg(pl.col("correlation").max())
    return highest.sort("row")["correlation"]


def _unpack(signs: NDArray[np.uint8]) -> NDArray[np.float32]:
    """-1 or 1 (n, cells) of packed bits (n, cells / 8)."""
    return 2.0 * np.unpackbits(signs, axis=1).astype(np.float32) - 1.0
