"""Folders of plain front videos as a data set: every video file is a drive, and nothing else is known about it.

Windows of one video share one lens: the field of view is looked for once, in the beginning of the video, and kept in
the cache.
"""

import hashlib
import json
from dataclasses import asdict
from pathlib import Path

from olt_datasets.sources.video import (
    CAMERA,
    GIVEN,
    SUFFIXES,
    AssumedLens,
    describe_lens,
    find_field_of_view,
    record_front_video,
)
from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_generator.video import read_frame_times, read_video, read_video_window
from olt_toolkit.policy.window import Span
from olt_toolkit.recordings.drives import Drive, Licence
from olt_toolkit.recordings.recording import OpenOptions, Recording
from olt_toolkit.rigs.rig import FRONT_WIDE

NAME = "video"
LICENCE = Licence(
    "not told",
    "Files of the user's own; nobody told where they come from.",
    "Not told: ask whoever owns the videos before training on them or passing them on.",
)
UNKNOWN_CAMERA = (
    "Lens, mounting and vehicle are not known; they are assumed when the drive is opened, and said there.",
    "There is no measured motion; it is recovered from the images.",
)


class VideoFolder:
    """The data set at a folder; see `Dataset`."""

    source = NAME
    licence = LICENCE

    def __init__(self, root: Path, cache: Path) -> None:
        self._videos = {
            path.relative_to(root).as_posix(): path
            for path in sorted(root.rglob("*"))
            if path.suffix.lower() in SUFFIXES and path.is_file()
        }
        self._root = root
        self._cache = cache

    def keys(self) -> list[str]:
        """See `Dataset.keys`: paths of the video files in the folder."""
        return sorted(self._videos)

    def drive(self, key: str) -> Drive:
        """See `Dataset.drive`; reads the times of the frames and decodes none."""
        return Drive(
            source=NAME,
            scene_id=f"{NAME}/{self._root.resolve().name}/{key}",
            key=key,
            front_us=read_frame_times(self._video(key)),
            cameras=(CAMERA,),
            ego_span_us=None,
            true_views=(FRONT_WIDE,),
            notes=UNKNOWN_CAMERA,
        )

    def open(self, key: str, window_us: Span, options: OpenOptions) -> Recording:
        """See `Dataset.open`."""
        return open_video_window(self._video(key), Path(key).stem, NAME, window_us, options, self._cache)

    def _video(self, key: str) -> Path:
        if key not in self._videos:
            raise InputError(f"{self._root}: there is no video {key!r}")
        return self._videos[key]


class VideoFolderReader:
    """Opens a folder of videos; see `DatasetReader`."""

    name = NAME
    licence = LICENCE

    def recognises(self, root: Path) -> bool:
        """See `DatasetReader.recognises`; judged by the suffixes of the files in the folder itself."""
        return any(path.suffix.lower() in SUFFIXES for path in root.iterdir())

    def open(self, root: Path, cache: Path) -> VideoFolder:
        """See `DatasetReader.open`; videos in folders below belong to it."""
        return VideoFolder(root, cache / NAME)


def open_video_window(
    path: Path, name: str, source: str, window_us: Span, options: OpenOptions, cache: Path
) -> Recording:
    """Decode a window of a front video of which nothing is known.

    Raises:
        InputError: the video is damaged, or shows no frame in the window.
    """
    given = options.horizontal_fov
    lens = _estimate_lens(path, cache) if given is None else describe_lens(given, GIVEN)
    return record_front_video(name, source, read_video_window(path, *window_us, options.width), lens, options)


def _estimate_lens(path: Path, cache: Path) -> AssumedLens:
    """The lens that the beginning of a video tells, kept for as long as the file stays the same."""
    state = path.stat()
    words = f"{path.name}\x1f{state.st_size}\x1f{state.st_mtime_ns}"
    kept = cache / f"lens-{hashlib.blake2b(words.encode(), digest_size=16).hexdigest()}.json"
    if kept.is_file():
        return AssumedLens(**json.loads(kept.read_text()))
    video = read_video(path)
    lens = find_field_of_view(video.frames, video.timestamps_us, None)
    with write_whole(kept) as temporary:
        temporary.write_text(json.dumps(asdict(lens)))
    return lens


DATASET = VideoFolderReader()
