"""Where each frame of the Waymo E2E data set lies: its records are shuffled over hundreds of shards.

The index of a shard is a Parquet file in the cache, made once for each state of the shard (name, size, time of change)
without reading an image. All of them together are one table sorted by drive, in which a drive is found quickly.
"""

import hashlib
from pathlib import Path
from typing import NamedTuple

import polars as pl

from olt_datasets.sources.waymo.frames import read_states
from olt_generator.errors import InputError
from olt_generator.files import walk_files, write_whole
from olt_toolkit.recordings.tfrecord import map_records, record_spans
from olt_toolkit.runtime.workers import default_workers, map_parallel

SHARDS = "*.tfrecord*"
SCHEMA = pl.Schema(
    {
        "sequence": pl.String,
        "index": pl.Int32,
        "shard": pl.String,
        "offset": pl.Int64,
        "length": pl.Int64,
        "past": pl.List(pl.Float32),
        "future": pl.List(pl.Float32),
        "cameras": pl.List(pl.String),
        "rated": pl.Boolean,
    }
)
"""A row is a frame; `shard` is its path in the data set, `past` and `future` hold x and y in turn, metres."""
_ROWS_IN_GROUP = 4096
# Fewer bytes than this are indexed sooner than processes are started.
_WORTH_WORKERS = 4 << 30


class ShardTask(NamedTuple):
    """A shard to index, its path in the data set, and where its index goes."""

    path: Path
    name: str
    target: Path


def build_index(root: Path, cache: Path) -> Path:
    """The index of all shards below a folder, else InputError, in one Parquet file; only what is new is read."""
    shards = [path for path in walk_files(root) if path.match(SHARDS) and path.is_file()]
    if not shards:
        raise InputError(f"{root}: holds no file {SHARDS}; give the folder with the shards of Waymo's E2E data set")
    tasks = []
    for shard in shards:
        state, name = shard.stat(), shard.relative_to(root).as_posix()
        digest = _digest([name, str(state.st_size), str(state.st_mtime_ns), str(SCHEMA)])
        tasks.append(ShardTask(shard, name, cache / f"shard-{digest}.parquet"))
    missing = [task for task in tasks if not task.target.is_file()]
    worth_workers = sum(task.path.stat().st_size for task in missing) > _WORTH_WORKERS
    map_parallel(index_shard, missing, default_workers() if worth_workers else 1)
    together = cache / f"frames-{_digest([task.target.name for task in tasks])}.parquet"
    if not together.is_file():
        frames = pl.concat([pl.read_parquet(task.target) for task in tasks]).sort("sequence", "index", "shard")
        with write_whole(together) as path:
            frames.write_parquet(path, row_group_size=_ROWS_IN_GROUP)
    return together


def index_shard(task: ShardTask) -> None:
    """Write the index of one shard; where it is damaged, an InputError names the record."""
    content = map_records(task.path)
    rows = []
    for offset, length in record_spans(content, str(task.path)):
        states = read_states(content[offset : offset + length], f"{task.path}: record at byte {offset}")
        flat = {name: states[name].ravel() for name in ("past", "future")}
        rows.append(states | flat | {"shard": task.name, "offset": offset, "length": length})
    with write_whole(task.target) as path:
        pl.DataFrame(rows, schema=SCHEMA).write_parquet(path)


def _digest(words: list[str]) -> str:
    return hashlib.blake2b("\x1f".join(words).encode(), digest_size=16).hexdigest()
