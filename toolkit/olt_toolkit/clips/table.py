"""The table of clips, `clips.parquet`: what the PhysicalAI-AV layout has no place for.

One row a clip, in the order in which clips were added. This is the only place that knows its columns. The same table
under another name lists clips that are indexed and not built.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_toolkit.clips.clip import ClipInfo, ClipOrigin, ViewProvenance, check_clip_id
from olt_toolkit.clips.pai_tables import read_table
from olt_toolkit.clips.table_values import check_rows

CLIP_TABLE = "clips.parquet"
TABLE_VERSION = 5
VERSION_KEY = b"table_version"
_LONGEST_VERSION = 9

_VIEW = pa.struct(
    [
        ("camera", pa.string()),
        ("kind", pa.string()),
        ("engine", pa.string()),
        ("version", pa.string()),
        ("seed", pa.int64()),
        ("observed_share", pa.float64()),
        ("invented_share", pa.float64()),
        ("other_times_share", pa.float64()),
    ]
)
_FILE = pa.struct([("file", pa.string()), ("checksum", pa.string())])
SCHEMA = pa.schema(
    [
        ("clip_id", pa.string()),
        ("name", pa.string()),
        ("scene_id", pa.string()),
        ("source", pa.string()),
        ("recording", pa.string()),
        ("start_us", pa.int64()),
        ("end_us", pa.int64()),
        ("country", pa.string()),
        ("licence", pa.string()),
        ("kind", pa.string()),
        ("category", pa.string()),
        ("factors", pa.list_(pa.string())),
        ("split", pa.string()),
        ("doubts", pa.list_(pa.string())),
        ("scale_sigma", pa.float64()),
        ("acceleration_noise", pa.float64()),
        ("acceleration_noise_basis", pa.string()),
        ("duration_us", pa.int64()),
        ("sample_t0_us", pa.list_(pa.int64())),
        ("no_sample_reason", pa.string()),
        ("created_with", pa.string()),
        ("checksum", pa.string()),
        ("fingerprint", pa.binary()),
        ("action_errors", pa.list_(pa.float64())),
        ("build_options", pa.string()),
        ("file_checksums", pa.list_(_FILE)),
        ("views", pa.list_(_VIEW)),
    ],
    metadata={VERSION_KEY: str(TABLE_VERSION).encode()},
)


def write_clip_table(path: Path, clips: Sequence[ClipInfo]) -> None:
    """Write the table; it appears whole. An `InputError` tells a value that could not be read again."""
    rows = []
    for info in clips:
        row = {field.name: getattr(info, field.name) for field in fields(info) if field.name != "origin"}
        views = [{"camera": camera, **asdict(view)} for camera, view in info.views.items()]
        files = info.file_checksums
        checksums = None if files is None else [{"file": name, "checksum": files[name]} for name in sorted(files)]
        rows.append(row | asdict(info.origin) | {"views": views, "file_checksums": checksums})
    table = pa.Table.from_pylist(rows, schema=SCHEMA)
    check_rows(table, str(path))
    with write_whole(path) as temporary:
        pq.write_table(table, temporary)


def read_clip_table(path: Path) -> list[ClipInfo]:
    """Read the table; an `InputError` where it is missing, of another version, or holds what no clip can have."""
    table = read_table(path, [], str(path))
    # Asked before the columns, which other versions have others of.
    check_table_version((table.schema.metadata or {}).get(VERSION_KEY), path)
    for name in SCHEMA.names:
        if name not in table.column_names:
            raise InputError(f"{path}: column {name} is missing")
        if table.schema.field(name).type != SCHEMA.field(name).type:
            raise InputError(f"{path}: column {name} is {table.schema.field(name).type}, not {SCHEMA.field(name).type}")
    check_rows(table, str(path))
    clips = [_info(row, f"{path}: row {index}") for index, row in enumerate(table.to_pylist())]
    twice, count = Counter(info.clip_id for info in clips).most_common(1)[0] if clips else ("", 0)
    if count > 1:
        raise InputError(f"{path}: column clip_id has {twice!r} more than once; each clip needs one row")
    return clips


def check_table_version(version: bytes | str | None, path: Path) -> None:
    """Check the version that the metadata of a table tell; an `InputError` where this release does not read it."""
    text = version.decode(errors="replace") if isinstance(version, bytes) else version
    if text is None or not text.isdecimal() or len(text) > _LONGEST_VERSION:
        raise InputError(f"{path}: table_version is {text!r:.40}; this is no clip table")
    if int(text) != TABLE_VERSION:
        advice = (
            "install a newer release"
            if int(text) > TABLE_VERSION
            else "build or index the clips again, under a new name"
        )
        raise InputError(f"{path}: table_version is {text}, this release reads {TABLE_VERSION}; {advice}")


def _info(row: dict[str, Any], where: str) -> ClipInfo:
    check_clip_id(row["clip_id"], where)
    row["views"] = {view.pop("camera"): ViewProvenance(**view) for view in row["views"]}
    row["factors"], row["sample_t0_us"] = tuple(row["factors"]), tuple(row["sample_t0_us"])
    row["doubts"] = None if row["doubts"] is None else tuple(row["doubts"])
    row["action_errors"] = None if row["action_errors"] is None else tuple(row["action_errors"])
    files = row["file_checksums"]
    row["file_checksums"] = None if files is None else {each["file"]: each["checksum"] for each in files}
    origin = ClipOrigin(**{field.name: row.pop(field.name) for field in fields(ClipOrigin)})
    return ClipInfo(**row, origin=origin)
