"""Monocular visual odometry without learned weights.

Corners are tracked from keyframes a tenth of a second apart, the epipolar geometry gives rotation and direction of
travel, and the road below a camera of known height gives the speed. Nothing is accumulated but rotation: the scale
is measured anew at every step, so it does not drift.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from olt_generator.cameras import Camera, pixel_rays
from olt_generator.errors import InputError
from olt_generator.features import Gray, TrackedPair, track_from_keyframes
from olt_generator.poses import R_FORWARD_CAMERA, Array, camera_pose_in_rig, invert
from olt_generator.progress import Progress, silent
from olt_generator.road_scale import RoadStrip, estimate_speed, road_frame
from olt_generator.trajectory import Trajectory
from olt_generator.two_view import TwoViewMotion, estimate_motion

KEYFRAME_SECONDS = 0.1
MAX_STEP_SECONDS = 0.5
MIN_POINTS = 20
MIN_CAMERA_HEIGHT = 0.3
MAX_RAY_ANGLE = np.radians(75.0)
TRACK_SIGMA_PIXELS = 0.5
# A median motion below this many pixels between keyframes is standstill.
STANDSTILL_PIXELS = 0.15
# A frame in which a quarter of the points move more than this shows what the vehicle carries along.
MOVING_PIXELS = 1.5
CARRIED_MIN_FRAMES = 8
DETAIL_PIXELS = 15
# Farther below the horizon than this, the scene is near enough that it must move when the camera does.
BELOW_HORIZON = np.radians(5.0)


@dataclass(frozen=True)
class Odometry:
    """Metric ego motion from one camera.

    Attributes:
        trajectory: T_world_rig at every frame; the first pose is the identity.
        T_rig_camera: (4, 4) mounting whose pitch and yaw agree with the direction of travel; roll and position are
            as given.
        scale_sigma: relative standard deviation of the metric scale; None where the vehicle never moved.
        inliers: (n - 1,) points that support the motion of each step.
        standstill: (n - 1,) whether the vehicle stood in each step.
    """

    trajectory: Trajectory
    T_rig_camera: Array
    scale_sigma: float | None
    inliers: NDArray[np.int64]
    standstill: NDArray[np.bool_]


def estimate_odometry(
    frames: NDArray[np.uint8],
    timestamps_us: NDArray[np.int64],
    camera: Camera,
    T_rig_camera: Array,
    on_progress: Progress = silent,
) -> Odometry:
    """Recover the metric rig trajectory from a front-camera video.

    Args:
        frames: (n, H, W, 3) uint8 RGB.
        timestamps_us: (n,) int64, strictly increasing.
        camera: model of the camera at the size of the frames.
        T_rig_camera: (4, 4) mounting. Its height above ground sets the scale; its pitch and yaw may be rough.
        on_progress: told the share of the work that is done.

    Raises:
        InputError: fewer than two frames, too long a gap between frames, too few points to track, or no road in view.
    """
    _check_input(timestamps_us, T_rig_camera)
    grays = [cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in frames]
    keyframes = choose_keyframes(timestamps_us)
    pairs = []
    for pair in track_from_keyframes(grays, keyframes):
        pairs.append(pair)
        on_progress(0.5 * pair.current / (len(grays) - 1))
    hidden = find_carried(grays, pairs, camera, T_rig_camera)
    steps = []
    for pair in pairs:
        steps.append(_estimate_step(pair, camera, T_rig_camera[2, :3], hidden))
        on_progress(0.5 + 0.4 * pair.current / (len(grays) - 1))

    key_steps = [step for step in steps if step.current in keyframes]
    seconds = np.diff(timestamps_us[keyframes]) * 1e-6
    speed, scale_sigma = _measure_speed(grays, key_steps, seconds, camera, T_rig_camera, hidden)
    displacements = (speed * seconds)[:, None] * [step.motion.direction_a for step in key_steps]
    mounting = _align_mounting(key_steps, speed, displacements, T_rig_camera)
    T_start_camera = _chain(steps, keyframes, displacements, timestamps_us)
    stood = {step.key: not step.moves for step in key_steps}
    on_progress(1.0)
    return Odometry(
        Trajectory(timestamps_us, mounting @ T_start_camera @ invert(mounting)),
        mounting,
        scale_sigma,
        np.array([np.count_nonzero(step.motion.inliers) for step in steps]),
        np.array([stood[step.key] for step in steps]),
    )


def choose_keyframes(timestamps_us: NDArray[np.int64]) -> list[int]:
    """Indices of frames about a tenth of a second apart, the first and the last among them."""
    times = (timestamps_us - timestamps_us[0]) * 1e-6
    steps = max(1, round(times[-1] / KEYFRAME_SECONDS))
    wanted = np.linspace(0.0, times[-1], steps + 1)
    after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    nearest = np.where(wanted - times[after - 1] < times[after] - wanted, after - 1, after)
    return sorted({0, len(times) - 1, *nearest.tolist()})


def find_carried(
    grays: Sequence[Gray], pairs: Sequence[TrackedPair], camera: Camera, T_rig_camera: Array
) -> NDArray[np.bool_]:
    """Pixels (H, W) below the horizon whose detail stays while the scene moves.

    That is the bonnet, an overlay, dirt and reflections in the windscreen, but also lines along the road: none of
    them tells how far the vehicle has driven. Clips with few moving frames give no such pixels.
    """
    moving = [pair.key for pair in pairs if len(pair.flow) > 0 and np.percentile(pair.flow, 75) > MOVING_PIXELS]
    keyframes = sorted(set(moving))
    if len(keyframes) < CARRIED_MIN_FRAMES:
        return np.zeros((camera.height, camera.width), dtype=np.bool_)
    total, squares = np.zeros((2, camera.height, camera.width), dtype=np.float32)
    for index in keyframes:
        gray = grays[index].astype(np.float32)
        detail = gray - cv2.blur(gray, (DETAIL_PIXELS, DETAIL_PIXELS))
        total += detail
        squares += detail * detail
    # |mean| > standard deviation, both multiplied by the number of frames.
    stays = 2.0 * total**2 > len(keyframes) * squares
    stays = cv2.dilate(stays.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return stays & (pixel_rays(camera) @ T_rig_camera[2, :3] < -np.sin(BELOW_HORIZON))


def _check_input(timestamps_us: NDArray[np.int64], T_rig_camera: Array) -> None:
    if len(timestamps_us) < 2:
        raise InputError(f"odometry: {len(timestamps_us)} frame given, at least 2 are needed; give a longer clip")
    gaps = np.diff(timestamps_us) * 1e-6
    if gaps.max() > MAX_STEP_SECONDS:
        index = int(np.argmax(gaps))
        raise InputError(
            f"odometry: frames {index} and {index + 1} are {gaps[index]:.2f} s apart, at most {MAX_STEP_SECONDS} s can "
            "be tracked; give a video with more frames per second or cut it at the gap"
        )
    if T_rig_camera[2, 3] < MIN_CAMERA_HEIGHT:
        raise InputError(
            f"odometry: the camera is mounted {T_rig_camera[2, 3]:.2f} m above ground, at least {MIN_CAMERA_HEIGHT} m "
            "is needed; give its true height, which fixes the metric scale"
        )


@dataclass(frozen=True)
class _Step:
    """Motion from the last keyframe to a frame; no rotation and direction 0 where nothing moves."""

    key: int
    current: int
    moves: bool
    motion: TwoViewMotion


def _estimate_step(pair: TrackedPair, camera: Camera, up: Array, hidden: NDArray[np.bool_]) -> _Step:
    column, row = np.rint(pair.key_pixels).astype(np.intp).T
    rays_key = camera.rays(pair.key_pixels.astype(np.float64))
    rays_current = camera.rays(pair.current_pixels.astype(np.float64))
    used = ~hidden[row, column] & (np.minimum(rays_key[:, 2], rays_current[:, 2]) > np.cos(MAX_RAY_ANGLE))
    if np.count_nonzero(used) < MIN_POINTS:
        raise _too_few(pair, np.count_nonzero(used))
    if _stands(pair.flow[used], rays_key[used], up):
        return _Step(pair.key, pair.current, False, TwoViewMotion(np.eye(3), np.zeros(3), used))
    sigma = TRACK_SIGMA_PIXELS * _radians_per_pixel(camera)
    motion = estimate_motion(rays_key[used], rays_current[used], sigma)
    if motion is None or np.count_nonzero(motion.inliers) < MIN_POINTS:
        raise _too_few(pair, 0 if motion is None else np.count_nonzero(motion.inliers))
    return _Step(pair.key, pair.current, True, motion)


def _stands(flow: Array, rays: Array, up: Array) -> bool:
    """Whether what is near stays in place; clouds and the skyline stay even while the vehicle drives."""
    near = rays @ up < -np.sin(BELOW_HORIZON)
    return bool(np.median(flow[near] if near.any() else flow) < STANDSTILL_PIXELS)


def _too_few(pair: TrackedPair, count: np.integer | int) -> InputError:
    return InputError(
        f"odometry: frame {pair.current} shares only {count} usable points with frame {pair.key}, {MIN_POINTS} are "
        "needed; cut away dark, blurred or blank frames"
    )


def _radians_per_pixel(camera: Camera) -> float:
    u, v = 0.5 * (camera.width - 1), 0.5 * (camera.height - 1)
    left, right = camera.rays(np.array([[u - 1.0, v], [u + 1.0, v]]))
    return 0.5 * float(np.arccos(left @ right))


def _measure_speed(
    grays: Sequence[Gray],
    steps: Sequence[_Step],
    seconds: Array,
    camera: Camera,
    T_rig_camera: Array,
    hidden: NDArray[np.bool_],
) -> tuple[Array, float | None]:
    """Speed (k,) over the steps between keyframes, and the relative standard deviation of its scale."""
    moves = np.array([step.moves for step in steps])
    if not moves.any():
        return np.zeros(len(steps)), None
    directions = np.array([step.motion.direction_a * _sense(step) for step in steps])[moves]
    travel = np.median(directions, axis=0)
    travel /= np.linalg.norm(travel)
    up, height = T_rig_camera[2, :3], float(T_rig_camera[2, 3])
    axes = road_frame(travel, up, travel)
    strip = RoadStrip(camera, height, axes, hidden)
    scores = np.full((len(steps), strip.shifts), -1.0)
    for index in np.flatnonzero(moves).tolist():
        first, second, motion = _in_driving_order(steps[index])
        step_axes = road_frame(travel, up, motion.direction_a)
        scores[index] = strip.match(grays[first], grays[second], step_axes, motion.R_b_a)
    estimate = estimate_speed(scores, seconds, moves)
    # Suspension and the profile of the road do not average out over a short clip; noise of single matches does.
    pitch_spread = 1.4826 * np.median(np.abs(directions @ axes.up - np.median(directions @ axes.up)))
    return estimate.speed, float(np.hypot(estimate.standard_error, pitch_spread * strip.middle / height))


def _sense(step: _Step) -> float:
    """+1 where the camera moves forward, -1 where it moves backward."""
    return 1.0 if step.motion.direction_a[2] >= 0.0 else -1.0


def _in_driving_order(step: _Step) -> tuple[int, int, TwoViewMotion]:
    """The two frames of a step, ordered such that the camera moves forward from the first to the second."""
    motion = step.motion
    if _sense(step) > 0.0:
        return step.key, step.current, motion
    return step.current, step.key, TwoViewMotion(motion.R_b_a.T, -motion.R_b_a @ motion.direction_a, motion.inliers)


def _align_mounting(steps: Sequence[_Step], speed: Array, displacements: Array, T_rig_camera: Array) -> Array:
    """Mounting with the pitch and yaw for which the rig origin moves along rig x.

    The rear axle does not slip sideways, so the rig origin, which lies at q in the camera, moves straight ahead by
    d + (R - I) q where the camera moves by d and turns by R. Only the faster half of the speeds is asked.
    """
    fast = np.flatnonzero((speed > 0.0) & (speed >= 0.5 * speed.max()))
    if len(fast) == 0:
        return T_rig_camera
    origin = invert(T_rig_camera)[:3, 3]
    turns = np.array([steps[index].motion.R_b_a.T - np.eye(3) for index in fast.tolist()])
    moved = displacements[fast] + turns @ origin
    moved *= np.sign(moved[:, 2:]) / np.linalg.norm(moved, axis=1, keepdims=True)
    roll = Rotation.from_matrix(T_rig_camera[:3, :3] @ R_FORWARD_CAMERA.T).as_euler("ZYX")[2]
    # Rz(yaw) Ry(pitch) turns this direction, which has the roll already, to rig x.
    x, y, z = Rotation.from_rotvec([roll, 0.0, 0.0]).as_matrix() @ R_FORWARD_CAMERA @ np.median(moved, axis=0)
    pitch, yaw = np.arctan2(z, x), -np.arctan2(y, np.hypot(x, z))
    return camera_pose_in_rig(T_rig_camera[:3, 3], float(roll), float(pitch), float(yaw))


def _chain(
    steps: Sequence[_Step], keyframes: Sequence[int], displacements: Array, timestamps_us: NDArray[np.int64]
) -> Array:
    """Camera poses (n, 4, 4) in the axes of the first camera.

    Rotations are those of every frame; positions are chained over the keyframes and interpolated between them.
    """
    poses = np.tile(np.eye(4), (len(timestamps_us), 1, 1))
    for step in steps:
        poses[step.current, :3, :3] = poses[step.key, :3, :3] @ step.motion.R_b_a.T
    moved = np.einsum("kij,kj->ki", poses[keyframes[:-1], :3, :3], displacements)
    positions = np.concatenate([np.zeros((1, 3)), np.cumsum(moved, axis=0)])
    times = (timestamps_us - timestamps_us[0]) * 1e-6
    poses[:, :3, 3] = PchipInterpolator(times[list(keyframes)], positions)(times)
    return poses
