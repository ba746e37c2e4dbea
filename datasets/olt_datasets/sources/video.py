"""Plain front videos, with nothing known about the camera: a file, or a folder in which every video is a drive.

What no video tells is assumed and said. Windows of one video share one lens: the field of view is looked for once, in
the beginning of the video, and kept in the cache.
"""

import hashlib
import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from olt_generator import Camera, FthetaCamera, InputError, PinholeCamera, estimate_field_of_view
from olt_generator.files import write_whole
from olt_generator.video import Video, read_frame_times, read_video, read_video_window
from olt_toolkit import OpenOptions, Recording, load_rig
from olt_toolkit.policy.window import Span
from olt_toolkit.recordings.drives import WHOLE, DatasetReader, Drive, Licence
from olt_toolkit.rigs.rig import FRONT_WIDE

NAME = "video"
LICENCE = Licence(
    "not told",
    "Files of the user's own; nobody told where they come from.",
    "Not told: ask whoever owns the videos before training on them or passing them on.",
)
SUFFIXES = frozenset({".mp4", ".mov", ".m4v", ".mkv", ".avi", ".webm", ".ts", ".mpg", ".mpeg"})
# The rig in which an unknown camera is taken to be, and its only camera.
RIG, CAMERA = "dashcam", "front"
UNKNOWN_CAMERA = (
    "Lens, mounting and vehicle are not known; they are assumed when the drive is opened, and said there.",
    "There is no measured motion; it is recovered from the images.",
)
# Wider lenses are built to keep angles rather than straight lines.
WIDEST_PINHOLE = np.radians(100.0)
FIELD_OF_VIEW_RANGE = (np.radians(10.0), np.radians(200.0))
# The field of view is looked for in so many seconds from the start where windows of any duration are opened.
LENS_SECONDS = 20.0


class Videos:
    """A video file, or the videos in a folder and below; see `Dataset`."""

    source = NAME
    licence = LICENCE

    def __init__(self, path: Path, cache: Path) -> None:
        self._path, self._cache = path, cache / NAME
        found = [path] if path.is_file() else [each for each in path.rglob("*") if is_video(each)]
        self._videos = {each.relative_to(path).as_posix(): each for each in found}

    def keys(self) -> list[str]:
        """See `Dataset.keys`: paths of the video files in the folder."""
        return sorted(self._videos)

    def drive(self, key: str) -> Drive:
        """See `Dataset.drive`; reads the times of the frames and decodes none."""
        video = self._video(key)
        folder = (video.parent if key == WHOLE else self._path).resolve()
        return Drive(
            source=NAME,
            scene_id=f"{NAME}/{folder.name}/{video.name if key == WHOLE else key}",
            key=key,
            front_us=read_frame_times(video),
            cameras=(CAMERA,),
            ego_span_us=None,
            true_views=(FRONT_WIDE,),
            notes=UNKNOWN_CAMERA,
        )

    def open(self, key: str, window_us: Span, options: OpenOptions) -> Recording:
        """See `Dataset.open`."""
        video = self._video(key)
        return open_video_window(video, video.stem, NAME, window_us, options, self._cache)

    def _video(self, key: str) -> Path:
        if key not in self._videos:
            raise InputError(f"{self._path}: there is no video {key!r}")
        return self._videos[key]


def is_video(path: Path) -> bool:
    """Whether a path is a video file, judged by its suffix."""
    return path.suffix.lower() in SUFFIXES and path.is_file()


def open_video_window(
    path: Path, name: str, source: str, window_us: Span, options: OpenOptions, cache: Path
) -> Recording:
    """Decode a window of a front video of which nothing is known, in the rig in which unknown cameras are taken to be.

    The options tell in how much from the start the field of view is looked for. It is kept in the cache for as long as
    the file stays the same. InputError: the video is damaged, has no frame in the window, or one in all that is opened.
    """
    first_us, last_us = window_us
    beginning_us = round(1e6 * (options.duration if math.isfinite(options.duration) else LENS_SECONDS))
    if first_us > 0:
        video = read_video_window(path, first_us, last_us, options.width)
    else:
        video = read_video(path, options.width, (last_us + 1) / 1e6)
        if len(video.frames) < 2 and last_us >= beginning_us - 1:
            raise InputError(f"{path}: holds a single frame; give a video of at least 2 frames")
    is_beginning = window_us == (0, beginning_us - 1)
    lens = (
        _find_lens(path, video if is_beginning else None, beginning_us, options.width, cache)
        if options.horizontal_fov is None
        else describe_lens(options.horizontal_fov, "as given")
    )
    height, width = video.frames.shape[1:3]
    rig = load_rig(RIG)
    T_rig_camera = rig[CAMERA].T_rig_camera
    if options.camera_height is not None:
        T_rig_camera[2, 3] = options.camera_height
    (forward, _, up), told = T_rig_camera[:3, 3], "the default" if options.camera_height is None else "as given"
    return Recording(
        name=name,
        source=source,
        frames=video.frames,
        timestamps_us=video.timestamps_us - video.timestamps_us[0],
        camera=assume_camera(width, height, lens.field_of_view),
        T_rig_camera=T_rig_camera,
        vehicle=rig.vehicle,
        assumptions=(
            lens.sentence,
            f"The camera is {up:.2f} m above ground ({told}), which fixes the metric scale.",
            f"The camera is {forward:.1f} m ahead of the rear axle, in the middle of the vehicle and not rolled.",
            "The vehicle has the size of the default passenger car.",
        ),
    )


def _find_lens(path: Path, beginning: Video | None, beginning_us: int, width: int, cache: Path) -> "AssumedLens":
    """The lens that the beginning of a video tells, kept for as long as the file stays the same."""
    state = path.stat()
    words = f"{path.name}\x1f{state.st_size}\x1f{state.st_mtime_ns}\x1f{beginning_us}\x1f{width}"
    kept = cache / f"lens-{hashlib.blake2b(words.encode(), digest_size=16).hexdigest()}.json"
    if kept.is_file():
        return AssumedLens(**json.loads(kept.read_text()))
    beginning = beginning or read_video(path, width, beginning_us / 1e6)
    lens = find_field_of_view(beginning.frames, beginning.timestamps_us)
    with write_whole(kept) as temporary:
        temporary.write_text(json.dumps(asdict(lens)))
    return lens


@dataclass(frozen=True)
class AssumedLens:
    """A horizontal field of view in radians, and the sentence that says where it comes from."""

    field_of_view: float
    sentence: str


def find_field_of_view(frames: NDArray[np.uint8], timestamps_us: NDArray[np.int64]) -> AssumedLens:
    """The field of view as estimated from frames (n, H, W, 3) and their times (n,), else as assumed for dashcams."""
    estimate = estimate_field_of_view(frames, timestamps_us, assume_camera)
    if estimate.field_of_view is not None and estimate.interval is not None:
        low, high = np.degrees(estimate.interval)
        return describe_lens(
            estimate.field_of_view, f"estimated from the turns in the video, likely between {low:.0f} and {high:.0f}"
        )
    dashcam = load_rig(RIG)[CAMERA].camera
    edges = dashcam.rays(np.array([[-0.5, dashcam.cy], [dashcam.width - 0.5, dashcam.cy]]))
    usual = float(np.arccos(edges[0] @ edges[1]))
    return describe_lens(usual, f"the default for dashcams; the video does not tell: {estimate.reason}")


def assume_camera(width: int, height: int, field_of_view: float) -> Camera:
    """A centred camera, pinhole or f-theta, that sees so many radians across; InputError beyond 10 to 200 degrees."""
    low, high = FIELD_OF_VIEW_RANGE
    if not low <= field_of_view <= high:
        raise InputError(
            f"field of view {np.degrees(field_of_view):.1f} degrees: give one between {np.degrees(low):.0f} and "
            f"{np.degrees(high):.0f} degrees"
        )
    if field_of_view <= WIDEST_PINHOLE:
        return PinholeCamera.from_field_of_view(width, height, field_of_view)
    return FthetaCamera.equidistant(width, height, 0.5 * (width - 1), 0.5 * (height - 1), width / field_of_view)


def describe_lens(field_of_view: float, origin: str) -> AssumedLens:
    """The lens that is assumed for a horizontal field of view in radians, which comes from `origin`."""
    lens = "without distortion" if field_of_view <= WIDEST_PINHOLE else "with an equidistant fisheye lens"
    return AssumedLens(
        field_of_view,
        f"The camera has a horizontal field of view of {np.degrees(field_of_view):.0f} degrees ({origin}), {lens}, and "
        "its axis is in the middle of the image.",
    )


DATASET = DatasetReader(
    NAME, LICENCE, lambda path: is_video(path) or (path.is_dir() and any(map(is_video, path.iterdir()))), Videos
)
