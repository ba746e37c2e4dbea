"""Plain video files of a front camera, with nothing known about the camera."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera, FthetaCamera, PinholeCamera
from olt_generator.errors import InputError
from olt_generator.motion.focal_length import estimate_field_of_view
from olt_generator.video import Video, read_video
from olt_toolkit.recordings.recording import OpenOptions, Recording
from olt_toolkit.rigs.rig_files import load_rig

SUFFIXES = frozenset({".mp4", ".mov", ".m4v", ".mkv", ".avi", ".webm", ".ts", ".mpg", ".mpeg"})
# The rig in which an unknown camera is taken to be, and its only camera.
RIG, CAMERA = "dashcam", "front"
# Wider lenses are built to keep angles rather than straight lines.
WIDEST_PINHOLE = np.radians(100.0)
# Where a lens comes from that the user told.
GIVEN = "as given"
FIELD_OF_VIEW_RANGE = (np.radians(10.0), np.radians(200.0))


class VideoSource:
    """Opens a video file; what no video tells is assumed and said."""

    name = "video"

    def recognises(self, path: Path) -> bool:
        """See `Source.recognises`; judged by the suffix."""
        return path.is_file() and path.suffix.lower() in SUFFIXES

    def open(self, path: Path, options: OpenOptions) -> Recording:
        """See `Source.open`."""
        video = read_video(path, options.width, options.duration)
        if len(video.frames) < 2:
            raise InputError(f"{path}: holds a single frame; give a video of at least 2 frames")
        lens = find_field_of_view(video.frames, video.timestamps_us, options.horizontal_fov)
        return record_front_video(path.stem, self.name, video, lens, options)


@dataclass(frozen=True)
class AssumedLens:
    """A horizontal field of view in radians, and the sentence that says where it comes from."""

    field_of_view: float
    sentence: str


def record_front_video(name: str, source: str, video: Video, lens: AssumedLens, options: OpenOptions) -> Recording:
    """The recording of a front video with this lens, in the rig in which unknown cameras are taken to be."""
    height, width = video.frames.shape[1:3]
    rig = load_rig(RIG)
    T_rig_camera = rig[CAMERA].T_rig_camera
    if options.camera_height is not None:
        T_rig_camera[2, 3] = options.camera_height
    return Recording(
        name=name,
        source=source,
        frames=video.frames,
        timestamps_us=video.timestamps_us - video.timestamps_us[0],
        camera=assume_camera(width, height, lens.field_of_view),
        T_rig_camera=T_rig_camera,
        vehicle=rig.vehicle,
        assumptions=(lens.sentence, *_mounting_sentences(T_rig_camera, options)),
    )


def find_field_of_view(frames: NDArray[np.uint8], timestamps_us: NDArray[np.int64], given: float | None) -> AssumedLens:
    """The field of view as given, else as estimated from the video, else as assumed for dashcams.

    Args:
        frames: (n, H, W, 3) uint8.
        timestamps_us: (n,) int64.
        given: radians, None where nobody knows.
    """
    if given is not None:
        return describe_lens(given, GIVEN)
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
    """A centred camera with the given horizontal field of view in radians: pinhole, or equidistant where it is wide.

    Raises:
        InputError: the field of view is not between 10 and 200 degrees.
    """
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


def _mounting_sentences(T_rig_camera: NDArray[np.float64], options: OpenOptions) -> tuple[str, ...]:
    forward, height = T_rig_camera[0, 3], T_rig_camera[2, 3]
    height_given = "as given" if options.camera_height is not None else "the default"
    return (
        f"The camera is {height:.2f} m above ground ({height_given}), which fixes the metric scale.",
        f"The camera is {forward:.1f} m ahead of the rear axle, in the middle of the vehicle and not rolled.",
        "The vehicle has the size of the default passenger car.",
    )


SOURCE = VideoSource()
