"""What one camera of a clip shows of its motion: small grey images, and points followed from one to the next."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera
from olt_generator.errors import InputError
from olt_generator.motion.features import Pixels, detect_corners, track_corners
from olt_generator.poses import Array
from olt_generator.views.pixel_origin import PixelOrigin
from olt_toolkit.clips.images import resize_masks
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.verification.decoded_videos import ClipVideos, looked_at

# Points are followed over so many steps of a clip, spread evenly over it, and over none that is longer.
MOST_STEPS = 24
LONGEST_STEP_US = 250_000
# Of the points of an image at most so many are followed.
MOST_POINTS = 50
# A point lies so many pixels or more away from what no camera saw.
_MASK_MARGIN = 9


@dataclass(frozen=True)
class CameraImages:
    """Small images of one camera.

    Attributes:
        name: of the camera.
        lens, T_rig_camera: lens at the size of the images, and mounting (4, 4).
        times_us: (m,) clip times.
        grays: (m, h, w) brightness, 0 to 255.
        seen: (m, h, w) pixels that a camera saw; None where it saw all.
    """

    name: str
    lens: Camera
    T_rig_camera: Array
    times_us: NDArray[np.int64]
    grays: NDArray[np.uint8]
    seen: NDArray[np.bool_] | None

    def seen_in(self, frame: int) -> NDArray[np.bool_] | None:
        """Pixels (h, w) of one image that a camera saw; None where it saw all."""
        return None if self.seen is None else self.seen[frame]


@dataclass(frozen=True)
class ImageSteps:
    """Points followed over steps from an image to the next.

    Attributes:
        images: what they were followed in.
        first, second: (s,) numbers of the images of each step.
        step: (n,) the step of each point.
        pixels, moved: (n, 2) where it lies in the first and in the second image of the step.
    """

    images: CameraImages
    first: NDArray[np.int64]
    second: NDArray[np.int64]
    step: NDArray[np.int64]
    pixels: Array
    moved: Array


def read_camera_images(store: ClipStore, clip_id: str, camera: str, videos: ClipVideos) -> CameraImages:
    """Small images of one camera over the whole clip, about ten a second.

    Raises:
        InputError: the clip's files are damaged.
    """
    mounted = store.read_camera(clip_id, camera)
    timestamps_us = store.read_timestamps(clip_id, camera)
    times_us = timestamps_us[looked_at(timestamps_us)]
    video = videos.decode(camera)
    if video.problem is not None or len(video.kept) != len(times_us):
        why = video.problem or f"{len(video.numbers)} frames for {len(timestamps_us)} timestamps"
        raise InputError(f"{store.root}: clip {clip_id}: {camera}: {why}; build the clip again")
    height, width = video.kept.shape[1:]
    seen = None
    if not store.info(clip_id).views[camera].is_seen_whole:
        origin = resize_masks(store.read_origin(clip_id, camera, times_us), width, height)
        seen = (origin == PixelOrigin.SAME_FRAME) | (origin == PixelOrigin.OTHER_FRAME)
    return CameraImages(camera, mounted.camera.resized(width, height), mounted.T_rig_camera, times_us, video.kept, seen)


def follow_points(images: CameraImages) -> ImageSteps:
    """Follow points over single steps that are spread over the clip."""
    near = np.flatnonzero(np.diff(images.times_us) <= LONGEST_STEP_US)
    chosen = near[np.unique(np.linspace(0, len(near) - 1, min(MOST_STEPS, len(near))).round().astype(int))]
    step: list[NDArray[np.int64]] = [np.zeros(0, np.int64)]
    pixels: list[Array] = [np.zeros((0, 2))]
    moved: list[Array] = [np.zeros((0, 2))]
    kernel = np.ones((2 * _MASK_MARGIN + 1,) * 2, np.uint8)
    for number, frame in enumerate(chosen.tolist()):
        before, after = images.grays[frame], images.grays[frame + 1]
        hidden = None
        if images.seen is not None:
            unseen = ~images.seen[frame] | ~images.seen[frame + 1]
            hidden = cv2.dilate(unseen.astype(np.uint8), kernel) > 0
        corners = _thin(detect_corners(before, 1, hidden))
        followed, found = track_corners(before, after, corners)
        step.append(np.full(np.count_nonzero(found), number, np.int64))
        pixels.append(corners[found].astype(np.float64))
        moved.append(followed[found].astype(np.float64))
    return ImageSteps(images, chosen, chosen + 1, np.concatenate(step), np.concatenate(pixels), np.concatenate(moved))


def _thin(pixels: Pixels) -> Pixels:
    """At most `MOST_POINTS` of the points (n, 2), spread over the image as they are."""
    if len(pixels) <= MOST_POINTS:
        return pixels
    return pixels[np.linspace(0, len(pixels) - 1, MOST_POINTS).round().astype(int)]
