"""The front-tele view: the part of the front view within a narrow angle of its axis, enlarged.

The paper's deterministic FoV-Z crop of 30 degrees. Nothing is invented: a crop about the principal axis and a change
of size leave the lens what it is, so the result is exact in angle for every camera model. A fisheye spends more pixels
on its middle than a perspective image of the same width: cut out of the fisheye itself, not of its rectification, the
crop of a 120-degree front view has 1.6 times the detail.
"""

from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera
from olt_generator.errors import InputError

TELE_FIELD_OF_VIEW = float(np.radians(30.0))

Front = TypeVar("Front", bound=Camera)


def tele_camera(front: Front, width: int, height: int, field_of_view: float = TELE_FIELD_OF_VIEW) -> Front:
    """The camera of the crop: the lens and axis of `front`, with pixels that are square on the axis.

    The optical axis meets the middle row, and the outer edges of the first and last column lie `field_of_view / 2`
    radians from the axis to either side. The axis meets the middle column too, but for lenses with tangential
    distortion, whose two sides differ.

    Raises:
        InputError: the crop would leave the front image.
    """
    across, ahead = np.sin(0.5 * field_of_view), np.cos(0.5 * field_of_view)
    edge_rays = np.array([[-across, 0.0, ahead], [across, 0.0, ahead]])
    edges, _ = front.project(edge_rays)
    # Rays that the lens does not reach come back as others or as none.
    if not np.allclose(front.rays(edges), edge_rays, rtol=0.0, atol=1e-9):
        raise InputError(f"the lens of the front camera does not reach {np.degrees(0.5 * field_of_view):.0f} degrees")
    first, last = edges[:, 0].tolist()
    scale = width / (last - first)
    across_pixels, down_pixels = front.pixels_per_radian
    centre = ((front.cx - first) * scale - 0.5, 0.5 * (height - 1))
    tele = front.redrawn(width, height, (scale, scale * across_pixels / down_pixels), centre)
    corners = np.array([[-0.5, -0.5, 1.0], [width - 0.5, height - 0.5, 1.0]])
    (left, top), (right, bottom) = (corners @ _to_front(tele, front).T).tolist()
    if left < -0.5 or top < -0.5 or right > front.width - 0.5 or bottom > front.height - 0.5:
        raise InputError(
            f"the front camera of {front.width} x {front.height} pixels does not see all of the "
            f"{np.degrees(field_of_view):.0f} degree tele view: it needs columns {left:.0f} to {right:.0f} and rows "
            f"{top:.0f} to {bottom:.0f}; use a wider front image"
        )
    return tele


def crop_tele(frames: NDArray[np.uint8], front: Front, tele: Front) -> NDArray[np.uint8]:
    """Cut the view of `tele` (from `tele_camera`) out of front frames (n, H, W, 3); returns (n, h, w, 3).

    Enlarges by bicubic interpolation; where it shrinks, frames are first blurred as far as the lost resolution asks.
    """
    tele_to_front = _to_front(tele, front)
    shrink = np.maximum(np.diag(tele_to_front[:, :2]), 1.0)
    # The blur that takes a half-pixel Gaussian to the one of a pixel `shrink` times as wide.
    sigma_x, sigma_y = 0.5 * np.sqrt(shrink**2 - 1.0)
    tele_frames = np.empty((len(frames), tele.height, tele.width, 3), np.uint8)
    for frame, tele_frame in zip(frames, tele_frames, strict=True):
        if shrink.max() > 1.0:
            frame = cv2.GaussianBlur(frame, (0, 0), max(sigma_x, 1e-3), sigmaY=max(sigma_y, 1e-3))
        flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        cv2.warpAffine(
            frame, tele_to_front, (tele.width, tele.height), tele_frame, flags, borderMode=cv2.BORDER_REPLICATE
        )
    return tele_frames


def _to_front(tele: Camera, front: Camera) -> NDArray[np.float64]:
    """Affine map (2, 3) from tele pixels to front pixels, as OpenCV takes it."""
    step_u, step_v = np.divide(front.pixels_per_radian, tele.pixels_per_radian)
    return np.array([[step_u, 0.0, front.cx - step_u * tele.cx], [0.0, step_v, front.cy - step_v * tele.cy]])
