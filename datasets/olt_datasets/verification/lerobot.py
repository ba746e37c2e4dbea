"""Whether a LeRobot data set (version 3.0) says of itself what its tables and videos hold, and poses can be driven.

Files are read by what `meta/info.json` says of them, and not by what wrote them.
"""

import json
from collections.abc import Collection, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from olt_datasets.verification.file_list import check_file_list
from olt_datasets.verification.image_statistics import check_image_statistics
from olt_datasets.verification.pose_columns import check_pose_columns
from olt_generator.errors import InputError
from olt_generator.progress import Progress, silent
from olt_toolkit.clips.origin_files import decode_origin
from olt_toolkit.clips.pai_tables import read_table
from olt_toolkit.clips.verification.decoded_videos import decode_video
from olt_toolkit.clips.verification.findings import Finding, judge, not_compared, state
from olt_toolkit.clips.verification.report import Report
from olt_toolkit.clips.verification.verify import GROUPS, STORE_GROUP
from olt_toolkit.clips.verification.video_checks import check_decoded
from olt_toolkit.runtime.threads import use_one_thread
from olt_toolkit.runtime.workers import Engine, map_parallel

INFO_FILE = "meta/info.json"
STATISTICS_ERROR = 1e-3
"""Relative to the spread of a column, of the statistics that the data set states of it."""

_ROW = ("index", "episode_index", "frame_index", "timestamp", "task_index")
_EPISODE = ("episode_index", "tasks", "length", "dataset_from_index", "dataset_to_index")
_PLACE = ("chunk_index", "file_index", "to_timestamp")

VideoJob = tuple[str, Path, int, tuple[int, int], float]
"""Name of the camera, its file, frames that episodes promise of it, width and height, frames per second."""


def verify_lerobot(
    root: Path,
    groups: Collection[str] = GROUPS,
    workers: int = 1,
    on_progress: Progress = silent,
    engine: Engine = Engine.LOCAL,
) -> Report:
    """Look at a LeRobot data set; InputError where `meta/info.json` or the tables of episodes cannot be read."""
    info = _read_info(root)
    videos = [key for key, feature in info["features"].items() if feature["dtype"] == "video"]
    places = [f"videos/{key}/{name}" for key in videos for name in _PLACE]
    episodes = _read_parts(root / "meta" / "episodes", [*_EPISODE, *places])
    data = _read_parts(root / "data", [*_ROW])
    report = Report()
    if STORE_GROUP in groups:
        report.add(check_tables(root, info, episodes, data))
        report.add(check_statistics(root, info, data))
    if "files" in groups:
        report.add(check_file_list(root))
    if "motion" in groups:
        report.add(check_pose_columns(info, episodes, data, str(root / "data")))
    if "videos" in groups:
        jobs = list_videos(info, episodes, root)
        for findings in map_parallel(partial(check_video, root), jobs, workers, on_progress, engine):
            report.add(findings)
        for key in videos:
            of_key = [(path, frames) for name, path, frames, *_ in jobs if name == key]
            report.add(check_image_statistics(root, key, of_key))
    report.clips = len(set(episodes["clip_id"].to_pylist())) if "clip_id" in episodes.column_names else 0
    if "images" in groups:
        why = "a LeRobot data set tells no lens and no mounting; verify the clip stores that it was made of"
        report.add([not_compared("images", str(root), why)])
    return report


def check_tables(root: Path, info: dict[str, Any], episodes: pa.Table, data: pa.Table) -> Iterator[Finding]:
    """Whether totals, columns, indices and episodes agree."""
    where = str(root / INFO_FILE)
    tasks = read_table(root / "meta" / "tasks.parquet", ["task_index"], str(root / "meta" / "tasks.parquet"))
    for name, count in (("episodes", len(episodes)), ("frames", len(data)), ("tasks", len(tasks))):
        stated = info.get(f"total_{name}")
        yield state(f"number of {name}", where, stated == count, f"total_{name} is {stated}, the tables hold {count}")
    yield from _check_columns(info, data, str(root / "data"))
    lengths = episodes["length"].to_numpy()
    ends = np.cumsum(lengths)
    expected = {
        "index": np.arange(len(data)),
        "episode_index": np.repeat(episodes["episode_index"].to_numpy(), lengths),
        "frame_index": np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - lengths, lengths),
    }
    expected["timestamp"] = expected["frame_index"] / float(info["fps"])
    for name, values in expected.items():
        found = data[name].to_numpy()
        wrong = np.flatnonzero(np.abs(found - values) > 1e-4) if len(found) == len(values) else np.arange(len(found))
        at = f", first row {wrong[0]}" if len(wrong) else ""
        detail = f"rows whose {name} is not that of their episode{at}; export again"
        yield judge("rows of episodes", str(root / "data"), float(len(wrong)), 0.0, detail)
    place = str(root / "meta" / "episodes")
    bounds = np.stack([episodes["dataset_from_index"].to_numpy(), episodes["dataset_to_index"].to_numpy()])
    wrong = np.flatnonzero((bounds != np.stack([ends - lengths, ends])).any(axis=0))
    detail = "episodes that begin or end at other rows than they say" + "".join(f", as {each}" for each in wrong[:1])
    yield judge("bounds of episodes", place, float(len(wrong)), 0.0, detail)
    yield _check_tasks(tasks, episodes, data, lengths, place)


def check_statistics(root: Path, info: dict[str, Any], data: pa.Table) -> Iterator[Finding]:
    """Whether `meta/stats.json` tells the least, largest, mean and spread of every column of numbers."""
    path = root / "meta" / "stats.json"
    try:
        stats = json.loads(path.read_bytes())
    except (OSError, ValueError) as error:
        yield state("statistics", str(path), False, f"cannot be read ({error}); export again")
        return
    for name, feature in info["features"].items():
        if feature["dtype"] in ("video", "bool") or name not in data.column_names:
            continue
        values = column_values(data, name).reshape(len(data), -1)
        # Of numbers that are rounded to float32, as columns are and as writers take means of them.
        spread = values.std(axis=0) + 1e-3 * np.abs(values).max(axis=0) + 1e-9
        found = {each: getattr(values, each)(axis=0) for each in ("min", "max", "mean", "std")}
        try:
            errors = [np.abs(np.array(stats[name][each], float) - found[each]) / spread for each in found]
            error = float(np.max(errors))
        except (KeyError, TypeError, ValueError):
            yield state(
                "statistics", f"{path}: {name}", False, "they are missing, or of another length than the column"
            )
            continue
        detail = "of the column's spread, between what is stated and what the column holds; export again"
        yield judge("statistics", f"{path}: {name}", error, STATISTICS_ERROR, detail)


def list_videos(info: dict[str, Any], episodes: pa.Table, root: Path) -> list[VideoJob]:
    """Every video that episodes refer to, with the frames that they take of it."""
    jobs: list[VideoJob] = []
    rate = float(info["fps"])
    for key, feature in info["features"].items():
        if feature["dtype"] != "video":
            continue
        columns = [f"videos/{key}/{name}" for name in _PLACE]
        frames: dict[tuple[int, int], float] = {}
        for chunk, file, end in zip(*(episodes[name].to_pylist() for name in columns), strict=True):
            frames[chunk, file] = max(frames.get((chunk, file), 0.0), end)
        for (chunk, file), end in sorted(frames.items()):
            path = Path(info["video_path"].format(video_key=key, chunk_index=chunk, file_index=file))
            height, width, _ = feature["shape"]
            jobs.append((key, path, round(end * rate), (width, height), rate))
    return jobs


def check_video(root: Path, job: VideoJob) -> list[Finding]:
    """Whether a video has the frames, size and rate that the tables promise, and its masks those of the video."""
    use_one_thread()
    key, path, frames, size, rate = job
    where = str(root / path)
    if not (root / path).is_file():
        return [state("video file", where, False, "no such file; export again")]
    video = decode_video((root / path).read_bytes())
    times_us = np.round(np.arange(frames) * (1e6 / rate)).astype(np.int64)
    findings = [state("video file", where, True, "is there"), *check_decoded(video, times_us, size, where)]
    masks = root / "masks" / key / path.relative_to(Path("videos") / key).with_suffix(".parquet")
    if masks.is_file():
        findings.append(_check_masks(masks, frames, size))
    return findings


def column_values(data: pa.Table, name: str) -> NDArray[np.float64]:
    """A column of numbers (n,), or of vectors of one length (n, m)."""
    column = data[name].combine_chunks()
    if pa.types.is_fixed_size_list(column.type):
        return column.flatten().to_numpy().astype(np.float64).reshape(len(column), -1)
    return column.to_numpy(zero_copy_only=False).astype(np.float64)


def _check_columns(info: dict[str, Any], data: pa.Table, where: str) -> Iterator[Finding]:
    for name, feature in info["features"].items():
        if feature["dtype"] == "video":
            continue
        if name not in data.column_names:
            yield state("columns", f"{where}: {name}", False, "the column is missing; export again")
            continue
        kind, length = data.schema.field(name).type, int(np.prod(feature["shape"]))
        item = kind.value_type if pa.types.is_fixed_size_list(kind) else kind
        size = kind.list_size if pa.types.is_fixed_size_list(kind) else 1
        names = {"float": "float32", "double": "float64"}
        holds = (names.get(str(item), str(item)), size) == (feature["dtype"], length)
        yield state("columns", f"{where}: {name}", holds, f"{kind} for {feature['dtype']} of length {length}")
        if feature["dtype"].startswith("float"):
            wrong = int((~np.isfinite(column_values(data, name)).reshape(len(data), -1)).any(axis=1).sum())
            yield judge("finite", f"{where}: {name}", float(wrong), 0.0, "rows hold what is no number; export again")


def _check_tasks(
    tasks: pa.Table, episodes: pa.Table, data: pa.Table, lengths: NDArray[np.int64], where: str
) -> Finding:
    """Whether the rows of each episode have the task that the episode names."""
    named = tasks.to_pandas()["task_index"].to_dict()
    first = [of_episode[0] if of_episode else None for of_episode in episodes["tasks"].to_pylist()]
    expected = np.repeat(np.array([named.get(task, -1) for task in first], np.int64), lengths)
    found = data["task_index"].to_numpy()
    wrong = int((found != expected).sum()) if len(found) == len(expected) else len(found)
    return judge(
        "tasks of episodes", where, float(wrong), 0.0, "rows have another task than their episode; export again"
    )


def _check_masks(path: Path, frames: int, size: tuple[int, int]) -> Finding:
    try:
        masks = decode_origin(path.read_bytes(), str(path))
    except InputError as error:
        return state("mask", str(path), False, str(error))
    holds = len(masks.timestamps_us) == frames and (masks.width, masks.height) == size
    detail = f"{len(masks.timestamps_us)} masks of {masks.width} x {masks.height} for {frames} frames of {size}"
    return state("mask", str(path), holds, detail)


def _read_info(root: Path) -> dict[str, Any]:
    path = root / INFO_FILE
    try:
        info = json.loads(path.read_bytes())
        missing = [name for name in ("features", "fps", "video_path", "codebase_version") if name not in info]
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); export again") from error
    if missing or not isinstance(info["features"], dict):
        raise InputError(f"{path}: {', '.join(missing) or 'features'} is missing; export again")
    return info


def _read_parts(folder: Path, columns: list[str]) -> pa.Table:
    """All tables below a folder, in the order of their numbers, as one with at least these columns."""
    parts = sorted(folder.glob("chunk-*/file-*.parquet"))
    if not parts:
        raise InputError(f"{folder}: no table chunk-*/file-*.parquet; export again")
    try:
        table = pa.concat_tables([pq.read_table(part) for part in parts])
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{folder}: its tables cannot be read ({error}); export again") from error
    missing = [name for name in columns if name not in table.column_names or table[name].null_count]
    if missing:
        raise InputError(f"{folder}: column {', '.join(missing)} is missing, or has missing values; export again")
    return table
