"""GeoKPM: which share of the points that two views seem to share lies where the cameras say that it must.

Equation (paper, appendix Cross-View Geometric Consistency): the mean over (t, a, b) of M_geo / M in percent, where M
counts the confident matches between view a and view b at moment t and M_geo those whose Sampson error is below 10
pixels. A moment without any match has no share: it is left out of the mean and counted.

The threshold holds for undistorted images of 832 x 480 pixels, the resolution of the paper. So each view is first
resampled to a pinhole camera of that size with the same axis and the view's own horizontal field of view, at most 120
degrees; matches count where both views show something there.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera, Mask, PinholeCamera
from olt_generator.errors import InputError
from olt_generator.lenses.remap import Remapper
from olt_generator.metrics.matchers import Matcher, Matches
from olt_generator.poses import Array, invert
from olt_generator.progress import Progress, silent
from olt_generator.twists import cross_matrix

METRIC_WIDTH, METRIC_HEIGHT = 832, 480
WIDEST_FIELD_OF_VIEW = np.radians(120.0)
MAX_SAMPSON_ERROR = 10.0
# Key points on the edge of what a view shows are made by the edge.
EDGE_PIXELS = 6
MIN_BASELINE = 1e-3


@dataclass(frozen=True)
class PosedView:
    """Images of one camera, and where it was when it took each.

    Attributes:
        images: (n, H, W, 3) uint8 RGB.
        camera: their lens.
        T_world_camera: (n, 4, 4) poses in any frame that the views share.
    """

    images: NDArray[np.uint8]
    camera: Camera
    T_world_camera: Array


@dataclass(frozen=True)
class Consistency:
    """Matches of two views, moment by moment.

    Attributes:
        matches: (n,) confident matches.
        valid: (n,) those that agree with the cameras.
    """

    matches: NDArray[np.int64]
    valid: NDArray[np.int64]

    @property
    def percent(self) -> float | None:
        """GeoKPM; None where no moment has a match."""
        some = self.matches > 0
        return float(100.0 * np.mean(self.valid[some] / self.matches[some])) if some.any() else None

    @property
    def moments_without_match(self) -> int:
        """Moments that the mean leaves out."""
        return int(np.count_nonzero(self.matches == 0))


def join(parts: Sequence[Consistency]) -> Consistency:
    """Several pairs of views as one: every (t, a, b) counts alike."""
    return Consistency(np.concatenate([part.matches for part in parts]), np.concatenate([part.valid for part in parts]))


def measure_consistency(a: PosedView, b: PosedView, matcher: Matcher, on_progress: Progress = silent) -> Consistency:
    """Match two views at each moment and count what agrees with their cameras.

    Args:
        a, b: the views; image k of one belongs to image k of the other.
        matcher: finds the matches.
        on_progress: told the share of moments that are done.

    Raises:
        InputError: the views have different numbers of images, or share one centre.
    """
    if len(a.images) != len(b.images):
        raise InputError(f"views of {len(a.images)} and {len(b.images)} images; give one image of each per moment")
    pinholes = metric_camera(a.camera), metric_camera(b.camera)
    undistorted_a, undistorted_b = _Undistortion(a.camera, pinholes[0]), _Undistortion(b.camera, pinholes[1])
    T_b_a = invert(b.T_world_camera) @ a.T_world_camera
    matches, valid = np.zeros(len(a.images), np.int64), np.zeros(len(a.images), np.int64)
    for moment, pose in enumerate(T_b_a):
        fundamental = fundamental_matrix(*pinholes, pose)
        found = matcher.match(undistorted_a(a.images[moment]), undistorted_b(b.images[moment]))
        found = found.only(undistorted_a.shows(found.pixels_a) & undistorted_b.shows(found.pixels_b))
        matches[moment] = len(found)
        valid[moment] = np.count_nonzero(sampson_errors(fundamental, found) < MAX_SAMPSON_ERROR)
        on_progress((moment + 1) / len(T_b_a))
    return Consistency(matches, valid)


def metric_camera(camera: Camera) -> PinholeCamera:
    """The pinhole camera of the metric for a view: same axis, same horizontal field of view, at most 120 degrees."""
    middle_row = 0.5 * (camera.height - 1)
    rays = camera.rays(np.array([[-0.5, middle_row], [camera.width - 0.5, middle_row]]))
    field_of_view = 2.0 * float(np.abs(np.arctan2(rays[:, 0], rays[:, 2])).max())
    return PinholeCamera.from_field_of_view(METRIC_WIDTH, METRIC_HEIGHT, min(field_of_view, WIDEST_FIELD_OF_VIEW))


def fundamental_matrix(camera_a: PinholeCamera, camera_b: PinholeCamera, T_b_a: Array) -> Array:
    """F (3, 3) with x_b F x_a = 0 for the homogeneous pixels of one point: K_b^-T [t]x R K_a^-1.

    Raises:
        InputError: the cameras share one centre, so that every match would agree.
    """
    if np.linalg.norm(T_b_a[:3, 3]) < MIN_BASELINE:
        raise InputError("the two views are seen from one point: nothing can be said about their consistency")
    essential = cross_matrix(T_b_a[:3, 3]) @ T_b_a[:3, :3]
    return np.linalg.inv(_intrinsics(camera_b)).T @ essential @ np.linalg.inv(_intrinsics(camera_a))


def sampson_errors(fundamental: Array, matches: Matches) -> Array:
    """Sampson errors (n,) in pixels: to first order, how far both ends of each match must move to agree."""
    a, b = (np.column_stack([pixels, np.ones(len(pixels))]) for pixels in (matches.pixels_a, matches.pixels_b))
    lines_b, lines_a = a @ fundamental.T, b @ fundamental
    steepness = np.hypot(np.hypot(*lines_a[:, :2].T), np.hypot(*lines_b[:, :2].T))
    return np.abs(np.einsum("ij,ij->i", b, lines_b)) / np.maximum(steepness, np.finfo(np.float64).tiny)


def _intrinsics(camera: PinholeCamera) -> Array:
    return np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])


class _Undistortion:
    """Resamples a view to the camera of the metric, and knows which pixels show something there."""

    def __init__(self, source: Camera, target: PinholeCamera) -> None:
        self._remapper = Remapper(source, target, np.eye(3))
        size = 2 * EDGE_PIXELS + 1
        seen = np.asarray(self._remapper.seen, np.uint8)
        self._shown: Mask = cv2.erode(seen, np.ones((size, size), np.uint8), borderValue=0) > 0

    def __call__(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        return self._remapper.remap(image)

    def shows(self, pixels: Array) -> Mask:
        """Whether each pixel (n, 2) is well inside of what the view shows."""
        u, v = np.rint(pixels).astype(np.int64).T
        inside = (u >= 0) & (u < METRIC_WIDTH) & (v >= 0) & (v < METRIC_HEIGHT)
        return inside & self._shown[np.clip(v, 0, METRIC_HEIGHT - 1), np.clip(u, 0, METRIC_WIDTH - 1)]
