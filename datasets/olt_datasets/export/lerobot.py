"""Export as a LeRobot data set, version 3.0 of its format: tables, one video per clip and camera, and statistics.

An episode is a stretch of one clip on the 0.1 s grid; see `lerobot_clip` for what a frame holds. Roll and pitch of the
poses are left out. The task of an episode is the category of its clip: no instruction is invented.
"""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from olt_datasets.export.contents import Contents
from olt_datasets.export.lerobot_clip import FILES_PER_CHUNK, FRAME_RATE, POSE_FIELDS, ClipFrames, video_key, write_clip
from olt_datasets.export.options import WorkOptions, fingerprint_export
from olt_datasets.export.writing import EXPORT_FILE, find_finished, resumable_folder, write_file
from olt_generator.errors import InputError
from olt_generator.progress import Progress, silent
from olt_toolkit.clips.clip import ClipInfo
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.policy.contract import STEP_US
from olt_toolkit.policy.window import FUTURE_OFFSETS_US, HISTORY_OFFSETS_US
from olt_toolkit.rigs.rig import POLICY_CAMERAS
from olt_toolkit.runtime.workers import map_parallel

VERSION = "v3.0"
POLICY_IMAGE_SIZE = (320, 576)
CLIPS_PER_TABLE = 1000
QUANTILES = (0.01, 0.10, 0.50, 0.90, 0.99)

Columns = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class _Episode:
    """Frames first to end of a clip."""

    clip: ClipFrames
    info: ClipInfo
    component: str
    first: int
    end: int

    def __len__(self) -> int:
        return self.end - self.first


def export_lerobot(
    contents: Contents,
    out: Path,
    options: WorkOptions,
    on_progress: Progress = silent,
    image_size: tuple[int, int] = POLICY_IMAGE_SIZE,
) -> dict[str, Any]:
    """Write the clips to `out`, which appears when it is complete; an interrupted export goes on when it is repeated.

    Returns:
        The summary that is also written to `out/export.json`.

    Raises:
        InputError: `out` holds something else, a clip is damaged and `options.keep_going` is off, no clip is left, or
            a file cannot be written; names the file.
    """
    contents = contents.with_one_item_per_clip()
    fingerprint = fingerprint_export("lerobot", contents, list(image_size))
    finished = find_finished(out, fingerprint)
    if finished is not None:
        return finished
    with resumable_folder(out, fingerprint) as root:
        write = partial(write_clip, root, image_size, options.keep_going)
        jobs = list(enumerate(contents.items))
        clips = map_parallel(write, jobs, options.workers, on_progress, options.engine)
        episodes = _list_episodes(contents, clips)
        if not episodes:
            raise InputError(f"{out}: no clip could be exported: {clips[0].failure}")
        rows = _write_data(root, episodes)
        _write_meta(root, contents, episodes, rows, image_size)
        summary = _summarize(contents, clips, episodes) | {"out": str(out), "fingerprint": fingerprint}
        with write_file(root / EXPORT_FILE) as temporary:
            temporary.write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    return summary


def _list_episodes(contents: Contents, clips: Sequence[ClipFrames]) -> list[_Episode]:
    components = [group.component for group in contents.groups for _ in group.items]
    stores = {item.store: ClipStore(item.store) for item in contents.items}
    return [
        _Episode(clip, stores[clip.item.store].info(clip.item.clip_id), component, first, end)
        for clip, component in zip(clips, components, strict=True)
        if clip.failure is None
        for first, end in clip.runs
    ]


def _tasks(episodes: Sequence[_Episode]) -> list[str]:
    return sorted({episode.info.category for episode in episodes})


def _write_data(root: Path, episodes: Sequence[_Episode]) -> Columns:
    """Write the tables of frames; returns their columns, all frames together."""
    tasks = _tasks(episodes)
    lengths = np.array([len(episode) for episode in episodes])
    columns: Columns = {
        "observation.state": np.concatenate([each.clip.state[each.first : each.end] for each in episodes]),
        "action": np.concatenate([each.clip.action[each.first : each.end] for each in episodes]),
        "is_sample": np.concatenate([each.clip.is_sample[each.first : each.end] for each in episodes]),
        "frame_index": np.concatenate([np.arange(length) for length in lengths]),
        "episode_index": np.repeat(np.arange(len(episodes)), lengths),
        "index": np.arange(lengths.sum()),
        "task_index": np.repeat([tasks.index(episode.info.category) for episode in episodes], lengths),
    }
    columns["timestamp"] = (columns["frame_index"] / FRAME_RATE).astype(np.float32)
    table = pa.table({name: _to_arrow(values) for name, values in columns.items()})
    place = np.repeat([_data_file(episode) for episode in episodes], lengths)
    for file in np.unique(place):
        with write_file(root / _numbered("data", int(file))) as temporary:
            pq.write_table(table.filter(pa.array(place == file)), temporary)
    return columns


def _to_arrow(values: NDArray[Any]) -> pa.Array:
    if values.ndim == 1:
        return pa.array(values)
    return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])


def _data_file(episode: _Episode) -> int:
    return episode.clip.number // CLIPS_PER_TABLE


def _numbered(folder: str, number: int, suffix: str = "parquet") -> str:
    chunk, file = divmod(number, FILES_PER_CHUNK)
    return f"{folder}/chunk-{chunk:03d}/file-{file:03d}.{suffix}"


def _write_meta(
    root: Path, contents: Contents, episodes: Sequence[_Episode], columns: Columns, image_size: tuple[int, int]
) -> None:
    tasks = _tasks(episodes)
    with write_file(root / "meta" / "tasks.parquet") as temporary:
        pd.DataFrame({"task_index": range(len(tasks))}, index=pd.Index(tasks)).to_parquet(temporary)
    with write_file(root / _numbered("meta/episodes", 0)) as temporary:
        pq.write_table(pa.Table.from_pylist(_episode_rows(episodes)), temporary)
    info = {
        "codebase_version": VERSION,
        "robot_type": None,
        "total_episodes": len(episodes),
        "total_frames": len(columns["index"]),
        "total_tasks": len(tasks),
        "chunks_size": FILES_PER_CHUNK,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": FRAME_RATE,
        "splits": {contents.split: f"0:{len(episodes)}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
        "features": _features(image_size),
    }
    stats = {name: _vector_stats(values) for name, values in columns.items() if values.dtype != np.bool_}
    stats |= {video_key(camera): _image_stats(episodes, camera) for camera in POLICY_CAMERAS}
    for name, content in {"info": info, "stats": stats}.items():
        with write_file(root / "meta" / f"{name}.json") as temporary:
            temporary.write_text(json.dumps(content, indent=4) + "\n", encoding="utf-8")


def _features(image_size: tuple[int, int]) -> dict[str, dict[str, Any]]:
    height, width = image_size
    video = {
        "dtype": "video",
        "shape": [height, width, 3],
        "names": ["height", "width", "channels"],
        "info": {
            "video.height": height,
            "video.width": width,
            "video.codec": "h264",
            "video.pix_fmt": "yuv420p",
            "video.is_depth_map": False,
            "video.fps": FRAME_RATE,
            "video.channels": 3,
            "has_audio": False,
        },
    }
    scalars = dict.fromkeys(("frame_index", "episode_index", "index", "task_index"), "int64")
    scalars |= {"timestamp": "float32", "is_sample": "bool"}
    return {
        **{video_key(camera): video for camera in POLICY_CAMERAS},
        "observation.state": _pose_feature(HISTORY_OFFSETS_US),
        "action": _pose_feature(FUTURE_OFFSETS_US),
        **{name: {"dtype": dtype, "shape": [1], "names": None} for name, dtype in scalars.items()},
    }


def _pose_feature(offsets_us: NDArray[np.int64]) -> dict[str, Any]:
    names = [f"{field}({offset / 1e6:+.1f} s)" for offset in offsets_us.tolist() for field in POSE_FIELDS]
    return {"dtype": "float32", "shape": [len(names)], "names": names}


def _episode_rows(episodes: Sequence[_Episode]) -> list[dict[str, Any]]:
    rows = []
    begin = 0
    for number, episode in enumerate(episodes):
        row = {
            "episode_index": number,
            "tasks": [episode.info.category],
            "length": len(episode),
            "dataset_from_index": begin,
            "dataset_to_index": begin + len(episode),
            **_place("data", _data_file(episode)),
            **_place("meta/episodes", 0),
            "clip_id": episode.clip.item.clip_id,
            "component": episode.component,
            "kind": episode.info.kind,
            "source": episode.info.source,
            "start_us": int(episode.clip.times_us[episode.first]),
        }
        for camera in POLICY_CAMERAS:
            row |= _place(f"videos/{video_key(camera)}", episode.clip.number)
            row[f"videos/{video_key(camera)}/from_timestamp"] = episode.first / FRAME_RATE
            row[f"videos/{video_key(camera)}/to_timestamp"] = episode.end / FRAME_RATE
        rows.append(row)
        begin += len(episode)
    return rows


def _place(name: str, number: int) -> dict[str, int]:
    chunk, file = divmod(number, FILES_PER_CHUNK)
    return {f"{name}/chunk_index": chunk, f"{name}/file_index": file}


def _vector_stats(values: NDArray[Any]) -> dict[str, list[Any]]:
    values = values.reshape(len(values), -1)
    stats = {name: getattr(np, name)(values, axis=0).tolist() for name in ("min", "max", "mean", "std")}
    quantiles = np.quantile(values, QUANTILES, axis=0).tolist()
    return stats | {"count": [len(values)]} | dict(zip(_quantile_names(), quantiles, strict=True))


def _image_stats(episodes: Sequence[_Episode], camera: str) -> dict[str, list[Any]]:
    """Statistics over all pixels of all frames, from how often each level occurs; levels are 0 to 1."""
    clips = {episode.clip.number: episode.clip for episode in episodes}
    counts = np.sum([clip.levels[camera] for clip in clips.values()], axis=0)
    levels = np.arange(256) / 255
    share = counts / counts.sum(axis=1, keepdims=True)
    mean = share @ levels
    cumulated = np.cumsum(share, axis=1)
    seen = [np.flatnonzero(row) for row in counts]
    stats = {
        "min": np.array([levels[row[0]] for row in seen]),
        "max": np.array([levels[row[-1]] for row in seen]),
        "mean": mean,
        "std": np.sqrt(np.maximum(share @ levels**2 - mean**2, 0.0)),
        **{
            name: np.array([levels[np.searchsorted(row, quantile)] for row in cumulated])
            for name, quantile in zip(_quantile_names(), QUANTILES, strict=True)
        },
    }
    frames = sum(len(clip.times_us) for clip in clips.values())
    return {name: values.reshape(3, 1, 1).tolist() for name, values in stats.items()} | {"count": [frames]}


def _quantile_names() -> list[str]:
    return [f"q{round(100 * quantile):02d}" for quantile in QUANTILES]


def _summarize(contents: Contents, clips: Sequence[ClipFrames], episodes: Sequence[_Episode]) -> dict[str, Any]:
    by_component: Mapping[str, int] = Counter(episode.component for episode in episodes)
    done = [clip for clip in clips if clip.failure is None]
    samples = sum(int(clip.is_sample.sum()) for clip in done)
    licences = {clip.number: licence for clip, licence in ((each.clip, each.info.origin.licence) for each in episodes)}
    return {
        "format": "lerobot",
        "split": contents.split,
        "clips": len(done),
        "episodes": dict(by_component),
        "frames": sum(len(clip.times_us) for clip in done),
        "samples": samples,
        "licences": dict(Counter(licence or "not told" for licence in licences.values())),
        "left_out": contents.left_out,
        "notes": [*contents.notes, *_history_notes(done)],
        "failures": {clip.item.clip_id: clip.failure for clip in clips if clip.failure is not None},
    }


def _history_notes(clips: Sequence[ClipFrames]) -> list[str]:
    """How many samples lack frames before them: LeRobot repeats the first frame of an episode there, and says so."""
    short = 0
    for clip in clips:
        present = set(clip.times_us.tolist())
        samples = clip.times_us[clip.is_sample].tolist()
        short += sum(any(time - step * STEP_US not in present for step in (1, 2, 3)) for time in samples)
    if not short:
        return []
    return [f"{short} samples have fewer than three frames before them, as the ego motion begins too late for a state"]
