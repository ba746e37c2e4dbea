"""Plain video files of a front camera, with nothing known about the camera."""

from pathlib import Path

import numpy as np

from olt_generator.cameras import Camera, FthetaCamera, PinholeCamera
from olt_generator.errors import InputError
from olt_generator.poses import camera_pose_in_rig
from olt_generator.video import read_video
from olt_toolkit.recording import OpenOptions, Recording
from olt_toolkit.rig import DEFAULT_VEHICLE

SUFFIXES = frozenset({".mp4", ".mov", ".m4v", ".mkv", ".avi", ".webm", ".ts", ".mpg", ".mpeg"})
DEFAULT_FIELD_OF_VIEW = np.radians(70.0)
DEFAULT_CAMERA_HEIGHT = 1.5
# Behind the windscreen, ahead of the rear axle, in metres.
CAMERA_FORWARD = 1.7
# Wider lenses are built to keep angles rather than straight lines.
WIDEST_PINHOLE = np.radians(100.0)
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
        height, width = video.frames.shape[1:3]
        field_of_view = DEFAULT_FIELD_OF_VIEW if options.horizontal_fov is None else options.horizontal_fov
        camera_height = DEFAULT_CAMERA_HEIGHT if options.camera_height is None else options.camera_height
        return Recording(
            name=path.stem,
            source=self.name,
            frames=video.frames,
            timestamps_us=video.timestamps_us,
            camera=assume_camera(width, height, field_of_view),
            T_rig_camera=camera_pose_in_rig([CAMERA_FORWARD, 0.0, camera_height], 0.0, 0.0, 0.0),
            vehicle=DEFAULT_VEHICLE,
            assumptions=_assumptions(options, field_of_view, camera_height),
        )


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


def _assumptions(options: OpenOptions, field_of_view: float, camera_height: float) -> tuple[str, ...]:
    lens = "without distortion" if field_of_view <= WIDEST_PINHOLE else "with an equidistant fisheye lens"
    given = "as given" if options.horizontal_fov is not None else "the default for dashcams"
    height_given = "as given" if options.camera_height is not None else "the default"
    return (
        f"The camera has a horizontal field of view of {np.degrees(field_of_view):.0f} degrees ({given}), {lens}, and "
        "its axis is in the middle of the image.",
        f"The camera is {camera_height:.2f} m above ground ({height_given}), which fixes the metric scale.",
        f"The camera is {CAMERA_FORWARD:.1f} m ahead of the rear axle, in the middle of the vehicle and not rolled.",
        "The vehicle has the size of the default passenger car.",
    )


SOURCE = VideoSource()
