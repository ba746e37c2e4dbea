"""PAV, NVIDIA's PhysicalAI-Autonomous-Vehicles: the cameras of the target rig itself, with measured ego motion.

Layout: docs/formats/physicalai_av.md; clips lie in chunks, one zip a feature and chunk. A tree may hold any of the
chunks: its clips are those whose front images are on disk, and each has the cameras whose zips are there. Clips that
the index marks as not valid are left out. Frames are found through their table of timestamps, which has a row a frame.
"""

from functools import cache, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from olt_datasets.sources import pav_tables
from olt_datasets.sources.times import FARTHEST_US, farthest_apart, images_within, nearest_images, starting_at
from olt_generator.errors import InputError
from olt_generator.video import shrink
from olt_toolkit import DatasetReader, Drive, Licence, OpenOptions, Recording
from olt_toolkit.clips.chunk_archive import ChunkArchive
from olt_toolkit.clips.pai_layout import (
    CAMERA_INTRINSICS,
    CLIP_INDEX,
    EGOMOTION,
    FEATURE_TABLE,
    FEATURES,
    FRAME_TIMESTAMPS,
    SENSOR_EXTRINSICS,
    VEHICLE_DIMENSIONS,
    VIDEO,
)
from olt_toolkit.clips.pai_tables import read_egomotion, read_mounted_camera, read_timestamps, read_vehicle
from olt_toolkit.clips.table import CLIP_TABLE
from olt_toolkit.clips.video import decode_frames, find_key_frames
from olt_toolkit.policy.window import Span
from olt_toolkit.rigs.rig import CAMERA_INDEX, FRONT_WIDE, MountedCamera, short_name

SOURCE = "pav"
LICENCE = Licence(
    name="NVIDIA Autonomous Vehicle Dataset licence",
    access="Gated: each user accepts the licence on the data set's hub page.",
    terms="Internal development of driving functions with NVIDIA technology; the data and what is derived from it, "
    "synthesized views included, may not be passed on.",
)
# Frames decoded at once before they are scaled down.
_BLOCK = 60
# Directories of zips that are kept; a chunk has one zip a camera and one of ego motion.
_KEPT_ARCHIVES = 32

Images = NDArray[np.uint8]


class Pav:
    """The clips in a PhysicalAI-AV tree."""

    source = SOURCE
    licence = LICENCE

    def __init__(self, root: Path, _: Path) -> None:
        if not (root / CLIP_INDEX).is_file():
            raise InputError(f"{root / CLIP_INDEX}: no such file; give the root of a PhysicalAI-AV tree")
        if (root / CLIP_TABLE).exists():
            raise InputError(
                f"{root}: a clip store of this toolkit ({CLIP_TABLE}), whose images need not be true; use it as it is"
            )
        self.root = root
        self._archive = lru_cache(maxsize=_KEPT_ARCHIVES)(ChunkArchive)
        self._clips = pav_tables.read_clip_index(root)
        self._absent = pav_tables.read_absence(root)
        # Read where a clip is described: opening needs neither.
        self._countries = cache(lambda: pav_tables.read_countries(root))
        self._events = cache(lambda: pav_tables.read_events(root))

    def keys(self) -> list[str]:
        """See `Dataset.keys`: the ids of valid clips whose front images are on disk."""
        chunks = {clip.chunk for clip in self._clips.values()}
        here = {chunk for chunk in chunks if FEATURES[FRONT_WIDE].chunk_file(self.root, chunk).is_file()}
        return sorted(
            key for key, clip in self._clips.items() if clip.chunk in here and not self._is_absent(key, FRONT_WIDE)
        )

    def drive(self, key: str) -> Drive:
        """See `Dataset.drive`."""
        clip, events = self._clip(key), self._events().get(key, pav_tables.ClipEvents())
        clip_us = self._timestamps(key, FRONT_WIDE)
        start_us, end_us = int(clip_us[0]), int(clip_us[-1])
        cameras = tuple(name for name in CAMERA_INDEX if self._has(key, name, VIDEO))
        event_times = sorted({*clip.event_t0s_us, *events.times_us})
        elsewhere = [name for name in CAMERA_INDEX if name not in cameras and not self._is_absent(key, name)]
        notes = [f"Images of {short_name(name)} are not in this folder." for name in elsewhere]
        ego_span_us = None
        if self._has(key, EGOMOTION, EGOMOTION):
            ego_us = read_timestamps(*self._member(key, EGOMOTION, EGOMOTION)) - start_us
            ego_span_us = int(ego_us[0]), int(ego_us[-1])
        else:
            notes.append("Measured ego motion is not in this folder.")
        return Drive(
            source=SOURCE,
            scene_id=f"{SOURCE}/{key}",
            key=key,
            front_us=clip_us - start_us,
            cameras=cameras,
            ego_span_us=ego_span_us,
            true_views=self._cameras_beside(key, tuple(CAMERA_INDEX), clip_us),
            category=events.category,
            country=self._countries().get(key),
            split=clip.split,
            event_t0s_us=tuple(time - start_us for time in event_times if start_us <= time <= end_us),
            notes=tuple(notes),
        )

    def peek(
        self, key: str, times_us: NDArray[np.int64], width: int, reach_us: NDArray[np.int64]
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        """See `Dataset.peek`; key frames are decoded without others."""
        clip_us = self._timestamps(key, FRONT_WIDE)
        front_us = clip_us - clip_us[0]
        path, name = self._chunk_file(key, FRONT_WIDE), FEATURES[FRONT_WIDE].member(VIDEO, key)
        video = self._archive(path).locate(name) or self._archive(path).read(name)
        numbers = nearest_images(front_us, times_us)
        keys = find_key_frames(video, len(front_us))
        if len(keys):
            near = keys[nearest_images(front_us[keys], times_us)]
            numbers = np.where(np.abs(front_us[near] - times_us) <= reach_us, near, numbers)
        distinct, places = np.unique(numbers, return_inverse=True)
        images = decode_frames(video, distinct, f"{path}: {name}")
        return np.stack([shrink(image, width) for image in images])[places], front_us[numbers]

    def open(self, key: str, window_us: Span, options: OpenOptions) -> Recording:
        """See `Dataset.open`."""
        options.refuse_camera(f"{self.root}: clip {key}")
        clip_us = self._timestamps(key, FRONT_WIDE)
        times_us = clip_us[images_within(clip_us - clip_us[0], window_us, f"{self.root}: clip {key}")]
        beside = [name for name in self._cameras_beside(key, options.views, times_us) if name != FRONT_WIDE]
        frames, front = self._images(key, FRONT_WIDE, times_us, options.width)
        views = {name: self._images(key, name, times_us, options.width) for name in beside}
        apart_ms = {name: farthest_apart(self._timestamps(key, name), times_us) / 1000 for name in beside}
        reference = None
        if self._has(key, EGOMOTION, EGOMOTION):
            measured = read_egomotion(*self._member(key, EGOMOTION, EGOMOTION)).trajectory
            reference = starting_at(measured, int(times_us[0]))
        return Recording(
            name=key,
            source=SOURCE,
            frames=frames,
            timestamps_us=times_us - times_us[0],
            camera=front.camera,
            T_rig_camera=front.T_rig_camera,
            vehicle=read_vehicle(self._chunk_file(key, VEHICLE_DIMENSIONS), key),
            assumptions=tuple(
                f"Images of {short_name(name)} are those nearest in time to the front ones, up to {apart:.1f} ms away."
                for name, apart in apart_ms.items()
            ),
            reference=reference,
            views={name: images for name, (images, _) in views.items()},
            mounted={name: mounted for name, (_, mounted) in views.items()},
        )

    def _timestamps(self, key: str, camera: str) -> NDArray[np.int64]:
        return read_timestamps(*self._member(key, camera, FRAME_TIMESTAMPS))

    def _cameras_beside(self, key: str, names: tuple[str, ...], times_us: NDArray[np.int64]) -> tuple[str, ...]:
        """Those of the cameras that have an image near each of the clip times."""
        return tuple(
            name
            for name in names
            if self._has(key, name, VIDEO) and farthest_apart(self._timestamps(key, name), times_us) <= FARTHEST_US
        )

    def _images(self, key: str, camera: str, times_us: NDArray[np.int64], width: int) -> tuple[Images, MountedCamera]:
        """Images (n, H, W, 3) nearest to clip times (n,), at most `width` pixels wide, and their camera."""
        intrinsics, extrinsics = (self._chunk_file(key, name) for name in (CAMERA_INTRINSICS, SENSOR_EXTRINSICS))
        try:
            mounted = read_mounted_camera(intrinsics, extrinsics, key, camera)
        except InputError as error:
            raise InputError(f"{self.root}: clip {key}: {camera}: {error}") from error
        video, where = self._member(key, camera, VIDEO)
        indices = nearest_images(self._timestamps(key, camera), times_us)
        images: list[Images] = []
        for start in range(0, len(indices), _BLOCK):
            frames = decode_frames(video, indices[start : start + _BLOCK], where)
            if frames.shape[1:3] != (mounted.camera.height, mounted.camera.width):
                raise InputError(
                    f"{where}: frames of {frames.shape[2]} x {frames.shape[1]} pixels; {CAMERA_INTRINSICS} gives the "
                    f"camera {mounted.camera.width} x {mounted.camera.height}"
                )
            images += [shrink(frame, width) for frame in frames]
        small = np.stack(images)
        return small, MountedCamera(mounted.camera.resized(small.shape[2], small.shape[1]), mounted.T_rig_camera)

    def _clip(self, key: str) -> pav_tables.IndexedClip:
        if key not in self._clips:
            raise InputError(f"{self.root / CLIP_INDEX}: no valid clip {key!r}")
        return self._clips[key]

    def _chunk_file(self, key: str, feature: str) -> Path:
        return FEATURES[feature].chunk_file(self.root, self._clip(key).chunk)

    def _is_absent(self, key: str, feature: str) -> bool:
        """Whether the data set itself lacks a clip's feature."""
        return key in self._absent.get(feature, ())

    def _has(self, key: str, feature: str, alias: str) -> bool:
        path, name = self._chunk_file(key, feature), FEATURES[feature].member(alias, key)
        return not self._is_absent(key, feature) and path.is_file() and name in self._archive(path)

    def _member(self, key: str, feature: str, alias: str) -> tuple[bytes, str]:
        """One member of a chunk's zip, and what to call it in errors."""
        path, name = self._chunk_file(key, feature), FEATURES[feature].member(alias, key)
        return self._archive(path).read(name), f"{path}: {name}"


DATASET = DatasetReader(
    SOURCE,
    LICENCE,
    # Clip stores of this toolkit have the same layout and are none.
    lambda path: (
        all((path / each).is_file() for each in (CLIP_INDEX, FEATURE_TABLE)) and not (path / CLIP_TABLE).exists()
    ),
    Pav,
)
