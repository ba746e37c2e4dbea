"""Export to one folder in PhysicalAI-AV layout, which the public devkit and the public Alpamayo recipes read unchanged.

The folder holds no reasoning text: none is invented. Sample times stand in the column `event_t0s` of the clip index,
where the recipes look when `use_default_keyframe` is false (docs/formats/sft_recipes.md).
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

import pandas as pd

from olt_datasets.export.chunks import ExportChunk, divide_into_chunks, write_chunk
from olt_datasets.export.contents import Contents, ExportItem
from olt_datasets.export.look import halves, leave_out_failing, look_at_export
from olt_datasets.export.writing import write_export
from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_generator.progress import Progress, silent
from olt_toolkit import ClipInfo, ClipStore
from olt_toolkit.clips.action_errors import summarize_action_errors
from olt_toolkit.clips.files import write_metadata
from olt_toolkit.clips.pai_layout import CLIP_INDEX
from olt_toolkit.clips.pai_tables import read_indexed, to_bytes
from olt_toolkit.clips.table import CLIP_TABLE, write_clip_table
from olt_toolkit.clips.verification.verify import verify_store
from olt_toolkit.policy.sample import KEYFRAME_US
from olt_toolkit.runtime.workers import Engine, map_parallel

Rows = Sequence[tuple[ExportChunk, ExportItem]]
"""The clips that were written, in the order of the clip index."""


def export_pai(
    contents: Contents,
    out: Path,
    keep_going: bool = False,
    workers: int = 1,
    engine: Engine = Engine.LOCAL,
    on_progress: Progress = silent,
    verify: bool = True,
) -> dict[str, Any]:
    """Write the clips to `out`, which appears when it is complete; an interrupted export goes on when it is repeated.

    Args:
        keep_going: leave out clips that are damaged or fail verification and list them, instead of stopping.
        workers, engine: number of processes and where they run.
        on_progress: told the finished part, 0 to 1.
        verify: look at every clip of the export before it appears.

    Returns:
        The summary that is also written to `out/export.json`.

    Raises:
        InputError: `out` holds something else, a clip is damaged and `keep_going` is off, no clip is left, a file
            cannot be written, or a check fails; names the file.
    """
    on_written, on_verified = halves(on_progress, verify)
    failing: dict[str, str] = {}
    if verify and keep_going:
        contents, failing = leave_out_failing(contents, out, workers, silent, engine)

    def write(root: Path) -> dict[str, Any]:
        chunks = divide_into_chunks(contents.groups)
        write_one = partial(write_chunk, root, keep_going=keep_going)
        results = map_parallel(write_one, chunks, workers, on_written, engine)
        failures = {clip: reason for result in results for clip, reason in result["failures"].items()}
        rows = [(chunk, item) for chunk in chunks for item in chunk.items if item.listed_as not in failures]
        if not rows:
            raise InputError(f"{out}: no clip could be exported: {next(iter(failures.values()))}")
        infos = _write_tables(root, rows)
        verified = look_at_export(verify_store, root, out, workers, on_verified, engine) if verify else None
        told = {"failures": failing | failures, "verification": verified}
        return _summarize(contents, chunks, results, rows, infos) | told

    return write_export("pai", contents, {"verify": verify}, out, write)


def _write_tables(root: Path, rows: Rows) -> list[ClipInfo]:
    stores = {store: ClipStore(store) for store in {item.store for _, item in rows}}
    infos = [
        replace(stores[item.store].info(item.clip_id).with_samples(item.t0s_us), clip_id=item.listed_as)
        for _, item in rows
    ]
    write_metadata(root, infos, [chunk.number for chunk, _ in rows])
    write_clip_table(root / CLIP_TABLE, infos)
    path = root / CLIP_INDEX
    index = read_indexed(path, ["chunk"], ["clip_id"])
    index["event_t0s"] = pd.Series([list(item.t0s_us) for _, item in rows], index.index)
    with write_whole(path) as temporary:
        temporary.write_bytes(to_bytes(index))
    return infos


def _summarize(
    contents: Contents,
    chunks: Sequence[ExportChunk],
    results: Sequence[dict[str, Any]],
    rows: Rows,
    infos: Sequence[ClipInfo],
) -> dict[str, Any]:
    numbers = [[chunk.number for chunk in chunks if chunk.group == index] for index in range(len(contents.groups))]
    clips = Counter(chunk.group for chunk, _ in rows)
    groups = [
        {
            "component": group.component,
            "kind": group.kind,
            "source": group.source,
            "clips": clips[index],
            "first_chunk": of_group[0],
            "last_chunk": of_group[-1],
            "chunk_ids": f"{of_group[0]}-{of_group[-1] + 1}",
        }
        for index, (group, of_group) in enumerate(zip(contents.groups, numbers, strict=True))
    ]
    components = {}
    for name, part in groupby(groups, itemgetter("component")):
        of_part = list(part)
        chunk_ids = f"{of_part[0]['first_chunk']}-{of_part[-1]['last_chunk'] + 1}"
        components[name] = {"clips": sum(group["clips"] for group in of_part), "chunk_ids": chunk_ids}
    return {
        "clips": len(rows),
        "clips_with_default_keyframe": sum(KEYFRAME_US in item.t0s_us for _, item in rows),
        "further_uses": sum(item.listed_as != item.clip_id for _, item in rows),
        "groups": groups,
        "components": components,
        "chunks": {
            how: {
                "count": sum(result["how"] == how for result in results),
                "bytes": sum(result["size"] for result in results if result["how"] == how),
            }
            for how in ("linked", "copied", "packed")
        },
        "action_errors": summarize_action_errors([error for info in infos for error in info.action_errors or ()]),
        "samples_without_action_error": sum(len(info.sample_t0_us) for info in infos if info.action_errors is None),
        "licences": dict(Counter(info.origin.licence or "not told" for info in infos)),
        "notes": list(contents.notes),
    }
