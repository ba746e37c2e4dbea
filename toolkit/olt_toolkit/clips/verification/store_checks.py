"""Whether the tables and archives of a store agree about which clips there are, and can be opened without harm."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import pandas as pd

from olt_generator.errors import InputError
from olt_toolkit.clips import pai_layout as layout
from olt_toolkit.clips import pai_tables as tables
from olt_toolkit.clips.chunk_archive import ChunkArchive
from olt_toolkit.clips.clip import ClipInfo
from olt_toolkit.clips.feature_table import read_feature_table
from olt_toolkit.clips.files import has_feature
from olt_toolkit.clips.pai_layout import FEATURES, STORED, Feature
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.table import CLIP_TABLE, read_clip_table
from olt_toolkit.clips.verification.archive_checks import check_archive
from olt_toolkit.clips.verification.findings import Finding, Verdict, not_compared, state

SPLITS = "splits/default.parquet"


def check_store(store: ClipStore) -> Iterator[Finding]:
    """Look at the tables of a store and at the directory of every archive in it; the clips are looked at one by one.

    Raises:
        InputError: the folder is no clip store, or its clip table or clip index cannot be read.
    """
    root, chunks = store.root, store.chunks()
    clips = read_clip_table(root / CLIP_TABLE)
    yield from _check_index(root, clips, chunks)
    yield from _check_metadata(root, clips)
    yield check_features(root)
    by_id = {info.clip_id: info for info in clips}
    for feature in STORED.values():
        yield from check_feature(root, feature, by_id, chunks)
    yield _check_strangers(root, chunks)


def _check_index(root: Path, clips: Sequence[ClipInfo], chunks: dict[int, list[str]]) -> Iterator[Finding]:
    indexed = {clip_id for of_chunk in chunks.values() for clip_id in of_chunk}
    known = {info.clip_id for info in clips}
    where = f"{root / layout.CLIP_INDEX}"
    yield _list("clips in the index", where, sorted(known - indexed), "clips of the clip table that it lacks")
    yield _list("no other clips in the index", where, sorted(indexed - known), "clips that the clip table lacks")
    index = tables.read_indexed(root / layout.CLIP_INDEX, ["chunk"], ["clip_id"])
    splits = index["split"].to_dict() if "split" in index else {}
    wrong = [info.clip_id for info in clips if info.split is not None and splits.get(info.clip_id) != info.split]
    yield _list("splits of the index", where, wrong, "clips in another split than that of the clip table")
    if "event_t0s" in index:
        times = {clip_id: {int(time) for time in of_clip} for clip_id, of_clip in index["event_t0s"].items()}
        wrong = [info.clip_id for info in clips if not times.get(info.clip_id, set()) <= set(info.sample_t0_us)]
        yield _list("sample times of the index", where, wrong, "clips with times that are no sample times of theirs")
    yield from _check_splits(root, {info.clip_id: info.split for info in clips})


def _check_splits(root: Path, splits: dict[str, str | None]) -> Iterator[Finding]:
    path = root / SPLITS
    if not path.exists():
        return
    try:
        stated = tables.read_indexed(path, ["split"], ["clip_id"])["split"].to_dict()
    except InputError as error:
        yield state("table of splits", str(path), False, str(error))
        return
    wrong = sorted(clip_id for clip_id in stated.keys() | splits.keys() if stated.get(clip_id) != splits.get(clip_id))
    yield _list("table of splits", str(path), wrong, "clips that it lacks, does not know, or puts into another split")


def _check_metadata(root: Path, clips: Sequence[ClipInfo]) -> Iterator[Finding]:
    for name in (layout.FEATURE_PRESENCE, layout.DATA_COLLECTION):
        path = root / name
        try:
            table = tables.read_indexed(path, [], ["clip_id"])
        except InputError as error:
            yield state("metadata", str(path), False, str(error))
            continue
        wrong = sorted({info.clip_id for info in clips} ^ set(table.index))
        yield _list("metadata", str(path), wrong, "clips that it lacks or that are not there")
        if name == layout.FEATURE_PRESENCE and not wrong:
            yield _check_presence(path, table, clips)


def _check_presence(path: Path, table: pd.DataFrame, clips: Sequence[ClipInfo]) -> Finding:
    wrong = [
        f"{info.clip_id}: {name}"
        for info in clips
        for name, feature in FEATURES.items()
        if name not in table or bool(table.at[info.clip_id, name]) != has_feature(info, feature)
    ]
    return _list("presence", str(path), wrong, "entries that are not as the clip table has them")


def check_features(root: Path) -> Finding:
    """Whether `features.csv` names the files of the layout."""
    path = root / layout.FEATURE_TABLE
    try:
        rows = read_feature_table(path)
    except InputError as error:
        return state("features", str(path), False, str(error))
    wrong = [name for name, feature in FEATURES.items() if name not in rows or not rows[name].leads_to(feature)]
    return _list("features", str(path), wrong, "rows that are missing or name other files than the layout's")


def check_feature(
    root: Path, feature: Feature, clips: dict[str, ClipInfo], chunks: dict[int, list[str]]
) -> Iterator[Finding]:
    """The chunks of one feature: archives that are safe, and in each the clips that should be there."""
    for chunk, clip_ids in chunks.items():
        path = feature.chunk_file(root, chunk)
        having = [each for each in clip_ids if each in clips and has_feature(clips[each], feature)]
        if not path.exists():
            yield state("chunk file", str(path), not having, f"missing, for {len(having)} clips; build them again")
            continue
        if not feature.members:
            yield _check_table(path, having)
            continue
        findings = list(check_archive(path))
        yield from findings
        if findings[0].verdict is not Verdict.PASSED:
            continue
        expected = {feature.member(alias, clip_id) for clip_id in having for alias in feature.members}
        found = set(ChunkArchive(path).names)
        yield _list("members of clips", str(path), sorted(expected - found), "members that are missing")
        # Real archives hold more of each clip (blurred boxes), which nothing here reads.
        strange = sorted(name for name in found - expected if name.partition(".")[0] not in clip_ids)
        yield _list("no other members", str(path), strange, "members of clips that are not in this chunk")


def _check_table(path: Path, clip_ids: Sequence[str]) -> Finding:
    try:
        found = set(tables.read_table(path, [], str(path)).to_pandas().index.get_level_values(0))
    except InputError as error:
        return state("rows of clips", str(path), False, str(error))
    return _list("rows of clips", str(path), sorted(set(clip_ids) ^ found), "clips without rows, or rows of no clip")


def _check_strangers(root: Path, chunks: dict[int, list[str]]) -> Finding:
    """Chunk files whose number no clip has: left by an interrupted commit, or put there."""
    known = {feature.chunk_file(root, chunk) for feature in STORED.values() for chunk in chunks}
    folders = {feature.chunk_file(root, 0).parent for feature in STORED.values()}
    found = {path for folder in folders if folder.is_dir() for path in folder.iterdir() if path.is_file()}
    strange = sorted(str(path.relative_to(root)) for path in found - known if not path.name.startswith("."))
    if not strange:
        return state("no other chunks", str(root), True, "each chunk file belongs to clips of the index")
    why = f"{len(strange)} chunk files belong to no clip, as {strange[0]}; an interrupted commit leaves such, harmless"
    return not_compared("no other chunks", str(root), why)


def _list(check: str, where: str, wrong: Sequence[str], what: str) -> Finding:
    if not wrong:
        return state(check, where, True, "all agree")
    return Finding(
        check, where, Verdict.FAILED, f"{len(wrong)} {what}, as {wrong[0]}; build or export again", len(wrong), 0
    )
