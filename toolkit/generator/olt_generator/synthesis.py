"""Side views from the front view of the same moment: warp what the front camera sees, invent the rest and say so."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera
from olt_generator.depth import FAR_DISTANCE
from olt_generator.errors import InputError
from olt_generator.fill import fill_holes
from olt_generator.poses import Array, invert
from olt_generator.progress import Progress, silent
from olt_generator.splat import splat

# Splats land in an image this many times as large, which is then averaged down: sub-pixel positions and edges are
# kept (PSNR on a made-up street: 10 dB above none, 4 dB above 2), and the 3 x 3 footprint is one pixel.
SUPERSAMPLING = 3


@dataclass(frozen=True)
class SynthesizedView:
    """Images of a camera that was not there.

    Attributes:
        images: (n, h, w, 3) uint8.
        observed: (n, h, w) bool, where a source pixel landed; the rest is invented by `fill_holes`. Cracks between
            the splats of one surface that are narrower than a pixel count as observed: part of each pixel is.
    """

    images: NDArray[np.uint8]
    observed: NDArray[np.bool_]


def synthesize_view(
    frames: NDArray[np.uint8],
    distance: NDArray[np.float32],
    camera: Camera,
    T_rig_camera: Array,
    target_camera: Camera,
    T_rig_target: Array,
    on_progress: Progress = silent,
) -> SynthesizedView:
    """Warp every frame of the front view into the target camera by T = inv(E_target) E_front and fill what is left.

    Args:
        frames: (n, H, W, 3) uint8 of the front camera.
        distance: (n, H, W) metres along the rays, inf for sky. Nothing is taken to be farther than `FAR_DISTANCE`;
            NaN is not warped.
        camera: front camera at the size of `frames`.
        T_rig_camera: (4, 4) pose of the front camera in the rig.
        target_camera: camera of the wanted view.
        T_rig_target: (4, 4) its pose in the rig.
        on_progress: told the share of frames that are done.

    Raises:
        InputError: frames or distance do not have the size of the camera.
    """
    if len(frames) != len(distance):
        raise InputError(f"{len(frames)} frames and distance for {len(distance)}; give one distance map per frame")
    size = (len(frames), target_camera.height, target_camera.width)
    images, observed = np.empty((*size, 3), np.uint8), np.empty(size, np.bool_)
    T_target_front = invert(T_rig_target) @ T_rig_camera
    large = target_camera.resized(target_camera.width * SUPERSAMPLING, target_camera.height * SUPERSAMPLING)
    for index, (frame, frame_distance) in enumerate(zip(frames, distance, strict=True)):
        within_reach = np.minimum(frame_distance, np.float32(FAR_DISTANCE))
        warp = splat(frame, within_reach, camera, large, T_target_front)
        image, observed[index] = _average_down(warp.image, warp.visible)
        images[index] = fill_holes(image, observed[index])
        on_progress((index + 1) / len(frames))
    return SynthesizedView(images, observed)


def _average_down(image: NDArray[np.uint8], visible: NDArray[np.bool_]) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Mean of the visible parts of each pixel, and where there are any."""
    size = (image.shape[1] // SUPERSAMPLING, image.shape[0] // SUPERSAMPLING)
    share = cv2.resize(visible.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    # Parts where nothing landed are black and add nothing to the mean.
    mean = cv2.resize(image.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    mean /= np.maximum(share, 1e-6)[..., None]
    return np.rint(mean).astype(np.uint8), share > 0.0
