"""Plain front videos, with nothing known about the camera: a file, or a folder in which every video is a drive.

What no video tells is assumed and said. Windows of one video share one lens: the field of view is looked for once, in
the beginning of the video, and kept in the cache.
"""

import hashlib
import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from olt_datasets.sources.video_files import (
    find_video_files,
    has_video_suffix,
    holds_video,
    leave_out_elsewhere,
    leave_out_links,
    looks_elsewhere,
)
from olt_datasets.sources.video_lens import (
    CAMERA,
    GIVEN_SPREAD,
    RIG,
    AssumedLens,
    assume_camera,
    describe_lens,
    find_field_of_view,
    height_spread,
)
from olt_generator import InputError
from olt_generator.camera_spread import CameraSpread
from olt_generator.decoding.orientation import turned
from olt_generator.decoding.repeated_frames import find_repeated_frames
from olt_generator.decoding.sky import find_sky_side
from olt_generator.doubts import Doubt
from olt_generator.motion.odometry import MAX_STEP_SECONDS
from olt_generator.omissions import Omission
from olt_generator.video import (
    Video,
    read_frame_times,
    read_frame_times_and_digest,
    read_video,
    read_video_images,
    read_video_window,
)
from olt_toolkit import OpenOptions, Recording, load_rig
from olt_toolkit.policy.window import Span
from olt_toolkit.recordings.drives import DatasetReader, Drive, Licence
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
# The field of view is looked for in so many seconds from the start where windows of any duration are opened.
LENS_SECONDS = 20.0
# Clockwise turns that bring the sky from a side of the picture to its top.
_TURN_FROM_SIDE = {"right": 270, "bottom": 180, "left": 90}


class Videos:
    """A video file, or the videos in a folder and below; see `Dataset`."""

    source = NAME
    licence = LICENCE

    def __init__(self, path: Path, cache: Path) -> None:
        self._path, self._cache = path, cache / NAME
        self.left_out: tuple[Omission, ...] = ()
        if path.is_file():
            _check_front(path, [each for each in path.parent.iterdir() if has_video_suffix(each)])
            found = [path]
        else:
            videos, others = find_video_files(path)
            found, elsewhere = leave_out_elsewhere(videos)
            reasons = Counter({**others, **elsewhere}.values())
            total = len(videos) + len(others)
            passed_over = (Omission("files called videos", why, count, total) for why, count in sorted(reasons.items()))
            self.left_out = (*passed_over, *leave_out_links(path))
        self._videos = {each.relative_to(path).as_posix(): each for each in found}

    def keys(self) -> list[str]:
        """See `Dataset.keys`: paths of the video files in the folder."""
        return sorted(self._videos)

    def drive(self, key: str) -> Drive:
        """See `Dataset.drive`; reads the coded frames and decodes none."""
        video = self._video(key)
        _check_front(video, self._videos.values())
        front_us, digest = read_frame_times_and_digest(video)
        return Drive(
            source=NAME,
            scene_id=f"{NAME}/{digest}",
            key=key,
            front_us=front_us,
            cameras=(CAMERA,),
            ego_span_us=None,
            true_views=(FRONT_WIDE,),
            notes=UNKNOWN_CAMERA,
        )

    def peek(
        self, key: str, times_us: NDArray[np.int64], width: int, reach_us: NDArray[np.int64]
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        """See `Dataset.peek`; key frames are decoded without others."""
        video = self._video(key)
        _check_front(video, self._videos.values())
        return read_video_images(video, times_us, reach_us, width)

    def open(self, key: str, window_us: Span, options: OpenOptions) -> Recording:
        """See `Dataset.open`."""
        video = self._video(key)
        _check_front(video, self._videos.values())
        return open_video_window(video, video.stem, NAME, window_us, options, self._cache)

    def _video(self, key: str) -> Path:
        if key not in self._videos:
            raise InputError(f"{self._path}: there is no video {key!r}")
        return self._videos[key]


def open_video_window(
    path: Path, name: str, source: str, window_us: Span, options: OpenOptions, cache: Path
) -> Recording:
    """Decode a window of a front video of which nothing is known, in the rig in which unknown cameras are taken to be.

    The options tell in how much from the start the field of view is looked for. It is kept in the cache for as long as
    the file stays the same. Frames that repeat the one before them are left out.

    Raises:
        InputError: the video is damaged, its frames are too far apart or one picture is held for too long to recover
            motion, it is a portrait of unknown field of view, or has no frame in the window, or one in all.
    """
    beginning_us = round(1e6 * (options.duration if math.isfinite(options.duration) else LENS_SECONDS))
    _check_steps(path, window_us)
    video, doubts = _drop_repeats(path, _read_window(path, window_us, beginning_us, options))
    is_beginning = window_us == (0, beginning_us - 1)
    if options.horizontal_fov is not None:
        lens = describe_lens(options.horizontal_fov, "as given", GIVEN_SPREAD)
    else:
        lens = _find_lens(path, video if is_beginning else None, beginning_us, options, cache)
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
            *_word_turn(options),
            *video.notes,
        ),
        spread=CameraSpread(height_spread("assumed" if options.camera_height is None else "given"), lens.spread),
        doubts=(*doubts, *_doubt_sides(video)),
    )


def _check_front(path: Path, beside: Iterable[Path]) -> None:
    elsewhere = looks_elsewhere(path, (each for each in beside if each.parent == path.parent))
    if elsewhere is not None:
        raise InputError(
            f"{path}: {elsewhere.why}, and clips are made of front videos; give the front camera's file, or rename "
            "this one if it is that"
        )


def _check_steps(path: Path, window_us: Span) -> None:
    """Refuse frames too far apart to recover motion from before any is decoded."""
    times_us = read_frame_times(path, (window_us[1] + 1) / 1e6)
    times_us = times_us[times_us >= window_us[0]]
    gaps = 1e-6 * np.diff(times_us)
    if len(gaps) and gaps.max() > MAX_STEP_SECONDS:
        first = int(np.argmax(gaps > MAX_STEP_SECONDS))
        raise InputError(
            f"{path}: the frames shown at {times_us[first] / 1e6:.2f} and {times_us[first + 1] / 1e6:.2f} s are "
            f"{gaps[first]:.2f} s apart, the usual step is {np.median(gaps):.2f} s, and motion is recovered from steps "
            f"of at most {MAX_STEP_SECONDS} s; give a video with more frames a second, or cut it there"
        )


def _read_window(path: Path, window_us: Span, beginning_us: int, options: OpenOptions) -> Video:
    first_us, last_us = window_us
    orientation = turned(options.rotate, options.mirror)
    if first_us > 0:
        return read_video_window(path, first_us, last_us, options.width, orientation)
    video = read_video(path, options.width, (last_us + 1) / 1e6, orientation)
    if len(video.frames) < 2 and last_us >= beginning_us - 1:
        raise InputError(f"{path}: holds a single frame; give a video of at least 2 frames")
    return video


def _drop_repeats(path: Path, video: Video) -> tuple[Video, list[Doubt]]:
    """The video without frames that repeat the one before them, which is noted, and doubts about freezes.

    Raises:
        InputError: a picture is held for longer than motion can be recovered over, but for the end of the video.
    """
    times_us = video.timestamps_us
    found = find_repeated_frames(video.frames, times_us)
    if not found.repeats.any():
        return video, []
    doubts = []
    for freeze in found.freezes:
        start, end = times_us[freeze.first] / 1e6, times_us[freeze.last] / 1e6
        is_end = freeze.last == len(times_us) - 1
        if end - start > MAX_STEP_SECONDS and not is_end:
            raise InputError(
                f"{path}: the picture freezes from {start:.2f} to {end:.2f} s while the vehicle drives, and motion is "
                f"recovered from steps of at most {MAX_STEP_SECONDS} s; cut the video before or after"
            )
        doubts.append(
            Doubt("frames", f"the picture freezes from {start:.2f} to {end:.2f} s, though nothing slowed down before")
        )
    keep = ~found.repeats
    count, total = int(found.repeats.sum()), len(keep)
    pattern = "in no regular pattern"
    if found.showings is not None:
        pattern = f"each picture is shown {' and '.join(map(str, found.showings))} times by turns"
        if len(found.showings) == 1:
            pattern = f"each picture is shown {found.showings[0]} times"
    note = (
        f"{count} of {total} frames repeat the one before them ({pattern}); they are left out, and the others keep "
        "their times."
    )
    kept = replace(video, frames=video.frames[keep], timestamps_us=times_us[keep], notes=(*video.notes, note))
    return kept, doubts


def _doubt_sides(video: Video) -> list[Doubt]:
    side = find_sky_side(video.frames)
    if side is None or side == "top":
        return []
    where = {"bottom": "at the bottom", "left": "on the left", "right": "on the right"}[side]
    return [
        Doubt(
            "view direction",
            f"the sky seems to be {where} of the picture; if it is, open the video with --rotate "
            f"{_TURN_FROM_SIDE[side]}",
        )
    ]


def _word_turn(options: OpenOptions) -> list[str]:
    words = [f"turned clockwise by {options.rotate} degrees"] if options.rotate else []
    words += ["mirrored left to right"] if options.mirror else []
    return [f"Pictures are {' and '.join(words)} as asked for."] if words else []


def _find_lens(
    path: Path, beginning: Video | None, beginning_us: int, options: OpenOptions, cache: Path
) -> AssumedLens:
    """The lens that the beginning of a video tells, kept for as long as the file stays the same."""
    state = path.stat()
    opened = f"{beginning_us}\x1f{options.width}\x1f{options.rotate}\x1f{options.mirror}"
    words = f"{path.name}\x1f{state.st_size}\x1f{state.st_mtime_ns}\x1f{opened}"
    kept = cache / f"lens-{hashlib.blake2b(words.encode(), digest_size=16).hexdigest()}.json"
    if kept.is_file():
        return AssumedLens.read(kept)
    if beginning is None:
        orientation = turned(options.rotate, options.mirror)
        beginning = read_video(path, options.width, beginning_us / 1e6, orientation)
        keep = ~find_repeated_frames(beginning.frames, beginning.timestamps_us).repeats
        beginning = replace(beginning, frames=beginning.frames[keep], timestamps_us=beginning.timestamps_us[keep])
    try:
        lens = find_field_of_view(beginning.frames, beginning.timestamps_us)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    lens.write(kept)
    return lens


def _is_video_or_folder(path: Path) -> bool:
    if path.is_dir():
        return holds_video(path)
    return has_video_suffix(path)


DATASET = DatasetReader(NAME, LICENCE, _is_video_or_folder, Videos)
