"""Chunks of a PhysicalAI-AV export: which clips each holds, and how it is made out of the chunks of clip stores.

A chunk of a store whose clips are all taken, into one group and under their own ids, is linked as it is. All other
clips are packed into new chunks, byte by byte: no image is decoded. Numbers run through the groups in their order, so
that a range of numbers selects a group or a component.
"""

import zipfile
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from olt_datasets.export.contents import ExportGroup, ExportItem
from olt_datasets.export.writing import finished_part, link_or_copy, note_finished
from olt_generator.errors import InputError
from olt_generator.files import naming, write_whole
from olt_toolkit.clips.files import add_member, has_feature
from olt_toolkit.clips.pai_layout import CALIBRATIONS, STORED
from olt_toolkit.clips.store import CLIPS_PER_CHUNK, ClipStore


class ExportChunk(NamedTuple):
    """One chunk of the export: its number, the place of its group among all groups, and the clips in it.

    `linked_from` is the store and number of the chunk that it is, where one is taken as it is.
    """

    number: int
    group: int
    items: tuple[ExportItem, ...]
    linked_from: tuple[Path, int] | None = None


def divide_into_chunks(groups: Sequence[ExportGroup]) -> list[ExportChunk]:
    """The chunks of all groups, one group after the other, numbered from 0."""
    stores = {item.store: ClipStore(item.store).chunks() for group in groups for item in group.items}
    chunks: list[ExportChunk] = []
    for index, group in enumerate(groups):
        unchanged = {(item.store, item.clip_id): item for item in group.items if item.listed_as == item.clip_id}
        linked: set[str] = set()
        for store in sorted({item.store for item in group.items}):
            for number, clip_ids in sorted(stores[store].items()):
                if all((store, clip_id) in unchanged for clip_id in clip_ids):
                    linked.update(clip_ids)
                    items = tuple(unchanged[store, clip_id] for clip_id in clip_ids)
                    chunks.append(ExportChunk(len(chunks), index, items, (store, number)))
        rest = [item for item in group.items if item.listed_as not in linked]
        for start in range(0, len(rest), CLIPS_PER_CHUNK):
            chunks.append(ExportChunk(len(chunks), index, tuple(rest[start : start + CLIPS_PER_CHUNK])))
    return chunks


def write_chunk(root: Path, chunk: ExportChunk, keep_going: bool) -> dict[str, Any]:
    """Make one chunk, unless an earlier run has.

    Gives `how`: linked (no new bytes), copied to another file system, or packed anew; `size`: bytes of its files; and
    `failures`: what was wrong with clips that it should hold and does not, by their ids in the export.
    InputError names a file that cannot be written, or a clip that is missing or damaged where `keep_going` is off.
    """
    name = f"chunk_{chunk.number:04d}"
    result = finished_part(root, name)
    if result is None:
        how, failures = _link_chunk(root, chunk, keep_going), {}
        if how is None:
            how, failures = "packed", _pack_chunk(root, chunk, keep_going)
        files = [feature.chunk_file(root, chunk.number) for feature in STORED.values()]
        size = sum(file.stat().st_size for file in files if file.exists())
        result = {"how": how, "size": size, "failures": failures}
        note_finished(root, name, result)
    return result


def _link_chunk(root: Path, chunk: ExportChunk, keep_going: bool) -> str | None:
    """None where the chunk must be packed: it mixes clips, or one of them is damaged."""
    if chunk.linked_from is None:
        return None
    store_root, number = chunk.linked_from
    store = ClipStore(store_root)
    try:
        for item in chunk.items:
            store.check(item.clip_id, item.t0s_us)
    except InputError:
        if not keep_going:
            raise
        return None
    files = [
        (feature.chunk_file(store_root, number), feature.chunk_file(root, chunk.number)) for feature in STORED.values()
    ]
    linked = [link_or_copy(source, target) for source, target in files if source.exists()]
    return "linked" if all(linked) else "copied"


def _pack_chunk(root: Path, chunk: ExportChunk, keep_going: bool) -> dict[str, str]:
    """What was wrong with the clips that are left out, by their ids in the export."""
    failures: dict[str, str] = {}
    calibrations: dict[str, list[pd.DataFrame]] = {name: [] for name in CALIBRATIONS}
    stores = {store: ClipStore(store) for store in {item.store for item in chunk.items}}
    with ExitStack() as stack:  # the archives appear when it is left
        archives: dict[str, zipfile.ZipFile] = {}
        for item in chunk.items:
            try:
                members, rows = _read_clip(stores[item.store], item)
            except InputError as error:
                if not keep_going:
                    raise
                failures[item.listed_as] = str(error)
                continue
            for feature, name, data in members:
                path = STORED[feature].chunk_file(root, chunk.number)
                if feature not in archives:
                    temporary = stack.enter_context(write_whole(path))
                    archives[feature] = stack.enter_context(zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED))
                with naming(path):
                    add_member(archives[feature], name, data)
            for feature, table in rows.items():
                calibrations[feature].append(table)
    for feature, tables in calibrations.items():
        if tables:
            with write_whole(STORED[feature].chunk_file(root, chunk.number)) as temporary:
                pd.concat(tables).to_parquet(temporary)
    return failures


def _read_clip(store: ClipStore, item: ExportItem) -> tuple[list[tuple[str, str, bytes]], dict[str, pd.DataFrame]]:
    """A clip, checked, under its id in the export: feature, name and bytes of each member, and rows of calibration."""
    store.check(item.clip_id, item.t0s_us)
    info = store.info(item.clip_id)
    members = [
        (feature.name, feature.member(alias, item.listed_as), store.read_member(item.clip_id, feature.name, alias))
        for feature in STORED.values()
        if has_feature(info, feature)
        for alias in feature.members
    ]
    renamed = {item.clip_id: item.listed_as}
    return members, {name: store.read_rows(item.clip_id, name).rename(index=renamed, level=0) for name in CALIBRATIONS}
