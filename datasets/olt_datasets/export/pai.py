"""Export to one folder in PhysicalAI-AV layout, which the public devkit and the public Alpamayo recipes read unchanged.

The folder holds no reasoning text: none is invented. Sample times stand in the column `event_t0s` of the clip index,
where the recipes look when `use_default_keyframe` is false.
"""

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from olt_datasets.export.chunks import ChunkPlan, ChunkResult, plan_chunks, write_chunk
from olt_datasets.export.contents import Contents, ExportGroup, ExportItem
from olt_datasets.export.options import WorkOptions, fingerprint_export
from olt_datasets.export.writing import EXPORT_FILE, find_finished, naming, resumable_folder, write_file
from olt_generator.errors import InputError
from olt_generator.progress import Progress, silent
from olt_toolkit.clips.clip import ClipInfo
from olt_toolkit.clips.files import write_metadata
from olt_toolkit.clips.pai_layout import CLIP_INDEX
from olt_toolkit.clips.pai_tables import read_indexed, to_bytes
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.table import CLIP_TABLE, write_clip_table
from olt_toolkit.policy.sample import KEYFRAME_US
from olt_toolkit.runtime.workers import map_parallel


def export_pai(
    contents: Contents,
    out: Path,
    options: WorkOptions,
    on_progress: Progress = silent,
) -> dict[str, Any]:
    """Write the clips to `out`, which appears when it is complete; an interrupted export goes on when it is repeated.

    Returns:
        The summary that is also written to `out/export.json`.

    Raises:
        InputError: `out` holds something else, a clip is damaged and `options.keep_going` is off, no clip is left, or
            a file cannot be written; names the file.
    """
    fingerprint = fingerprint_export("pai", contents)
    finished = find_finished(out, fingerprint)
    if finished is not None:
        return finished
    with resumable_folder(out, fingerprint) as root:
        plans = plan_chunks(contents.groups)
        flat = [plan for group in plans for plan in group]
        write = partial(write_chunk, root, keep_going=options.keep_going)
        results = map_parallel(write, flat, options.workers, on_progress, options.engine)
        by_number = {plan.number: result for plan, result in zip(flat, results, strict=True)}
        if not any(result.listed for result in results):
            raise InputError(f"{out}: no clip could be exported: {_first_failure(results)}")
        infos, rows = _list_clips(flat, results)
        _write_tables(root, infos, rows)
        summary = _summarize(contents, plans, by_number, infos, rows) | {"out": str(out), "fingerprint": fingerprint}
        with write_file(root / EXPORT_FILE) as temporary:
            temporary.write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    return summary


@dataclass(frozen=True)
class _Row:
    chunk: int
    item: ExportItem


def _list_clips(plans: Sequence[ChunkPlan], results: Sequence[ChunkResult]) -> tuple[list[ClipInfo], list[_Row]]:
    rows = [
        _Row(plan.number, item)
        for plan, result in zip(plans, results, strict=True)
        for item in plan.items
        if item.listed_as not in result.failures
    ]
    stores = {row.item.store: ClipStore(row.item.store) for row in rows}
    infos = [
        replace(
            stores[row.item.store].info(row.item.clip_id),
            clip_id=row.item.listed_as,
            sample_t0_us=tuple(sorted(row.item.t0s_us)),
        )
        for row in rows
    ]
    return infos, rows


def _write_tables(root: Path, infos: Sequence[ClipInfo], rows: Sequence[_Row]) -> None:
    path = root / CLIP_INDEX
    with naming(path):
        write_metadata(root, infos, [row.chunk for row in rows])
        write_clip_table(root / CLIP_TABLE, infos)
    index = read_indexed(path, ["chunk"], ["clip_id"])
    index["event_t0s"] = pd.Series([list(row.item.t0s_us) for row in rows], index.index)
    with write_file(path) as temporary:
        temporary.write_bytes(to_bytes(index))


def _summarize(
    contents: Contents,
    plans: Sequence[Sequence[ChunkPlan]],
    results: dict[int, ChunkResult],
    infos: Sequence[ClipInfo],
    rows: Sequence[_Row],
) -> dict[str, Any]:
    groups = [_describe_group(group, chunks, results) for group, chunks in zip(contents.groups, plans, strict=True)]
    how = {
        name: [result for result in results.values() if result.how == name] for name in ("linked", "copied", "packed")
    }
    return {
        "format": "pai",
        "split": contents.split,
        "clips": len(rows),
        "clips_with_default_keyframe": sum(KEYFRAME_US in row.item.t0s_us for row in rows),
        "further_uses": sum(row.item.listed_as != row.item.clip_id for row in rows),
        "groups": groups,
        "components": _join_groups(groups),
        "chunks": {
            name: {"count": len(parts), "bytes": sum(part.size for part in parts)} for name, parts in how.items()
        },
        "licences": dict(Counter(info.origin.licence or "not told" for info in infos)),
        "left_out": contents.left_out,
        "notes": list(contents.notes),
        "failures": {clip: reason for result in results.values() for clip, reason in result.failures.items()},
    }


def _describe_group(group: ExportGroup, chunks: Sequence[ChunkPlan], results: dict[int, ChunkResult]) -> dict[str, Any]:
    first, last = chunks[0].number, chunks[-1].number
    return {
        "component": group.component,
        "kind": group.kind,
        "source": group.source,
        "clips": sum(len(results[chunk.number].listed) for chunk in chunks),
        "first_chunk": first,
        "last_chunk": last,
        "chunk_ids": f"{first}-{last + 1}",
    }


def _join_groups(groups: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Clips and chunk range of each component; its groups follow each other."""
    joined = {}
    for name in dict.fromkeys(group["component"] for group in groups):
        parts = [group for group in groups if group["component"] == name]
        chunk_ids = f"{parts[0]['first_chunk']}-{parts[-1]['last_chunk'] + 1}"
        joined[name] = {"clips": sum(part["clips"] for part in parts), "chunk_ids": chunk_ids}
    return joined


def _first_failure(results: Sequence[ChunkResult]) -> str:
    return next(reason for result in results for reason in result.failures.values())
