"""Export as a LeRobot data set, version 3.0 of its format: tables, one video per clip and camera, and statistics.

A frame of the data set is a moment of the 0.1 s grid with one image of each camera of a policy, the past 16 poses as
state and the next 64 as action, all in the rig frame of that moment, without roll and pitch. A policy that looks back
takes images of earlier frames, so three frames stand before each sample time, where the ego motion reaches back far
enough to give their state. An episode is a stretch of one clip on the grid. Its task is the category of the clip: no
instruction is invented.

Images keep the size of the clips, which must be the same in all of them camera by camera, unless another is asked for;
then summary and metadata tell the sizes that they had.

The masks of videos that were not seen whole lie beside them in `masks/`, by the same names and frame by frame
(`olt_toolkit.clips.origin_files`); readers of the format do not look there.
"""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from olt_datasets.export.contents import Contents, ExportItem
from olt_datasets.export.image_sizes import Sizes, only_sizes, read_image_sizes, tell_resized, word_size
from olt_datasets.export.look import halves, leave_out_failing, look_at_export
from olt_datasets.export.writing import finished_part, note_finished, write_export
from olt_datasets.verification.file_list import write_file_list
from olt_datasets.verification.lerobot import verify_lerobot
from olt_generator import InputError, write_video
from olt_generator.files import write_whole
from olt_generator.poses import Array, invert, yaw_of
from olt_generator.progress import Progress, silent
from olt_toolkit import ClipInfo, ClipStore, EgoMotion
from olt_toolkit.clips.images import resize_images, resize_masks
from olt_toolkit.clips.origin_files import encode_origin
from olt_toolkit.policy.contract import STEP_US
from olt_toolkit.policy.window import FUTURE_OFFSETS_US, HISTORY_OFFSETS_US, IMAGE_OFFSETS_US
from olt_toolkit.rigs.contracts import CameraContract
from olt_toolkit.runtime.workers import Engine, map_parallel

VERSION = "v3.0"
CLIPS_PER_TABLE = 1000
QUANTILES = {f"q{percent:02d}": percent / 100 for percent in (1, 10, 50, 90, 99)}
FRAME_RATE = 10
FILES_PER_CHUNK = 1000
POSE_FIELDS = ("x", "y", "z", "yaw")

Columns = dict[str, NDArray[Any]]
Levels = NDArray[np.int64]
"""How often each of the 256 levels occurs in each colour: (3, 256)."""


@dataclass(frozen=True)
class ClipFrames:
    """The frames of one clip.

    Attributes:
        number: number of the clip among all clips of the export; its videos are called by it.
        times_us: (n,) clip times, in runs at the distance of the grid.
        is_sample: (n,) whether the frame is one of the sample times, and not one that stands before them.
        state: (n, 64) float32: x, y, z in metres and yaw of the 16 past poses.
        action: (n, 256) float32: the same of the 64 future poses.
        levels: levels of the images by camera.
    """

    item: ExportItem
    number: int
    times_us: NDArray[np.int64]
    is_sample: NDArray[np.bool_]
    state: NDArray[np.float32]
    action: NDArray[np.float32]
    levels: dict[str, Levels]

    @property
    def runs(self) -> list[tuple[int, int]]:
        """Ranges (first, end) of frames that follow each other on the grid: the episodes."""
        breaks = np.flatnonzero(np.diff(self.times_us) != STEP_US) + 1
        edges = [0, *breaks.tolist(), len(self.times_us)]
        return list(pairwise(edges))


def video_key(camera: str) -> str:
    """Name of a camera's feature."""
    return f"observation.images.{camera}"


def numbered_file(folder: Path, number: int, suffix: str) -> Path:
    """Where a file of LeRobot's numbered chunks lies; the video of a clip has the clip's number."""
    chunk, file = divmod(number, FILES_PER_CHUNK)
    return folder / f"chunk-{chunk:03d}" / f"file-{file:03d}.{suffix}"


def write_clip(
    root: Path,
    sizes: Sizes,
    keep_going: bool,
    contract: CameraContract,
    job: tuple[int, ExportItem],
) -> ClipFrames | str:
    """Write the videos of one clip, unless an earlier run has, and work out its frames.

    What is wrong with it is returned, or an InputError where `keep_going` is off or a file cannot be written.
    """
    number, item = job
    videos = {camera: numbered_file(root / "videos" / video_key(camera), number, "mp4") for camera in contract.cameras}
    try:
        store = ClipStore(item.store)
        store.check(item.clip_id, item.t0s_us)
        motion = store.read_ego_motion(item.clip_id)
        times_us = frame_times(item.t0s_us, motion.span_us[0])
        return ClipFrames(
            item,
            number,
            times_us,
            is_sample=np.isin(times_us, item.t0s_us),
            state=_pose_fields(motion, times_us, HISTORY_OFFSETS_US),
            action=_pose_fields(motion, times_us, FUTURE_OFFSETS_US),
            levels=_write_videos(root, videos, store, item.clip_id, number, times_us, sizes),
        )
    except InputError as error:
        for video in videos.values():
            video.unlink(missing_ok=True)
        for camera in contract.cameras:
            _mask_file(root, camera, number).unlink(missing_ok=True)
        if not keep_going:
            raise
        return str(error)


def _mask_file(root: Path, camera: str, number: int) -> Path:
    return numbered_file(root / "masks" / video_key(camera), number, "parquet")


def frame_times(t0s_us: Sequence[int], ego_start_us: int) -> NDArray[np.int64]:
    """Clip times of the frames (n,): the sample times and the images that they look back to.

    Times at which no state can be told are left out. Times on grids of different phase follow each other.
    """
    times = np.unique(np.array(t0s_us, np.int64)[:, None] + IMAGE_OFFSETS_US)
    times = times[times + HISTORY_OFFSETS_US[0] >= ego_start_us]
    return times[np.lexsort((times, times % STEP_US))]


def _pose_fields(motion: EgoMotion, times_us: NDArray[np.int64], offsets_us: NDArray[np.int64]) -> NDArray[np.float32]:
    """Position and yaw (n, 4 m) of the poses at m offsets from each time, in the rig frame at that time."""
    here = motion.interpolate(times_us)
    there = motion.interpolate((times_us[:, None] + offsets_us).ravel()).reshape(len(times_us), -1, 4, 4)
    relative: Array = invert(here)[:, None] @ there
    fields = np.concatenate([relative[..., :3, 3], yaw_of(relative)[..., None]], axis=-1)
    return fields.reshape(len(times_us), -1).astype(np.float32)


def _write_videos(
    root: Path,
    videos: Mapping[str, Path],
    store: ClipStore,
    clip_id: str,
    number: int,
    times_us: NDArray[np.int64],
    sizes: Sizes,
) -> dict[str, Levels]:
    name = f"clip_{number:06d}"
    finished = finished_part(root, name)
    if finished is not None:
        return {camera: np.array(levels, np.int64) for camera, levels in finished.items()}
    order = np.argsort(times_us)
    levels = {}
    for camera, path in videos.items():
        height, width = sizes[camera]
        frames, _ = store.read_frames(clip_id, camera, times_us[order])
        frames = resize_images(frames, width, height)[np.argsort(order)]
        write_video(path, frames, FRAME_RATE)
        if not store.info(clip_id).views[camera].is_seen_whole:
            masks = resize_masks(store.read_origin(clip_id, camera, times_us[order]), width, height)
            with write_whole(_mask_file(root, camera, number)) as temporary:
                temporary.write_bytes(encode_origin(times_us, masks[np.argsort(order)]))
        levels[camera] = np.stack([np.bincount(frames[..., colour].ravel(), minlength=256) for colour in range(3)])
    note_finished(root, name, {camera: counts.tolist() for camera, counts in levels.items()})
    return levels


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

    @property
    def table(self) -> int:
        """Number of the file that holds its rows."""
        return self.clip.number // CLIPS_PER_TABLE


def export_lerobot(
    contents: Contents,
    out: Path,
    keep_going: bool = False,
    workers: int = 1,
    engine: Engine = Engine.LOCAL,
    on_progress: Progress = silent,
    image_size: tuple[int, int] | None = None,
    verify: bool = True,
) -> dict[str, Any]:
    """Write the clips to `out`, as `export_pai` does but for the layout.

    Images have the height and width `image_size`, or without it their own.

    Raises:
        InputError: images of one camera differ in size and none is asked for; `out` holds something else, a clip is
            damaged and `keep_going` is off, no clip is left, a file cannot be written, or a check
            fails; names the file.
    """
    on_written, on_verified = halves(on_progress, verify)
    failing: dict[str, str] = {}
    if verify and keep_going:
        contents, failing = leave_out_failing(contents, out, workers, silent, engine)
    contents = contents.with_one_item_per_clip()
    true_sizes = read_image_sizes(contents)
    sizes = dict.fromkeys(contents.contract.cameras, image_size) if image_size else only_sizes(true_sizes)
    resized = tell_resized(true_sizes, sizes)

    def write(root: Path) -> dict[str, Any]:
        write_one = partial(write_clip, root, sizes, keep_going, contents.contract)
        clips = map_parallel(write_one, list(enumerate(contents.items)), workers, on_written, engine)
        components = [group.component for group in contents.groups for _ in group.items]
        stores = {item.store: ClipStore(item.store) for item in contents.items}
        done = [clip for clip in clips if isinstance(clip, ClipFrames)]
        if not done:
            raise InputError(f"{out}: no clip could be exported: {clips[0]}")
        episodes = [
            _Episode(clip, stores[clip.item.store].info(clip.item.clip_id), components[clip.number], first, end)
            for clip in done
            for first, end in clip.runs
        ]
        tasks = sorted({episode.info.category for episode in episodes})
        columns = _write_data(root, episodes, tasks)
        _write_meta(root, contents, episodes, tasks, columns, _features(sizes, resized))
        pairs = zip(contents.items, clips, strict=True)
        failures = failing | {item.clip_id: reason for item, reason in pairs if isinstance(reason, str)}
        told = {"image_sizes": {camera: word_size(size) for camera, size in sizes.items()}, "resized_from": resized}
        write_file_list(root)
        verified = look_at_export(verify_lerobot, root, out, workers, on_verified, engine) if verify else None
        told |= {"failures": failures, "verification": verified}
        return _summarize(contents, done, episodes) | told

    return write_export("lerobot", contents, [sizes, verify], out, write)


def _write_data(root: Path, episodes: Sequence[_Episode], tasks: Sequence[str]) -> Columns:
    """Write the tables of frames; returns their columns, all frames together."""
    lengths = np.array([len(episode) for episode in episodes])
    columns: Columns = {
        name: np.concatenate([getattr(each.clip, field)[each.first : each.end] for each in episodes])
        for name, field in (("observation.state", "state"), ("action", "action"), ("is_sample", "is_sample"))
    }
    columns |= {
        "frame_index": np.concatenate([np.arange(length) for length in lengths]),
        "episode_index": np.repeat(np.arange(len(episodes)), lengths),
        "index": np.arange(lengths.sum()),
        "task_index": np.repeat([tasks.index(episode.info.category) for episode in episodes], lengths),
    }
    columns["timestamp"] = (columns["frame_index"] / FRAME_RATE).astype(np.float32)
    table = pa.table(
        {
            name: pa.array(values)
            if values.ndim == 1
            else pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])
            for name, values in columns.items()
        }
    )
    place = np.repeat([episode.table for episode in episodes], lengths)
    for number in np.unique(place).tolist():
        with write_whole(numbered_file(root / "data", number, "parquet")) as temporary:
            pq.write_table(table.filter(pa.array(place == number)), temporary)
    return columns


def _write_meta(
    root: Path,
    contents: Contents,
    episodes: Sequence[_Episode],
    tasks: Sequence[str],
    columns: Columns,
    features: dict[str, dict[str, Any]],
) -> None:
    meta = root / "meta"
    with write_whole(meta / "tasks.parquet") as temporary:
        pd.DataFrame({"task_index": range(len(tasks))}, index=pd.Index(tasks)).to_parquet(temporary)
    with write_whole(numbered_file(meta / "episodes", 0, "parquet")) as temporary:
        pq.write_table(pa.Table.from_pylist(_episode_rows(episodes, contents.contract)), temporary)
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
        "features": features,
    }
    stats = {}
    for name, values in columns.items():
        if values.dtype != np.bool_:
            rows = values.reshape(len(values), -1)
            rows = rows.astype(np.float64) if rows.dtype == np.float32 else rows
            stats[name] = {each: getattr(np, each)(rows, axis=0).tolist() for each in ("min", "max", "mean", "std")}
            quantiles = np.quantile(rows, list(QUANTILES.values()), axis=0).tolist()
            stats[name] |= {"count": [len(rows)]} | dict(zip(QUANTILES, quantiles, strict=True))
    stats |= {video_key(camera): _image_stats(episodes, camera) for camera in contents.contract.cameras}
    for name, content in {"info": info, "stats": stats}.items():
        with write_whole(meta / f"{name}.json") as temporary:
            temporary.write_text(json.dumps(content, indent=4) + "\n", encoding="utf-8")


def _features(sizes: Sizes, resized: dict[str, dict[str, int]]) -> dict[str, dict[str, Any]]:
    scalars = dict.fromkeys(("frame_index", "episode_index", "index", "task_index"), "int64")
    scalars |= {"timestamp": "float32", "is_sample": "bool"}
    return {
        **{video_key(camera): _video_feature(size, resized.get(camera)) for camera, size in sizes.items()},
        "observation.state": _pose_feature(HISTORY_OFFSETS_US),
        "action": _pose_feature(FUTURE_OFFSETS_US),
        **{name: {"dtype": dtype, "shape": [1], "names": None} for name, dtype in scalars.items()},
    }


def _video_feature(size: tuple[int, int], resized_from: dict[str, int] | None) -> dict[str, Any]:
    height, width = size
    return {
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
            **({"video.resized_from": resized_from} if resized_from else {}),
        },
    }


def _pose_feature(offsets_us: NDArray[np.int64]) -> dict[str, Any]:
    names = [f"{field}({offset / 1e6:+.1f} s)" for offset in offsets_us.tolist() for field in POSE_FIELDS]
    return {"dtype": "float32", "shape": [len(names)], "names": names}


def _episode_rows(episodes: Sequence[_Episode], contract: CameraContract) -> list[dict[str, Any]]:
    def place(name: str, number: int) -> dict[str, int]:
        chunk, file = divmod(number, FILES_PER_CHUNK)
        return {f"{name}/chunk_index": chunk, f"{name}/file_index": file}

    rows = []
    begin = 0
    for number, episode in enumerate(episodes):
        row = {
            "episode_index": number,
            "tasks": [episode.info.category],
            "length": len(episode),
            "dataset_from_index": begin,
            "dataset_to_index": begin + len(episode),
            **place("data", episode.table),
            **place("meta/episodes", 0),
            "clip_id": episode.clip.item.clip_id,
            "component": episode.component,
            "kind": episode.info.kind,
            "source": episode.info.source,
            "start_us": int(episode.clip.times_us[episode.first]),
        }
        for camera in contract.cameras:
            video = f"videos/{video_key(camera)}"
            row |= place(video, episode.clip.number)
            row[f"{video}/from_timestamp"] = episode.first / FRAME_RATE
            row[f"{video}/to_timestamp"] = episode.end / FRAME_RATE
        rows.append(row)
        begin += len(episode)
    return rows


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
            for name, quantile in QUANTILES.items()
        },
    }
    frames = sum(len(clip.times_us) for clip in clips.values())
    return {name: values.reshape(3, 1, 1).tolist() for name, values in stats.items()} | {"count": [frames]}


def _summarize(contents: Contents, clips: Sequence[ClipFrames], episodes: Sequence[_Episode]) -> dict[str, Any]:
    short = 0
    for clip in clips:
        present = set(clip.times_us.tolist())
        samples = clip.times_us[clip.is_sample].tolist()
        short += sum(any(time - step * STEP_US not in present for step in (1, 2, 3)) for time in samples)
    # LeRobot repeats the first frame of an episode there, and says so.
    note = f"{short} samples have fewer than three frames before them, as the ego motion begins too late for a state"
    licences = {each.clip.number: each.info.origin.licence for each in episodes}
    return {
        "clips": len(clips),
        "episodes": dict(Counter(episode.component for episode in episodes)),
        "frames": sum(len(clip.times_us) for clip in clips),
        "samples": sum(int(clip.is_sample.sum()) for clip in clips),
        "licences": dict(Counter(licence or "not told" for licence in licences.values())),
        "notes": [*contents.notes, *([note] if short else [])],
    }
