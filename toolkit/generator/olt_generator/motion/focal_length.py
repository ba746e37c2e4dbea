"""The field of view of an uncalibrated camera, from the turns in its video.

While a vehicle turns, image points move by an amount that depends on where they are in the image, and how, depends on
the focal length: only with the right one does a single motion of the camera explain all points. Driving straight tells
nothing, because a longer lens and a deeper scene look the same; nor does a turn of constant radius seen along the
tangent (Sturm, "Critical motion sequences for the self-calibration of cameras and stereo systems with variable focal
length", BMVC 1999). So what comes out is an estimate with an interval, or the reason why there is none.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from olt_generator.lenses.camera_model import Camera
from olt_generator.motion.features import detect_corners, track_corners
from olt_generator.motion.two_view import estimate_motion, refine_motion
from olt_generator.poses import Array
from olt_generator.seeds import make_generator

# Fields of view that are tried, in degrees.
CANDIDATES = (35.0, 39.0, 43.0, 47.0, 52.0, 57.0, 62.0, 68.0, 74.0, 80.0, 87.0, 94.0, 100.0, 108.0, 117.0, 127.0)
WORKING_WIDTH = 480
# Points are followed from frame to frame at this spacing, over windows of this length.
FRAME_SECONDS = 0.1
WINDOW_SECONDS = 0.4
MAX_WINDOWS = 16
MIN_WINDOWS = 5
MIN_POINTS = 40
CORNERS_PER_CELL = 4
# A window that turns less, as the middle candidate sees it, says next to nothing.
MIN_TURN = np.radians(1.5)
# Points that stay while the camera turns belong to the vehicle.
STATIC_PIXELS = 1.0
TRACK_SIGMA_PIXELS = 0.3
# The windows must agree to this share of the estimate.
WIDEST_SPREAD = 0.15
# By so much of the truth were estimates off in synthetic drives of known lenses, whatever the windows agreed on.
SYSTEMATIC_ERROR = 0.06
RESAMPLES = 400
_MAX_REFINEMENTS = 12
_CONVERGED = 1e-7


@dataclass(frozen=True)
class FieldOfViewEstimate:
    """What a video tells about the field of view of its camera.

    Attributes:
        field_of_view: horizontal, radians; None where the video does not determine it.
        interval: 5th and 95th percentile over resampled windows, radians, widened by the systematic error; None where
            too few windows turn.
        windows: windows of the video that turn enough to tell anything.
        reason: why there is no estimate, in words; empty where there is one.
    """

    field_of_view: float | None
    interval: tuple[float, float] | None
    windows: int
    reason: str = ""


# The same points (n, 2) at both ends of a window, in pixels of the working size.
_Window = tuple[Array, Array]


def estimate_field_of_view(
    frames: NDArray[np.uint8], timestamps_us: NDArray[np.int64], lens: Callable[[int, int, float], Camera]
) -> FieldOfViewEstimate:
    """Estimate the horizontal field of view by which a video explains itself best.

    Args:
        frames: (n, H, W, 3) uint8 RGB.
        timestamps_us: (n,) int64, strictly increasing.
        lens: makes the camera of (width, height, horizontal field of view in radians).
    """
    grays = _working_images(frames, timestamps_us)
    height, width = grays[0].shape
    cameras = [lens(width, height, float(np.radians(degrees))) for degrees in CANDIDATES]
    windows = _turning_windows(grays, cameras[len(cameras) // 2])
    if len(windows) < MIN_WINDOWS:
        reason = (
            f"only {len(windows)} windows of {WINDOW_SECONDS} s turn by more than {np.degrees(MIN_TURN):.1f} degrees, "
            f"{MIN_WINDOWS} are needed"
        )
        return FieldOfViewEstimate(None, None, len(windows), reason)
    costs = np.array([_costs(window, cameras) for window in windows])
    draws = make_generator("field of view").integers(0, len(windows), (RESAMPLES, len(windows)))
    low, high = np.percentile([_lowest(costs[draw].sum(axis=0)) for draw in draws], [5.0, 95.0])
    widened = np.radians([low * (1.0 - SYSTEMATIC_ERROR), high * (1.0 + SYSTEMATIC_ERROR)])
    interval = (float(widened[0]), float(widened[1]))
    best = _lowest(costs.sum(axis=0))
    if not CANDIDATES[0] < best < CANDIDATES[-1] or high - low > WIDEST_SPREAD * best:
        reason = f"its turns leave anything from {low:.0f} to {high:.0f} degrees open"
        return FieldOfViewEstimate(None, interval, len(windows), reason)
    return FieldOfViewEstimate(float(np.radians(best)), interval, len(windows))


def _working_images(frames: NDArray[np.uint8], timestamps_us: NDArray[np.int64]) -> list[NDArray[np.uint8]]:
    """Grey images of the working width, about `FRAME_SECONDS` apart."""
    seconds = (timestamps_us - timestamps_us[0]) * 1e-6
    wanted = np.arange(0.0, seconds[-1] + 1e-6, FRAME_SECONDS)
    chosen = np.unique(np.searchsorted(seconds, wanted - 1e-6).clip(max=len(frames) - 1))
    width = min(WORKING_WIDTH, frames.shape[2])
    size = (width, round(frames.shape[1] * width / frames.shape[2]))
    grays = [cv2.cvtColor(frames[index], cv2.COLOR_RGB2GRAY) for index in chosen]
    return [np.asarray(cv2.resize(gray, size, interpolation=cv2.INTER_AREA), np.uint8) for gray in grays]


def _turning_windows(grays: Sequence[NDArray[np.uint8]], camera: Camera) -> list[_Window]:
    """The windows that turn the most, at most `MAX_WINDOWS`; they do not overlap."""
    length = round(WINDOW_SECONDS / FRAME_SECONDS)
    turning = []
    for start in range(0, len(grays) - length, length):
        first = last = detect_corners(grays[start], CORNERS_PER_CELL)
        for previous, current in pairwise(grays[start : start + length + 1]):
            last, found = track_corners(previous, current, last)
            first, last = first[found], last[found]
        moved = np.linalg.norm(last - first, axis=1) > STATIC_PIXELS
        window = first[moved].astype(np.float64), last[moved].astype(np.float64)
        if np.count_nonzero(moved) < MIN_POINTS:
            continue
        motion = _first_motion(window, camera)
        turn = 0.0 if motion is None else Rotation.from_matrix(motion[0]).magnitude()
        if turn > MIN_TURN:
            turning.append((turn, window))
    turning.sort(key=lambda pair: -pair[0])
    return [window for _, window in turning[:MAX_WINDOWS]]


def _first_motion(window: _Window, camera: Camera) -> tuple[Array, Array] | None:
    """R_last_first (3, 3) and the translation (3,) of p_last = R p_first + t."""
    sigma = 2.0 * TRACK_SIGMA_PIXELS / camera.pixels_per_radian[0]
    motion = estimate_motion(camera.rays(window[0]), camera.rays(window[1]), sigma)
    return None if motion is None else (motion.R_b_a, -motion.R_b_a @ motion.direction_a)


def _costs(window: _Window, cameras: Sequence[Camera]) -> Array:
    """Cost (k,) of the motion that explains a window best, for every camera.

    Starts from the middle camera and goes to both ends, each time from the motion of the neighbour.
    """
    middle = len(cameras) // 2
    costs = np.zeros(len(cameras))
    start = _first_motion(window, cameras[middle])
    if start is None:
        return costs
    for indices in (range(middle, len(cameras)), range(middle - 1, -1, -1)):
        R, t = start
        for index in indices:
            R, t, costs[index] = _fit_motion(window, cameras[index], R, t)
    return costs


def _fit_motion(window: _Window, camera: Camera, R: Array, t: Array) -> tuple[Array, Array, float]:
    """Robust Gauss-Newton on the Sampson distance in pixels; returns R, t and the Geman-McClure cost.

    With c = R a the epipolar product e = b . (t x c) has the derivatives (t . c) b - (b . c) t by a rotation after R,
    and c x b by t.
    """
    a, *a_slopes = _rays_and_slopes(camera, window[0])
    b, *b_slopes = _rays_and_slopes(camera, window[1])

    def linearise(R: Array, t: Array, across: Array) -> tuple[Array, Array]:
        c = a @ R.T
        normals, lines = np.cross(t, c), np.cross(b, t)
        gradient = [np.einsum("ij,ij->i", slope, normals) for slope in b_slopes]
        gradient += [np.einsum("ij,ij->i", slope @ R.T, lines) for slope in a_slopes]
        length = np.maximum(np.linalg.norm(gradient, axis=0), 1e-12)
        by_rotation = (c @ t)[:, None] * b - np.einsum("ij,ij->i", b, c)[:, None] * t
        jacobian = np.concatenate([by_rotation, np.cross(c, b) @ across.T], axis=1) / length[:, None]
        return np.einsum("ij,ij->i", b, normals) / length, jacobian

    R, t = refine_motion(R, t, linearise, TRACK_SIGMA_PIXELS, _MAX_REFINEMENTS, _CONVERGED)
    squares = (linearise(R, t, np.eye(3)[:2])[0] / TRACK_SIGMA_PIXELS) ** 2
    return R, t, float(np.sum(squares / (1.0 + squares)))


def _rays_and_slopes(camera: Camera, pixels: Array) -> tuple[Array, Array, Array]:
    """Rays (n, 3) and their change by a pixel to the right and down."""
    right, down = (camera.rays(pixels + half) - camera.rays(pixels - half) for half in 0.5 * np.eye(2))
    return camera.rays(pixels), right, down


def _lowest(costs: Array) -> float:
    """Candidate in degrees of the lowest cost, refined by the parabola through its neighbours."""
    index = int(np.argmin(costs))
    if index in (0, len(costs) - 1):
        return CANDIDATES[index]
    around = slice(index - 1, index + 2)
    second, first, _ = np.polyfit(CANDIDATES[around], costs[around], 2)
    return float(-0.5 * first / second)
