"""The front-tele view: the part of the front view within a narrow angle of its axis, enlarged.

The paper's deterministic FoV-Z crop of 30 degrees. Nothing is invented: a crop about the principal axis and a change
of size leave the lens what it is, so the result is exact in angle for every camera model.
"""

from dataclasses import replace
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import FthetaCamera, PinholeCamera
from olt_generator.errors import InputError

TELE_FIELD_OF_VIEW = float(np.radians(30.0))

Front = TypeVar("Front", PinholeCamera, FthetaCamera)


def tele_camera(front: Front, width: int, height: int, field_of_view: float = TELE_FIELD_OF_VIEW) -> Front:
    """The camera of the crop: the model, centre and axis of `front`, with square pixels.

    The principal point is the middle of the image, and the outer edges of the first and last column lie
    `field_of_view / 2` radians from the axis.

    Raises:
        InputError: the crop would leave the front image.
    """
    half_width = _radius(front, 0.5 * field_of_view)
    scale = 0.5 * width / half_width
    tele = _enlarged(front, width, height, scale)
    left, top = _to_front(tele, front) @ [-0.5, -0.5, 1.0]
    right, bottom = _to_front(tele, front) @ [width - 0.5, height - 0.5, 1.0]
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


def _radius(camera: PinholeCamera | FthetaCamera, angle: float) -> float:
    """Horizontal distance in pixels from the principal point of a ray `angle` radians from the axis."""
    if isinstance(camera, PinholeCamera):
        return float(camera.fx * np.tan(angle))
    return float(np.polynomial.polynomial.polyval(angle, camera.fw_poly))


def _enlarged(front: Front, width: int, height: int, scale: float) -> Front:
    """The same lens, `scale` times as large along columns, centred in another image with square pixels."""
    cx, cy = 0.5 * (width - 1), 0.5 * (height - 1)
    if isinstance(front, PinholeCamera):
        focal = front.fx * scale
        return replace(front, width=width, height=height, fx=focal, fy=focal, cx=cx, cy=cy)
    return replace(
        front,
        width=width,
        height=height,
        cx=cx,
        cy=cy,
        fw_poly=tuple(c * scale for c in front.fw_poly),
        bw_poly=tuple(c / scale**power for power, c in enumerate(front.bw_poly)),
        aspect=1.0,
    )


def _to_front(tele: Front, front: Front) -> NDArray[np.float64]:
    """Affine map (2, 3) from tele pixels to front pixels, as OpenCV takes it."""
    step_u, step_v = np.divide(_pixels_per_radian(front), _pixels_per_radian(tele))
    return np.array([[step_u, 0.0, front.cx - step_u * tele.cx], [0.0, step_v, front.cy - step_v * tele.cy]])


def _pixels_per_radian(camera: PinholeCamera | FthetaCamera) -> tuple[float, float]:
    """On the axis, along columns and along rows."""
    if isinstance(camera, PinholeCamera):
        return camera.fx, camera.fy
    return camera.fw_poly[1], camera.fw_poly[1] / camera.aspect
