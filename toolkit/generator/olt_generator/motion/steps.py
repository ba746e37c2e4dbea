"""The motion of the camera in single steps: from the last keyframe to each frame, up to its length and its sign."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from olt_generator.cameras import Camera
from olt_generator.errors import InputError
from olt_generator.motion.features import TrackedPair
from olt_generator.motion.static_mask import BELOW_HORIZON
from olt_generator.motion.two_view import TwoViewMotion, estimate_motion
from olt_generator.poses import Array

MIN_POINTS = 20
MAX_RAY_ANGLE = np.radians(75.0)
TRACK_SIGMA_PIXELS = 0.5
# Where nine tenths of the near points move less than this many pixels between keyframes, the vehicle stands.
STANDSTILL_PIXELS = 0.15
STANDSTILL_PERCENTILE = 90.0
# The same once a rotation is taken out; following is less sharp while the picture moves.
TURNING_PIXELS = 0.3


@dataclass(frozen=True)
class Step:
    """Motion from the last keyframe to a frame.

    Attributes:
        key, current: indices of the two frames.
        moves: whether anything moves but by a turn on the spot; the direction is 0 if not.
        motion: rotation, and direction up to its sign.
        points: (n,) identity of the points, of which `motion.inliers` agree with it.
        rays_key, rays_current: (n, 3) unit rays to them.
    """

    key: int
    current: int
    moves: bool
    motion: TwoViewMotion
    points: NDArray[np.int64]
    rays_key: Array
    rays_current: Array


def estimate_step(pair: TrackedPair, camera: Camera, up: Array) -> Step:
    """The motion that agrees with most of the points of a pair; `up` (3,) roughly, in camera axes.

    Raises:
        InputError: too few points.
    """
    rays_key = camera.rays(pair.key_pixels.astype(np.float64))
    rays_current = camera.rays(pair.current_pixels.astype(np.float64))
    used = np.minimum(rays_key[:, 2], rays_current[:, 2]) > np.cos(MAX_RAY_ANGLE)
    key, current, points = rays_key[used], rays_current[used], pair.points[used]
    if len(points) < MIN_POINTS:
        raise _too_few(pair, len(points))
    flow = np.linalg.norm(pair.current_pixels.astype(np.float64) - pair.key_pixels, axis=1)
    turn = _turn_at_rest(flow[used], key, current, up, camera)
    if turn is not None:
        rest = TwoViewMotion(turn, np.zeros(3), np.ones(len(points), np.bool_))
        return Step(pair.key, pair.current, False, rest, points, key, current)
    motion = estimate_motion(key, current, TRACK_SIGMA_PIXELS * radians_per_pixel(camera))
    if motion is None or np.count_nonzero(motion.inliers) < MIN_POINTS:
        raise _too_few(pair, 0 if motion is None else np.count_nonzero(motion.inliers))
    return Step(pair.key, pair.current, True, motion, points, key, current)


def _too_few(pair: TrackedPair, count: np.integer | int) -> InputError:
    return InputError(
        f"odometry: frame {pair.current} shares only {count} usable points with frame {pair.key}, {MIN_POINTS} are "
        "needed; cut away dark, blurred or blank frames"
    )


def _turn_at_rest(flow: Array, rays_key: Array, rays_current: Array, up: Array, camera: Camera) -> Array | None:
    """The rotation R_current_key (3, 3) if nothing moves but by it: none or a turn on the spot; otherwise None.

    What is near decides; clouds and the skyline stay in place even while the vehicle drives. Nearly all of it must: a
    vehicle close ahead stays in place too.
    """
    below = rays_key @ up < -np.sin(BELOW_HORIZON)
    near = below if below.any() else slice(None)
    if np.percentile(flow[near], STANDSTILL_PERCENTILE) < STANDSTILL_PIXELS:
        return np.eye(3)
    R = Rotation.align_vectors(rays_current, rays_key)[0].as_matrix()
    missed = np.linalg.norm(rays_current - rays_key @ R.T, axis=1)
    # What moves by itself tilts the first fit; the second one is made without it.
    agrees = missed <= 2.0 * np.median(missed)
    R = Rotation.align_vectors(rays_current[agrees], rays_key[agrees])[0].as_matrix()
    missed = np.linalg.norm(rays_current - rays_key @ R.T, axis=1)[near]
    return R if np.percentile(missed, STANDSTILL_PERCENTILE) < TURNING_PIXELS * radians_per_pixel(camera) else None


@lru_cache(maxsize=32)
def radians_per_pixel(camera: Camera) -> float:
    """Angle between neighbouring pixels in the middle of the image."""
    u, v = 0.5 * (camera.width - 1), 0.5 * (camera.height - 1)
    left, right = camera.rays(np.array([[u - 1.0, v], [u + 1.0, v]]))
    return 0.5 * float(np.arccos(left @ right))
