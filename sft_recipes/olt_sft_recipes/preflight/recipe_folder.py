"""A PhysicalAI-AV folder by the rules of the recipes' own reader, which are not those of our store.

That reader finds files by `features.csv` alone, takes clips by the number of their chunk, and looks neither at
`clip_is_valid` nor at `split` (docs/formats/physicalai_av.md).
"""

from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from olt_generator.errors import InputError
from olt_toolkit.clips.chunk_archive import ByteRange, ChunkArchive
from olt_toolkit.clips.clip import EgoMotion
from olt_toolkit.clips.feature_table import FeatureRow, read_feature_table
from olt_toolkit.clips.pai_layout import CLIP_INDEX, EGOMOTION, FEATURE_TABLE, FRAME_TIMESTAMPS, VIDEO
from olt_toolkit.clips.pai_tables import read_egomotion, read_indexed, read_timestamps
from olt_toolkit.clips.video import check_video, decode_images
from olt_toolkit.policy.sample import KEYFRAME_US
from olt_toolkit.policy.window import IMAGE_OFFSETS_US, Coverage, check_sample_window, newest_frames
from olt_toolkit.rigs.contracts import CameraContract

EVENTS = "event_t0s"


class RecipeFolder:
    """One `local_dir`; an `InputError` of each method names the file and what is wrong with it."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._archives: dict[Path, ChunkArchive] = {}

    @cached_property
    def features(self) -> dict[str, FeatureRow]:
        """The rows of `features.csv` by name."""
        return read_feature_table(self.root / FEATURE_TABLE)

    @cached_property
    def index(self) -> pd.DataFrame:
        """The clip index, with `chunk` as whole numbers."""
        path = self.root / CLIP_INDEX
        index = read_indexed(path, ["chunk"], ["clip_id"])
        dtype = index["chunk"].dtype
        if not isinstance(dtype, np.dtype) or dtype.kind != "i":
            raise InputError(f"{path}: column chunk is {dtype}; file names need whole numbers, int64")
        return index

    @cached_property
    def chunks(self) -> dict[str, int]:
        """The chunk of every clip of the index."""
        return dict(zip(self.index.index.astype(str), self.index["chunk"].tolist(), strict=True))

    def select(self, chunk_ids: str | None) -> dict[str, int]:
        """The chunk of every clip that the reader takes, by clip id."""
        if chunk_ids is None:
            return self.chunks
        numbers = selected_numbers(chunk_ids)
        return {clip_id: chunk for clip_id, chunk in self.chunks.items() if chunk in numbers}

    def t0_us(self, clip_id: str, use_default_keyframe: bool) -> int:
        """The time at which the reader samples a clip."""
        if use_default_keyframe:
            return KEYFRAME_US
        path = self.root / CLIP_INDEX
        if EVENTS not in self.index:
            raise InputError(f"{path}: no column {EVENTS}; set use_default_keyframe=true or export again")
        times = self.index.at[clip_id, EVENTS]
        if not isinstance(times, list | tuple | np.ndarray) or len(times) == 0:
            raise InputError(f"{path}: clip {clip_id} has no time in {EVENTS}; export again")
        if not float(times[0]).is_integer():
            raise InputError(f"{path}: clip {clip_id} has {times[0]} in {EVENTS}; times are whole microseconds")
        return int(times[0])

    def archive(self, name: str, chunk: int) -> ChunkArchive:
        """The archive of one feature and chunk."""
        path = self.features[name].chunk_file(self.root, chunk)
        if path not in self._archives:
            self._archives[path] = ChunkArchive(path)
        return self._archives[path]

    def ego_motion(self, clip_id: str) -> EgoMotion:
        """The motion of a clip."""
        return read_egomotion(*self._member(EGOMOTION, EGOMOTION, self.chunks[clip_id], clip_id))

    def look_at_clip(self, clip_id: str, t0_us: int, contract: CameraContract) -> None:
        """Read motion, times and video tables of a clip as a sample at `t0_us` needs them; decodes nothing."""
        chunk = self.chunks[clip_id]
        motion = self.ego_motion(clip_id)
        spans = {}
        for camera in contract.cameras:
            times = read_timestamps(*self._member(camera, FRAME_TIMESTAMPS, chunk, clip_id))
            spans[camera] = (int(times[0]), int(times[-1]))
            video, where = self._video(camera, chunk, clip_id)
            check_video(video, len(times), where)
        check_sample_window(t0_us, Coverage(motion.span_us, spans), f"{self.root}: clip {clip_id}", contract)

    def decode_sample(self, clip_id: str, t0_us: int, contract: CameraContract) -> tuple[int, int]:
        """Decode the images of a sample; gives their height and width, which all cameras share."""
        chunk = self.chunks[clip_id]
        sizes = {}
        for camera in contract.cameras:
            times = read_timestamps(*self._member(camera, FRAME_TIMESTAMPS, chunk, clip_id))
            video, where = self._video(camera, chunk, clip_id)
            images = decode_images(video, newest_frames(times, t0_us + IMAGE_OFFSETS_US), where, None)
            sizes[camera] = (images.shape[2], images.shape[3])
        if len(set(sizes.values())) > 1:
            told = ", ".join(f"{camera} {height} x {width}" for camera, (height, width) in sizes.items())
            raise InputError(f"{self.root}: clip {clip_id}: images of different sizes ({told}); the reader stacks them")
        return next(iter(sizes.values()))

    def _member(self, name: str, alias: str, chunk: int, clip_id: str) -> tuple[bytes, str]:
        archive, member = self.archive(name, chunk), self.features[name].member(alias, clip_id)
        return archive.read(member), f"{archive.path}: {member}"

    def _video(self, camera: str, chunk: int, clip_id: str) -> tuple[ByteRange | bytes, str]:
        archive, member = self.archive(camera, chunk), self.features[camera].member(VIDEO, clip_id)
        return archive.locate(member) or archive.read(member), f"{archive.path}: {member}"


def selected_numbers(chunk_ids: str) -> range:
    """The chunk numbers that the recipes' reader takes of a text: `a-b` is a to b - 1, and one without "-" is none.

    Raises:
        InputError: what stands around the dash are no numbers.
    """
    if "-" not in chunk_ids:
        return range(0)
    first, last = chunk_ids.split("-")[:2]
    if not (first.strip().isdecimal() and last.strip().isdecimal()):
        raise InputError(f"chunk_ids {chunk_ids!r}: write FIRST-END, two whole numbers; END itself is left out")
    return range(int(first), int(last))
