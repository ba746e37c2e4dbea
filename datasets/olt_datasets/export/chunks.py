"""Chunks of a PhysicalAI-AV export: which clips each holds, and how it is made out of the chunks of clip stores.

A chunk of a store whose clips are all taken, into one group and under their own ids, is linked as it is. All other
clips are packed into new chunks, byte by byte: no image is decoded. Numbers run through the groups in their order, so
that a range of numbers selects a group or a component.
"""

import zipfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import pandas as pd

from olt_datasets.export.contents import ExportGroup, ExportItem
from olt_datasets.export.writing import finished_part, link_or_copy, naming, note_finished, write_file
from olt_generator.errors import InputError
from olt_toolkit.clips.files import add_member, has_feature
from olt_toolkit.clips.pai_layout import CALIBRATIONS, FEATURES
from olt_toolkit.clips.store import CLIPS_PER_CHUNK, ClipStore

How = Literal["linked", "copied", "packed"]
Member = tuple[str, str, bytes]
"""Feature, name in the chunk's zip, and content."""


@dataclass(frozen=True)
class ChunkPlan:
    """One chunk of the export.

    Attributes:
        number: its number.
        items: the clips in it.
        linked_from: store and number of the chunk that it is, where one is taken as it is.
    """

    number: int
    items: tuple[ExportItem, ...]
    linked_from: tuple[Path, int] | None = None


@dataclass(frozen=True)
class ChunkResult:
    """What became of a planned chunk.

    Attributes:
        how: linked (no new bytes), copied to another file system, or packed anew.
        size: bytes of its files.
        listed: ids of the clips in it.
        failures: what was wrong with the clips that are not, by clip.
    """

    how: How
    size: int
    listed: list[str]
    failures: dict[str, str]


def plan_chunks(groups: Sequence[ExportGroup]) -> list[list[ChunkPlan]]:
    """The chunks of each group, numbered from 0 through all groups."""
    stores = {item.store: ClipStore(item.store).chunks() for group in groups for item in group.items}
    plans: list[list[ChunkPlan]] = []
    number = 0
    for group in groups:
        chunks = list(_split_group(group, stores))
        plans.append([ChunkPlan(number + index, items, origin) for index, (items, origin) in enumerate(chunks)])
        number += len(chunks)
    return plans


def write_chunk(root: Path, plan: ChunkPlan, keep_going: bool) -> ChunkResult:
    """Make one chunk, unless an earlier run has.

    Raises:
        InputError: a clip is missing or damaged and `keep_going` is off, or a file cannot be written; names it.
    """
    name = f"chunk_{plan.number:04d}"
    finished = finished_part(root, name)
    if finished is not None:
        return ChunkResult(**finished)
    result = _link_chunk(root, plan, keep_going) or _pack_chunk(root, plan, keep_going)
    note_finished(root, name, asdict(result))
    return result


def _split_group(
    group: ExportGroup, stores: dict[Path, dict[int, list[str]]]
) -> Iterator[tuple[tuple[ExportItem, ...], tuple[Path, int] | None]]:
    unchanged = {(item.store, item.clip_id): item for item in group.items if item.listed_as == item.clip_id}
    linked: set[str] = set()
    for store in sorted({item.store for item in group.items}):
        for chunk, clip_ids in sorted(stores[store].items()):
            if all((store, clip_id) in unchanged for clip_id in clip_ids):
                linked.update(clip_ids)
                yield tuple(unchanged[store, clip_id] for clip_id in clip_ids), (store, chunk)
    rest = [item for item in group.items if item.listed_as not in linked]
    for start in range(0, len(rest), CLIPS_PER_CHUNK):
        yield tuple(rest[start : start + CLIPS_PER_CHUNK]), None


def _link_chunk(root: Path, plan: ChunkPlan, keep_going: bool) -> ChunkResult | None:
    """None where the chunk must be packed: it mixes clips, or one of them is damaged."""
    if plan.linked_from is None:
        return None
    store_root, chunk = plan.linked_from
    store = ClipStore(store_root)
    try:
        for item in plan.items:
            store.check(item.clip_id, item.t0s_us)
    except InputError:
        if not keep_going:
            raise
        return None
    pairs = [
        (feature.chunk_file(store_root, chunk), feature.chunk_file(root, plan.number)) for feature in FEATURES.values()
    ]
    pairs = [(source, target) for source, target in pairs if source.exists()]
    linked = [link_or_copy(source, target) for source, target in pairs]
    size = sum(target.stat().st_size for _, target in pairs)
    return ChunkResult("linked" if all(linked) else "copied", size, [item.listed_as for item in plan.items], {})


def _pack_chunk(root: Path, plan: ChunkPlan, keep_going: bool) -> ChunkResult:
    failures: dict[str, str] = {}
    listed: list[str] = []
    stores = {store: ClipStore(store) for store in {item.store for item in plan.items}}
    with ExitStack() as stack:
        chunk = _ChunkWriter(root, plan.number, stack)
        for item in plan.items:
            try:
                members, rows = _read_clip(stores[item.store], item)
            except InputError as error:
                if not keep_going:
                    raise
                failures[item.listed_as] = str(error)
                continue
            chunk.add(members, rows)
            listed.append(item.listed_as)
    if listed:
        chunk.write_calibration()
    return ChunkResult("packed", _chunk_size(root, plan.number), listed, failures)


class _ChunkWriter:
    """Collects clips into the files of one chunk; the archives appear when `stack` is left."""

    def __init__(self, root: Path, number: int, stack: ExitStack) -> None:
        self._root, self._number, self._stack = root, number, stack
        self._archives: dict[str, zipfile.ZipFile] = {}
        self._tables: dict[str, list[pd.DataFrame]] = {name: [] for name in CALIBRATIONS}

    def add(self, members: Sequence[Member], rows: dict[str, pd.DataFrame]) -> None:
        for feature, name, data in members:
            path = FEATURES[feature].chunk_file(self._root, self._number)
            if feature not in self._archives:
                temporary = self._stack.enter_context(write_file(path))
                archive = zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED)
                self._archives[feature] = self._stack.enter_context(archive)
            with naming(path):
                add_member(self._archives[feature], name, data)
        for feature, table in rows.items():
            self._tables[feature].append(table)

    def write_calibration(self) -> None:
        for name, rows in self._tables.items():
            with write_file(FEATURES[name].chunk_file(self._root, self._number)) as temporary:
                pd.concat(rows).to_parquet(temporary)


def _read_clip(store: ClipStore, item: ExportItem) -> tuple[list[Member], dict[str, pd.DataFrame]]:
    """Members of a clip, checked, and its rows of the calibration tables, all under its id in the export."""
    store.check(item.clip_id, item.t0s_us)
    info = store.info(item.clip_id)
    members = [
        (feature.name, feature.member(alias, item.listed_as), store.read_member(item.clip_id, feature.name, alias))
        for feature in FEATURES.values()
        if has_feature(info, feature.name)
        for alias in feature.members
    ]
    rows = {name: _rename(store.read_rows(item.clip_id, name), item.listed_as) for name in CALIBRATIONS}
    return members, rows


def _rename(rows: pd.DataFrame, clip_id: str) -> pd.DataFrame:
    if isinstance(rows.index, pd.MultiIndex):
        keys = [(clip_id, *key[1:]) for key in rows.index]
        return rows.set_axis(pd.MultiIndex.from_tuples(keys, names=rows.index.names))
    return rows.set_axis(pd.Index([clip_id] * len(rows), name=rows.index.name))


def _chunk_size(root: Path, number: int) -> int:
    files = [feature.chunk_file(root, number) for feature in FEATURES.values()]
    return sum(file.stat().st_size for file in files if file.exists())
