"""The motion of the camera in single steps: from the last keyframe to each frame, up to its length and its sign."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from olt_generator.cameras import Camera
from olt_generator.errors import InputError
from olt_generator.motion.features import TrackedPair
from olt_generator.motion.static_mask import BELOW_HORIZON, MOVING_PIXELS, MOVING_SHARE
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
# A step is found again where at least this share of its points turns out to be fixed to the vehicle.
LEAST_HIDDEN = 0.1


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
    points, key, current = pair.points[used], rays_key[used], rays_current[used]
    step = _find_step(pair.key, pair.current, points, key, current, camera, up)
    if isinstance(step, Step):
        return step
    raise InputError(
        f"odometry: frame {pair.current} shares only {step} usable points with frame {pair.key}, {MIN_POINTS} are "
        "needed; cut away dark, blurred or blank frames"
    )


def look_again(step: Step, hidden: NDArray[np.bool_], camera: Camera, up: Array) -> Step:
    """The step found again without its points on `hidden` pixels (H, W), where there are many, and enough others."""
    column, row = np.rint(camera.project(step.rays_key)[0]).astype(np.intp).T
    shown = ~hidden[row.clip(0, camera.height - 1), column.clip(0, camera.width - 1)]
    if np.mean(shown) > 1.0 - LEAST_HIDDEN:
        return step
    rays = step.rays_key[shown], step.rays_current[shown]
    again = _find_step(step.key, step.current, step.points[shown], *rays, camera, up)
    return again if isinstance(again, Step) else step


def _find_step(
    key: int,
    current: int,
    points: NDArray[np.int64],
    rays_key: Array,
    rays_current: Array,
    camera: Camera,
    up: Array,
) -> Step | int:
    """The motion that agrees with most of the points; only how many do where they are too few."""
    if len(points) < MIN_POINTS:
        return len(points)
    flow = np.linalg.norm(camera.project(rays_current)[0] - camera.project(rays_key)[0], axis=1)
    turn = _turn_at_rest(flow, rays_key, rays_current, up, camera)
    if turn is not None:
        rest = TwoViewMotion(turn, np.zeros(3), np.ones(len(points), np.bool_))
        return Step(key, current, False, rest, points, rays_key, rays_current)
    motion = estimate_motion(rays_key, rays_current, TRACK_SIGMA_PIXELS * radians_per_pixel(camera))
    agreeing = 0 if motion is None else int(np.count_nonzero(motion.inliers))
    if motion is None or agreeing < MIN_POINTS:
        return agreeing
    return Step(key, current, True, motion, points, rays_key, rays_current)


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


def speaks_against_standstill(step: Step, camera: Camera, up: Array) -> bool:
    """Whether most of what cannot move while the vehicle stands does: what is near, or where that rests, all else."""
    near = step.rays_key @ up < -np.sin(BELOW_HORIZON)
    looked_at, R = (near, np.eye(3)) if step.moves else (~near, step.motion.R_b_a)
    moved = np.linalg.norm(step.rays_current - step.rays_key @ R.T, axis=1)[looked_at]
    return len(moved) > 0 and bool(np.mean(moved > MOVING_PIXELS * radians_per_pixel(camera)) > MOVING_SHARE)


@lru_cache(maxsize=32)
def radians_per_pixel(camera: Camera) -> float:
    """Angle between neighbouring pixels in the middle of the image."""
    u, v = 0.5 * (camera.width - 1), 0.5 * (camera.height - 1)
    left, right = camera.rays(np.array([[u - 1.0, v], [u + 1.0, v]]))
    return 0.5 * float(np.arccos(left @ right))
