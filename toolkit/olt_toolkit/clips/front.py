"""The front-wide view of a recording whose camera need not be a front-wide camera.

A policy is told which camera an image is from, and never with what lens (docs/formats/alpamayo.md): it reads distances
and angles off the pixels of the camera that it knows. So the view is by default `as-named`: the rig's own front-wide
camera, lens and direction, at the place of the recording's camera, which is exact for everything at any distance;
what the recording does not see stays black and is marked. `as-is` keeps the recording's lens, which shows things
larger or smaller, and turned, against what the name promises.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera
from olt_generator.errors import InputError
from olt_generator.lenses.remap import Remapper
from olt_generator.poses import Array
from olt_generator.views.pixel_origin import PixelOrigin
from olt_toolkit.rigs.names import FrontLens
from olt_toolkit.rigs.rig import FRONT_WIDE, MountedCamera

Images = NDArray[np.uint8]

# Cameras of one name differ from vehicle to vehicle: principal points of real front-wide cameras by some 40 of 960
# pixels. A lens within this share of the angles of the named one counts as the named one.
_SAME_LENS = 0.05
_SAMPLES = 2


def fit_width(camera: Camera, width: int, height: int) -> Camera:
    """The camera of an image scaled to the whole width; rows are cropped, or added, about the centre."""
    scaled = camera.resized(width, round(camera.height * width / camera.width))
    return scaled.cropped(0, (scaled.height - height) // 2, width, height)


def fit_width_images(frames: Images, width: int, height: int) -> tuple[Images, NDArray[np.bool_]]:
    """Images (n, height, width, 3) of frames (n, H, W, 3) as `fit_width` has them, and which rows (height,) they fill.

    Rows beyond the frames are black.
    """
    factor = width / frames.shape[2]
    scaled_height = round(frames.shape[1] * factor)
    top = (scaled_height - height) // 2
    rows = slice(max(top, 0), min(top + height, scaled_height))
    fitted = np.zeros((len(frames), height, width, 3), np.uint8)
    interpolation = cv2.INTER_AREA if factor < 1.0 else cv2.INTER_CUBIC
    for frame, target in zip(frames, fitted, strict=True):
        scaled = cv2.resize(frame, (width, scaled_height), interpolation=interpolation)
        target[rows.start - top : rows.stop - top] = scaled[rows]
    filled = np.arange(height) + top
    return fitted, (filled >= 0) & (filled < scaled_height)


def is_lens_of(camera: Camera, named: Camera) -> bool:
    """Whether along the row of its axis a camera sees each column at the angle at which the named one does.

    Both have images of one size.
    """
    columns = np.arange(named.width)
    ours, theirs = _angles(camera, columns), _angles(named, columns)
    return bool(np.max(np.abs(ours - theirs)) <= _SAME_LENS * np.abs(theirs).max())  # NaN is no agreement


def degrees_across(camera: Camera) -> float:
    """Horizontal field of view in degrees, along the row of the optical axis, of the columns that the lens reaches."""
    angles = np.degrees(_angles(camera, np.arange(2 * camera.width + 1) / 2 - 0.5))
    return float(np.nanmax(angles) - np.nanmin(angles))


def see_through(
    frames: Images, source: Camera, T_rig_source: Array, named: MountedCamera
) -> tuple[Images, NDArray[np.bool_], Array]:
    """Frames (n, H, W, 3) of one camera as the named one would have taken them from the same place.

    Returns:
        Images (n, h, w, 3), black where the source sees nothing; the pixels (h, w) that it sees; and the mounting
        (4, 4): place of the source, direction of the named camera.

    Raises:
        InputError: the source sees nothing of the view.
    """
    T_rig_view = T_rig_source.copy()
    T_rig_view[:3, :3] = named.T_rig_camera[:3, :3]
    remapper = Remapper(source, named.camera, T_rig_source[:3, :3].T @ T_rig_view[:3, :3], _SAMPLES)
    if not remapper.seen.any():
        raise InputError(f"the recording's camera sees nothing of {FRONT_WIDE}; give --front {FrontLens.AS_IS}")
    return remapper.remap(frames), np.asarray(remapper.seen), T_rig_view


def border_origin(seen: NDArray[np.bool_], count: int) -> NDArray[np.uint8]:
    """The origin (count, h, w) of images that all see the same pixels (h, w); the others are borders."""
    origin = np.where(seen, PixelOrigin.SAME_FRAME, PixelOrigin.UNSEEN).astype(np.uint8)
    return np.repeat(origin[None], count, axis=0)


def _angles(camera: Camera, columns: NDArray[np.generic]) -> Array:
    """Angles (n,) from the axis, positive to the right, of columns (n,) along the row of the axis."""
    rays = camera.rays(np.stack(np.broadcast_arrays(np.asarray(columns, np.float64), camera.cy), axis=-1))
    return np.arctan2(rays[:, 0], rays[:, 2])
