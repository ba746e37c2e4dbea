"""A folder of clips in PhysicalAI-AV layout, with one more table that says what each clip is.

Clips are prepared one by one, by as many processes as one likes, and committed together into the next chunk. A commit
writes chunks first and the clip table last: interrupted at any point it leaves the old store readable, and the next
commit overwrites what it left. The public readers have no filter by split (docs/formats/physicalai_av.md), so
clips of held-out scenes belong in a store of their own.
"""

import fcntl
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from olt_generator.errors import InputError
from olt_generator.files import make_folder, naming, write_whole_folder
from olt_generator.poses import Array
from olt_generator.views.pixel_origin import PixelOrigin
from olt_toolkit.clips import pai_layout as layout
from olt_toolkit.clips import pai_tables as tables
from olt_toolkit.clips.chunk_archive import ByteRange, ChunkArchive
from olt_toolkit.clips.clip import Clip, ClipInfo, EgoMotion, check_clip_id
from olt_toolkit.clips.files import has_feature, pack_chunk, write_clip_files, write_metadata
from olt_toolkit.clips.images import resize_masks
from olt_toolkit.clips.origin_files import OriginRuns, decode_origin
from olt_toolkit.clips.pai_layout import (
    CALIBRATIONS,
    CLIP_INDEX,
    EGOMOTION,
    FRAME_TIMESTAMPS,
    HOLDS,
    OBSTACLES,
    PIXEL_ORIGIN,
    PIXEL_ORIGINS,
    ROAD,
    ROUTE,
    STORED,
    TRUTHS,
    VIDEO,
)
from olt_toolkit.clips.table import CLIP_TABLE, read_clip_table, write_clip_table
from olt_toolkit.clips.truth_tables import (
    read_holds,
    read_obstacles,
    read_road,
    read_route,
    sample_routes,
    sample_truth,
)
from olt_toolkit.clips.video import check_video, decode_frames, decode_images
from olt_toolkit.policy.sample import PolicySample, SampleKey
from olt_toolkit.policy.window import IMAGE_OFFSETS_US, Coverage, check_sample_window, newest_frames
from olt_toolkit.recordings.truth import Holds, ObstacleTracks
from olt_toolkit.rigs.contracts import DEFAULT_CONTRACT, CameraContract
from olt_toolkit.rigs.rig import MountedCamera, VehicleDimensions
from olt_toolkit.runtime.version import code_version

CLIPS_PER_CHUNK = 100
Known = TypeVar("Known")


class ClipStore:
    """Clips under one folder.

    Reading sees the clips that were there when this object was first asked, and those that it commits itself.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self._archives: dict[Path, ChunkArchive] = {}

    # Writing

    def prepare(self, clip: Clip) -> ClipInfo:
        """Encode a clip beside the store, ready to be committed; returns its row in the clip table.

        Different clips may be prepared at the same time.

        Raises:
            InputError: the clip contradicts itself, or the layout cannot hold it.
        """
        with write_whole_folder(self._prepared(clip.clip_id)) as folder:
            return write_clip_files(folder, clip)

    def prepared(self, clip_id: str) -> ClipInfo | None:
        """The row of a clip that waits to be committed; one that other code prepared does not count."""
        path = self._prepared(clip_id) / CLIP_TABLE
        if not path.is_file():
            return None
        # Asked before the rest is read: other code may have other columns.
        made_with = tables.read_table(path, ["created_with"], str(path))["created_with"][0].as_py()
        return read_clip_table(path)[0] if made_with == code_version() else None

    def is_prepared(self, clip_id: str) -> bool:
        """Whether the clip waits to be committed; one that other code prepared does not count."""
        return self.prepared(clip_id) is not None

    def copy_prepared(self, clip_id: str, root: Path) -> "ClipStore":
        """A store at `root` that holds nothing but a copy of a prepared clip; an `InputError` where it is not there."""
        if not self.is_prepared(clip_id):
            raise InputError(f"{self.root}: clip {clip_id} is not prepared; prepare it with this code first")
        clips = pack_chunk(root, 0, [self._prepared(clip_id)])
        write_metadata(root, clips, [0])
        write_clip_table(root / CLIP_TABLE, clips)
        return ClipStore(root)

    def discard(self, clip_id: str) -> None:
        """Forget a prepared clip."""
        shutil.rmtree(self._prepared(clip_id), ignore_errors=True)

    def commit(self, clip_ids: Iterable[str]) -> tuple[str, ...]:
        """Add prepared clips to the store; returns the ids of those that it did not hold already.

        Raises:
            InputError: a clip is neither prepared nor in the store, or another process is committing.
        """
        wanted = tuple(dict.fromkeys(clip_ids))
        with self._only_writer():
            self._forget()
            clips = list(self._clips.values()) if (self.root / CLIP_TABLE).exists() else []
            chunks = [self._chunk(info.clip_id) for info in clips]
            known = {info.clip_id for info in clips}
            new = tuple(clip_id for clip_id in wanted if clip_id not in known)
            for clip_id in new:
                if not self.is_prepared(clip_id):
                    raise InputError(
                        f"{self.root}: clip {clip_id} is not in the store; prepare it with this code first"
                    )
            for start in range(0, len(new), CLIPS_PER_CHUNK):
                folders = [self._prepared(clip_id) for clip_id in new[start : start + CLIPS_PER_CHUNK]]
                chunk = max(chunks, default=-1) + 1
                clips += pack_chunk(self.root, chunk, folders)
                chunks += [chunk] * len(folders)
            if new:
                write_metadata(self.root, clips, chunks)
                write_clip_table(self.root / CLIP_TABLE, clips)
            for clip_id in wanted:
                shutil.rmtree(self._prepared(clip_id), ignore_errors=True)
            self._forget()
        return new

    # Reading

    def clips(self) -> list[ClipInfo]:
        """All clips, in the order in which they were added.

        Raises:
            InputError: the folder is not a clip store, or its tables are damaged.
        """
        return list(self._clips.values())

    def __contains__(self, clip_id: str) -> bool:
        return (self.root / CLIP_TABLE).exists() and clip_id in self._clips

    def info(self, clip_id: str) -> ClipInfo:
        """The clip's row in the clip table.

        Raises:
            InputError: the store has no such clip.
        """
        if clip_id not in self._clips:
            raise InputError(f"{self.root}: no clip {clip_id}; `olt clip inspect` lists the {len(self._clips)} there")
        return self._clips[clip_id]

    def find(self, text: str) -> str:
        """The id of the clip that is called so, by id or by name.

        Raises:
            InputError: no clip is called so, or several are.
        """
        found = [info for clip_id, info in self._clips.items() if text in (clip_id, info.name)]
        if len(found) == 1:
            return found[0].clip_id
        told = ", ".join(f"{info.clip_id} ({info.kind} of scene {info.scene_id})" for info in found)
        problem = (
            f"{len(found)} clips are called {text!r}, give the id of one: {told}" if found else f"no clip {text!r}"
        )
        raise InputError(f"{self.root}: {problem}; `olt clip inspect` lists the clips and their ids")

    def chunks(self) -> dict[int, list[str]]:
        """The ids of all clips by the number of the chunk that holds them.

        Raises:
            InputError: the clip index is missing or damaged.
        """
        by_chunk: dict[int, list[str]] = {}
        for clip_id, chunk in self._chunks.items():
            by_chunk.setdefault(chunk, []).append(clip_id)
        return by_chunk

    def check(self, clip_id: str, t0s_us: Sequence[int]) -> None:
        """Check that a clip's tables and masks can be read, that its videos have their frames, and its samples.

        Raises:
            InputError: naming the file and what is wrong with it.
        """
        info = self.info(clip_id)
        timestamps = {camera: self.read_timestamps(clip_id, camera) for camera in info.views}
        self._check_windows(clip_id, t0s_us, self.read_ego_motion(clip_id), timestamps)
        for camera in info.views:
            video, where = self._video(clip_id, camera)
            check_video(video, len(timestamps[camera]), where)
            self.read_origin_runs(clip_id, camera)
        for feature in CALIBRATIONS:
            self.read_rows(clip_id, feature)

    def read_member(self, clip_id: str, feature: str, alias: str) -> bytes:
        """One file of a clip out of its chunk's zip, as it is; an `InputError` where it is missing or damaged."""
        return self._member(clip_id, feature, alias)[0]

    def read_rows(self, clip_id: str, feature: str) -> pd.DataFrame:
        """The rows of a clip in one of the calibration tables, with their index.

        Raises:
            InputError: the table is missing or damaged, or has no row for the clip.
        """
        path = self._chunk_file(clip_id, feature)
        table, _ = tables.to_pandas(tables.read_table(path, [], str(path)), path)
        rows = table.loc[table.index.get_level_values(0) == clip_id]
        if rows.empty:
            raise InputError(f"{path}: no row for {clip_id}")
        return rows

    def read_ego_motion(self, clip_id: str) -> EgoMotion:
        """The motion of the rig in the clip's anchor frame."""
        return tables.read_egomotion(*self._member(clip_id, EGOMOTION, EGOMOTION))

    def read_camera(self, clip_id: str, camera: str) -> MountedCamera:
        """Lens and mounting of one camera."""
        lenses = self._chunk_file(clip_id, layout.CAMERA_INTRINSICS)
        mountings = self._chunk_file(clip_id, layout.SENSOR_EXTRINSICS)
        return tables.read_mounted_camera(lenses, mountings, clip_id, camera)

    def read_vehicle(self, clip_id: str) -> VehicleDimensions:
        """Size of the vehicle."""
        return tables.read_vehicle(self._chunk_file(clip_id, layout.VEHICLE_DIMENSIONS), clip_id)

    def read_timestamps(self, clip_id: str, camera: str) -> NDArray[np.int64]:
        """Clip times (n,) of one camera's frames."""
        return tables.read_timestamps(*self._member(clip_id, camera, FRAME_TIMESTAMPS))

    def read_frames(
        self, clip_id: str, camera: str, times_us: NDArray[np.int64]
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        """The newest frame of one camera at or before each of the ascending clip times (m,).

        Returns:
            Frames (m, H, W, 3) RGB and the times (m,) of these frames.

        Raises:
            InputError: a time lies outside the first and last frame, or the files are damaged.
        """
        timestamps_us = self.read_timestamps(clip_id, camera)
        indices = self._frame_indices(clip_id, camera, timestamps_us, times_us)
        video, where = self._video(clip_id, camera)
        return decode_frames(video, indices, where), timestamps_us[indices]

    def read_images(
        self, clip_id: str, camera: str, indices: NDArray[np.int64], size: tuple[int, int] | None
    ) -> NDArray[np.uint8]:
        """Frames of one camera by number (m,) as policies take them; see `video.decode_images`."""
        video, where = self._video(clip_id, camera)
        return decode_images(video, indices, where, size)

    def read_origin(self, clip_id: str, camera: str, times_us: NDArray[np.int64]) -> NDArray[np.uint8]:
        """Where the pixels of the frames that `read_frames` gives come from: a `PixelOrigin` each, (m, H, W).

        Raises:
            InputError: a time lies outside the first and last frame, or the mask is missing or damaged.
        """
        timestamps_us = self.read_timestamps(clip_id, camera)
        indices = self._frame_indices(clip_id, camera, timestamps_us, times_us)
        runs = self.read_origin_runs(clip_id, camera)
        if runs is None:
            lens = self.read_camera(clip_id, camera).camera
            return np.full((len(indices), lens.height, lens.width), PixelOrigin.SAME_FRAME, np.uint8)
        return runs.masks(indices)

    def read_route(self, clip_id: str) -> Array | None:
        """The route (n, 2) in the anchor frame; None where it is not known."""
        return self._truth(clip_id, ROUTE, read_route)

    def read_obstacles(self, clip_id: str) -> ObstacleTracks | None:
        """Boxes of others; None where they are not known."""
        return self._truth(clip_id, OBSTACLES, read_obstacles)

    def read_holds(self, clip_id: str) -> Holds | None:
        """When the way is held; None where it is not known."""
        return self._truth(clip_id, HOLDS, read_holds)

    def read_road(self, clip_id: str) -> Array | None:
        """Points of the route in the anchor frame with the road to both sides (n, 4); None where it is not known."""
        return self._truth(clip_id, ROAD, read_road)

    def _truth(self, clip_id: str, name: str, read: Callable[[bytes, str], Known]) -> Known | None:
        if not has_feature(self.info(clip_id), TRUTHS[name]):
            return None
        return read(*self._member(clip_id, name, name))

    def read_origin_runs(self, clip_id: str, camera: str) -> OriginRuns | None:
        """The masks of one camera, held against the rest of the clip; None where a camera saw the view whole.

        Raises:
            InputError: the mask is missing or damaged, or tells other times, sizes or shares than the clip's tables.
        """
        provenance = self.info(clip_id).views[camera]
        if provenance.is_seen_whole:
            return None
        data, where = self._member(clip_id, PIXEL_ORIGINS[camera].name, PIXEL_ORIGIN)
        runs, lens = decode_origin(data, where), self.read_camera(clip_id, camera).camera
        if not np.array_equal(runs.timestamps_us, self.read_timestamps(clip_id, camera)):
            raise InputError(f"{where}: has not the times of the video's frames; build the clip again")
        if (runs.width, runs.height) != (lens.width, lens.height):
            raise InputError(
                f"{where}: masks of {runs.width} x {runs.height} pixels for a camera of {lens.width} x {lens.height}; "
                "build the clip again"
            )
        if replace(provenance, **runs.shares) != provenance:
            raise InputError(f"{where}: tells other shares of pixels than {CLIP_TABLE}; build the clip again")
        return runs

    def load_sample(
        self,
        key: SampleKey,
        image_size: tuple[int, int] | None = None,
        contract: CameraContract = DEFAULT_CONTRACT,
        with_origin: bool = False,
        with_truth: bool = False,
    ) -> PolicySample:
        """Load what the public loader gives for a clip and t0, by the same rules; see `load_samples`.

        Raises:
            InputError: the clip does not cover the sample, or its files are damaged.
        """
        return self.load_samples([key], image_size, contract, with_origin, with_truth)[0]

    def load_samples(
        self,
        keys: Sequence[SampleKey],
        image_size: tuple[int, int] | None = None,
        contract: CameraContract = DEFAULT_CONTRACT,
        with_origin: bool = False,
        with_truth: bool = False,
    ) -> list[PolicySample]:
        """Load samples in the order of `keys`; every clip is opened and decoded once, whatever their order.

        The stores of the keys are not looked at. Images are scaled to a height and width where these are given, their
        masks (`with_origin`) to the nearest pixel. `with_truth` asks for what is known of obstacles, holds and road.

        Raises:
            InputError: see `load_sample`.
        """
        times: dict[str, list[int]] = {}
        for key in keys:
            times.setdefault(key.clip_id, []).append(key.t0_us)
        loaded = {
            (sample.clip_id, sample.t0_us): sample
            for clip_id, t0s_us in times.items()
            for sample in self._load_clip_samples(
                clip_id, sorted(set(t0s_us)), image_size, contract, with_origin, with_truth
            )
        }
        return [loaded[key.clip_id, key.t0_us] for key in keys]

    def _load_clip_samples(
        self,
        clip_id: str,
        t0s_us: Sequence[int],
        image_size: tuple[int, int] | None,
        contract: CameraContract,
        with_origin: bool,
        with_truth: bool,
    ) -> list[PolicySample]:
        where = f"{self.root}: clip {clip_id}"
        present = [name for name in contract.cameras if name in self.info(clip_id).views]
        timestamps = {name: self.read_timestamps(clip_id, name) for name in present}
        motion = self.read_ego_motion(clip_id)
        self._check_windows(clip_id, t0s_us, motion, timestamps, contract)

        asked = np.array(t0s_us)[:, None] + IMAGE_OFFSETS_US
        query, places = np.unique(asked, return_inverse=True)
        indices = {name: newest_frames(timestamps[name], query) for name in contract.cameras}
        views, origins = [], []
        for name in contract.cameras:
            video, video_name = self._video(clip_id, name)
            views.append(decode_images(video, indices[name], video_name, image_size))
            if with_origin:
                height, width = views[-1].shape[-2:]
                origins.append(resize_masks(self.read_origin(clip_id, name, query), width, height))
        if len({images.shape for images in views}) > 1:
            raise InputError(f"{where}: its cameras have different image sizes; give an image size to scale them to")
        taken_us = np.stack([timestamps[name][indices[name]] for name in contract.cameras])
        history, future = (poses.astype(np.float32) for poses in motion.around(np.array(t0s_us)))
        routes = sample_routes(self.read_route(clip_id), motion, np.array(t0s_us))
        truth = None
        if with_truth:
            known = self.read_obstacles(clip_id), self.read_holds(clip_id), self.read_road(clip_id)
            truth = sample_truth(*known, motion, np.array(t0s_us))
        return [
            PolicySample(
                image_frames=_pick(views, place),
                camera_indices=np.array(contract.indices, dtype=np.int64),
                ego_history_xyz=history[None, sample, :, :3, 3],
                ego_history_rot=history[None, sample, :, :3, :3],
                ego_future_xyz=future[None, sample, :, :3, 3],
                ego_future_rot=future[None, sample, :, :3, :3],
                relative_timestamps=((taken_us[:, place] - taken_us[:, place].min()) * 1e-6).astype(np.float32),
                absolute_timestamps=taken_us[:, place],
                t0_us=t0_us,
                clip_id=clip_id,
                image_origin=_pick(origins, place) if with_origin else None,
                route_xy=routes[sample],
                **({} if truth is None else truth.of(sample)),
            )
            for sample, (t0_us, place) in enumerate(zip(t0s_us, places.reshape(asked.shape), strict=True))
        ]

    def _check_windows(
        self,
        clip_id: str,
        t0s_us: Sequence[int],
        motion: EgoMotion,
        timestamps: Mapping[str, NDArray[np.int64]],
        contract: CameraContract = DEFAULT_CONTRACT,
    ) -> None:
        spans = {camera: (int(times[0]), int(times[-1])) for camera, times in timestamps.items()}
        coverage = Coverage(motion.span_us, spans)
        for t0_us in t0s_us:
            check_sample_window(t0_us, coverage, f"{self.root}: clip {clip_id}", contract)

    def _frame_indices(
        self, clip_id: str, camera: str, timestamps_us: NDArray[np.int64], times_us: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Numbers (m,) of the newest frames at ascending times (m,), all of which the frames must cover."""
        if times_us[0] < timestamps_us[0] or times_us[-1] > timestamps_us[-1]:
            raise InputError(
                f"{self.root}: clip {clip_id}: {camera} covers {timestamps_us[0]} to {timestamps_us[-1]} us; "
                f"{times_us[0]} to {times_us[-1]} us was asked for"
            )
        return newest_frames(timestamps_us, times_us)

    # Where things are

    @cached_property
    def _clips(self) -> dict[str, ClipInfo]:
        path = self.root / CLIP_TABLE
        if not path.exists():
            raise InputError(
                f"{self.root}: not a clip store, there is no {CLIP_TABLE}; build one with `olt clip build`"
            )
        return {info.clip_id: info for info in read_clip_table(path)}

    @cached_property
    def _chunks(self) -> dict[str, int]:
        path = self.root / CLIP_INDEX
        table = tables.read_indexed(path, ["chunk"], ["clip_id"])
        if table["chunk"].dtype != np.int64:
            raise InputError(f"{path}: column chunk is {table['chunk'].dtype}; it must be int64")
        clip_ids = [check_clip_id(clip_id, str(path)) for clip_id in table.index]
        return dict(zip(clip_ids, table["chunk"].tolist(), strict=True))

    def _forget(self) -> None:
        self._archives.clear()
        for name in ("_clips", "_chunks"):
            self.__dict__.pop(name, None)

    def _chunk(self, clip_id: str) -> int:
        if clip_id not in self._chunks:
            raise InputError(f"{self.root / CLIP_INDEX}: no row for clip {self.info(clip_id).clip_id}")
        return self._chunks[clip_id]

    def _chunk_file(self, clip_id: str, feature: str) -> Path:
        return STORED[feature].chunk_file(self.root, self._chunk(clip_id))

    def _member(self, clip_id: str, feature: str, alias: str) -> tuple[bytes, str]:
        """One member of a chunk's zip, and what to call it in errors."""
        archive, name = self._archive(clip_id, feature), STORED[feature].member(alias, clip_id)
        return archive.read(name), f"{archive.path}: {name}"

    def _video(self, clip_id: str, camera: str) -> tuple[ByteRange | bytes, str]:
        """A camera's video, in place where it is not compressed in its zip, and what to call it in errors."""
        archive, name = self._archive(clip_id, camera), STORED[camera].member(VIDEO, clip_id)
        return archive.locate(name) or archive.read(name), f"{archive.path}: {name}"

    def _archive(self, clip_id: str, feature: str) -> ChunkArchive:
        path = self._chunk_file(clip_id, feature)
        if path not in self._archives:
            self._archives[path] = ChunkArchive(path)
        return self._archives[path]

    def _prepared(self, clip_id: str) -> Path:
        return self.root / ".staging" / check_clip_id(clip_id, str(self.root))

    @contextmanager
    def _only_writer(self) -> Iterator[None]:
        """Hold the store's lock; the system releases it however this process ends."""
        make_folder(self.root)
        path = self.root / ".lock"
        with naming(path):
            lock = path.open("w")
        with lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise InputError(f"{self.root}: another process is adding clips; wait until it is done") from error
            yield


def _pick(views: Sequence[NDArray[np.uint8]], places: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Images (cameras, len(places), 3, H, W), or their masks (cameras, len(places), H, W), at the same places."""
    picked = np.empty((len(views), len(places), *views[0].shape[1:]), np.uint8)
    for target, images in zip(picked, views, strict=True):
        np.take(images, places, axis=0, out=target)
    return picked
