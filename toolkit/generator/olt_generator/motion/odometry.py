"""Monocular visual odometry without learned weights.

Corners are tracked over keyframes a tenth of a second apart. Epipolar geometry gives the rotation of each step and the
line along which the camera moved; whether forward or backward, and how fast, is told by the road below a camera of
known height, because most corners may belong to vehicles that move by themselves. From there all keyframes are adjusted
together to all tracks, which makes the shape of the path exact but lets its scale drift; the road gives the scale back.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from olt_generator.cameras import Camera
from olt_generator.doubts import Doubt
from olt_generator.errors import InputError
from olt_generator.motion.bundle_adjustment import AdjustedPoses, FeatureTracks, StepPriors, adjust_poses
from olt_generator.motion.evidence import DOUBTFUL_LOG_SCALE, Evidence, find_doubts
from olt_generator.motion.features import Gray, track_from_keyframes
from olt_generator.motion.path_covariance import CORRELATED_TRACKS, add_up_drift, turning_drift
from olt_generator.motion.pose_sources import PoseEstimate
from olt_generator.motion.road_following import ahead, follow_road, usual_direction
from olt_generator.motion.road_grid import RoadGrid, road_frame
from olt_generator.motion.road_plane import measure_scale
from olt_generator.motion.road_speed import RoadSpeed
from olt_generator.motion.road_structure import find_planes
from olt_generator.motion.rolling_step import fit_rolling_step, slip_angle, straighten
from olt_generator.motion.smoother import ODOMETRY_SETTINGS
from olt_generator.motion.static_mask import choose_moving, find_static_mask
from olt_generator.motion.steps import TRACK_SIGMA_PIXELS, Step, estimate_step, radians_per_pixel, turn_between
from olt_generator.motion.two_view import TwoViewMotion, parallax_forward
from olt_generator.poses import R_FORWARD_CAMERA, Array, aim_camera, invert, make_pose
from olt_generator.progress import Progress, silent
from olt_generator.trajectory import Trajectory

KEYFRAME_SECONDS = 0.1
MAX_STEP_SECONDS = 0.5
MIN_CAMERA_HEIGHT = 0.3
# Keyframes after its first in which a point must be seen.
LEAST_OBSERVATIONS = 2
# Slower than this is standstill too, m/s; faster than that the road moves in the picture.
STANDSTILL_SPEED = 0.05
DRIVING_SPEED = 1.0
# Slow motion is measured over more than one step: over this distance, and so many keyframes at most.
SLOW_METRES = 0.8
MOST_STEPS = 8
# A step whose direction is farther than this from that of a vehicle which rolls is found again as one of such a vehicle.
LARGEST_SLIP = np.radians(1.5)
# Shorter steps do not tell their direction, metres.
LEAST_TO_SLIP = 0.3
# How far a step found on its own may be from the truth: radians of rotation, share of the distance driven along the
# step, radians of its direction; and what is left of radians and metres at standstill.
PRIOR_ROTATION = np.radians(0.1)
PRIOR_SPEED_SHARE = 0.05
PRIOR_DIRECTION = np.radians(2.0)
STANDING_ROTATION = 1e-5
STANDING_METRES = 0.002


@dataclass(frozen=True)
class OdometrySettings:
    """How much work is spent on a clip.

    Attributes:
        corners_per_cell: points followed in every 32 x 32 pixels.
        window: keyframes over which a point is followed at most, and so seen together.
        rounds: Gauss-Newton rounds over all keyframes together; 0 leaves every step as it was found on its own.
    """

    corners_per_cell: int = 4
    window: int = 10
    rounds: int = 6


@dataclass(frozen=True)
class Odometry(PoseEstimate):
    """Metric ego motion from one camera; its scale is not known where the vehicle never moved.

    The mounting's pitch and yaw agree with the direction of travel; its roll and position are as given.

    Attributes:
        inliers: (n - 1,) points that support the motion of each step.
        standstill: (n - 1,) whether the vehicle stood in each step.
    """

    inliers: NDArray[np.int64]
    standstill: NDArray[np.bool_]


def estimate_odometry(
    frames: NDArray[np.uint8],
    timestamps_us: NDArray[np.int64],
    camera: Camera,
    T_rig_camera: Array,
    on_progress: Progress = silent,
    settings: OdometrySettings | None = None,
) -> Odometry:
    """Recover the metric rig trajectory from a front-camera video.

    Args:
        frames: (n, H, W, 3) uint8 RGB.
        timestamps_us: (n,) int64, strictly increasing.
        camera: model of the camera at the size of the frames.
        T_rig_camera: (4, 4) mounting. Its height above ground sets the scale; its pitch and yaw may be rough.
        on_progress: told the share of the work that is done.
        settings: how much work is spent; None for the defaults.

    Raises:
        InputError: fewer than two frames, too long a gap between frames, too few points to track, or no road in view.
    """
    _check_input(timestamps_us, T_rig_camera)
    settings = settings or OdometrySettings()
    grays = [cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in frames]
    keyframes = choose_keyframes(timestamps_us)
    hidden = find_static_mask([grays[key] for key in choose_moving(grays, keyframes)], camera, T_rig_camera)
    steps = []
    for pair in track_from_keyframes(grays, keyframes, hidden, settings.corners_per_cell, settings.window):
        steps.append(estimate_step(pair, camera, T_rig_camera[2, :3]))
        on_progress(0.8 * pair.current / (len(grays) - 1))
    key_steps = [step for step in steps if step.current in set(keyframes)]
    times = (timestamps_us - timestamps_us[0]) * 1e-6
    clip = _Clip(grays, times, keyframes, key_steps, camera, T_rig_camera, hidden)
    path = _recover_keyframes(clip, settings)
    T_start_key, mounting = path.T_start_key, path.mounting
    on_progress(1.0)
    # Positions between the keyframes' run smoothly, rotations are measured.
    T_start_camera = np.tile(np.eye(4), (len(timestamps_us), 1, 1))
    rotation_of = dict(zip(keyframes, T_start_key[:, :3, :3], strict=True))
    for step in steps:
        measured = rotation_of[step.key] @ step.motion.R_b_a.T
        T_start_camera[step.current, :3, :3] = rotation_of.get(step.current, measured)
    T_start_camera[:, :3, 3] = PchipInterpolator(times[keyframes], T_start_key[:, :3, 3])(times)
    stood = dict(zip(keyframes, ~path.moves, strict=False))
    return Odometry(
        Trajectory(timestamps_us, mounting @ T_start_camera @ invert(mounting)),
        mounting,
        path.scale_sigma,
        ODOMETRY_SETTINGS,
        np.array([np.count_nonzero(step.motion.inliers) for step in steps]),
        np.array([stood[step.key] for step in steps]),
        covariance=_in_rig_axes(path.covariance, mounting, times[keyframes], times),
        doubts=path.doubts,
    )


def choose_keyframes(timestamps_us: NDArray[np.int64]) -> list[int]:
    """Indices of frames about a tenth of a second apart, the first and the last among them, of times (n,)."""
    times = (timestamps_us - timestamps_us[0]) * 1e-6
    steps = max(1, round(times[-1] / KEYFRAME_SECONDS))
    wanted = np.linspace(0.0, times[-1], steps + 1)
    after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    nearest = np.where(wanted - times[after - 1] < times[after] - wanted, after - 1, after)
    return sorted({0, len(times) - 1, *nearest.tolist()})


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
class _Clip:
    """What is known of a clip, times in seconds, once every step between keyframes has been found on its own."""

    grays: Sequence[Gray]
    times: Array
    keyframes: list[int]
    key_steps: list[Step]
    camera: Camera
    T_rig_camera: Array
    hidden: NDArray[np.bool_]


@dataclass(frozen=True)
class _Path:
    """What was recovered of the keyframes.

    Attributes:
        T_start_key: (k, 4, 4) poses in the axes of the first one.
        covariance: (k, 6, 6) of their errors, in the same axes.
        mounting: (4, 4) of the camera.
        moves: (k - 1,) which steps move.
        scale_sigma: relative standard deviation of the scale; None where nothing moves.
        doubts: why all this may be wrong.
    """

    T_start_key: Array
    covariance: Array
    mounting: Array
    moves: NDArray[np.bool_]
    scale_sigma: float | None
    doubts: tuple[Doubt, ...]


def _recover_keyframes(clip: _Clip, settings: OdometrySettings) -> _Path:
    """The motion of the keyframes."""
    times = clip.times[clip.keyframes]
    grays = [clip.grays[index] for index in clip.keyframes]
    road = _follow_road(clip, grays, np.diff(times))
    speed = np.where(np.abs(road.speed) < STANDSTILL_SPEED, 0.0, road.speed)
    signed = list(zip(clip.key_steps, speed * np.diff(times), strict=True))
    straight = [straighten(step, driven, clip.T_rig_camera) for step, driven in signed if driven != 0.0]
    usual = _turn_ahead(clip.T_rig_camera, usual_direction(straight, clip.T_rig_camera[0, :3]))
    slips = [slip_angle(step, driven, usual) for step, driven in signed if abs(driven) > LEAST_TO_SLIP]
    settled = [_settle(clip, step, driven, usual) for step, driven in signed]
    clip = replace(clip, key_steps=settled)
    moves = np.array([step.moves for step in settled])
    if not moves.any():
        standing = np.zeros((len(times), 6, 6)) + np.diag([STANDING_METRES**2] * 3 + [PRIOR_ROTATION**2] * 3)
        T_start_key = _chain(_expect(clip, np.zeros(len(moves))))
        return _Path(T_start_key, standing, clip.T_rig_camera, moves, None, ())
    driven = np.where(moves, np.abs(road.speed) * np.diff(times), 0.0)
    tracks, ray_sigma = _collect_tracks(clip), TRACK_SIGMA_PIXELS * radians_per_pixel(clip.camera)
    adjusted = _adjust(clip, driven, tracks, ray_sigma, settings.rounds)
    T_key_next = invert(adjusted.poses[:-1]) @ adjusted.poses[1:]
    mounting = _align_mounting(T_key_next, driven / np.diff(times), clip.T_rig_camera)
    driving = np.flatnonzero(np.abs(road.speed) > DRIVING_SPEED)
    clip = replace(clip, hidden=find_static_mask([grays[key] for key in driving], clip.camera, mounting))
    grid = _lay_grid(clip, mounting[0, :3], mounting)
    scale = measure_scale(grays, times, adjusted.poses, driven, grid, mounting[2, :3])
    T_key_next[:, :3, 3] *= scale.factor[:, None]
    metric = np.append(scale.factor, scale.factor[-1])
    aside = float(np.arccos(np.clip(mounting[0, :3] @ clip.T_rig_camera[0, :3], -1.0, 1.0)))
    evidence = Evidence(road, moves, *find_planes(tracks, adjusted, metric, ray_sigma, mounting), aside)
    doubts = tuple(find_doubts(evidence))
    log_scale_covariance = scale.covariance + (DOUBTFUL_LOG_SCALE**2 if doubts else 0.0)
    T_start_key, share = _chain(T_key_next), driven / driven.sum()
    turning = CORRELATED_TRACKS**2 * adjusted.rotation_covariance
    turning += turning_drift(float(np.median(slips)) if slips else 0.0, moves, mounting[2, :3])
    covariance = add_up_drift(T_start_key[:, :3, 3], turning, log_scale_covariance)
    sigma = float(np.sqrt(share @ log_scale_covariance @ share))
    return _Path(T_start_key, covariance, mounting, moves, sigma, doubts)


def _follow_road(clip: _Clip, grays: Sequence[Gray], seconds: Array) -> RoadSpeed:
    if not any(step.moves for step in clip.key_steps):
        still = np.zeros(len(clip.key_steps))
        return RoadSpeed(still, still, still, 0.0, 0.0, 0.0)
    travel = usual_direction(clip.key_steps, clip.T_rig_camera[0, :3])
    # What stays in the picture is told from the road by its votes: a vehicle that stands sees the road stay too.
    grid = _lay_grid(replace(clip, hidden=np.zeros_like(clip.hidden)), travel, clip.T_rig_camera)
    return follow_road(grays, seconds, clip.key_steps, grid, travel, clip.T_rig_camera[2, :3])


def _settle(clip: _Clip, step: Step, driven: float, mounting: Array) -> Step:
    """The step once it is known how far it goes, with only those points that then can stand still."""
    if not step.moves or driven == 0.0:
        agrees = step.motion.inliers
        turn = turn_between(step.rays_key[agrees], step.rays_current[agrees]) if step.moves else step.motion.R_b_a
        return replace(step, moves=False, motion=TwoViewMotion(turn, np.zeros(3), agrees))
    sigma = TRACK_SIGMA_PIXELS * radians_per_pixel(clip.camera)
    direction = np.sign(driven) * ahead([step], mounting[0, :3])[0]
    motion = replace(step.motion, direction_a=direction)
    if slip_angle(step, driven, mounting) > LARGEST_SLIP:
        guesses = [motion.R_b_a, np.eye(3)]
        motion = fit_rolling_step(step.rays_key, step.rays_current, driven, mounting, guesses, sigma)
    # What then would lie behind the camera moves by itself.
    stands = motion.inliers & (parallax_forward(motion, step.rays_key, step.rays_current) > -2.0 * sigma)
    points, rays_key, rays_current = step.points[stands], step.rays_key[stands], step.rays_current[stands]
    motion = replace(motion, inliers=np.ones(len(points), np.bool_))
    return replace(step, motion=motion, points=points, rays_key=rays_key, rays_current=rays_current)


def _lay_grid(clip: _Clip, forward: Array, T_rig_camera: Array) -> RoadGrid:
    axes = road_frame(forward, T_rig_camera[2, :3], forward)
    return RoadGrid(clip.camera, float(T_rig_camera[2, 3]), axes, clip.hidden)


def _adjust(clip: _Clip, driven: Array, tracks: FeatureTracks, ray_sigma: float, rounds: int) -> AdjustedPoses:
    """Keyframe poses that agree best with all tracks."""
    moves = np.array([step.moves for step in clip.key_steps])
    priors = StepPriors(
        _expect(clip, driven),
        np.where(moves, PRIOR_ROTATION, STANDING_ROTATION),
        np.where(moves, PRIOR_SPEED_SHARE * driven, 0.0) + STANDING_METRES,
        np.where(moves, PRIOR_DIRECTION * driven, 0.0) + STANDING_METRES,
    )
    return adjust_poses(_chain(priors.T_key_next), tracks, ray_sigma, priors, rounds)


def _expect(clip: _Clip, driven: Array) -> Array:
    """Motion (k, 4, 4) from keyframe to keyframe as each step tells it."""
    directions = np.array([step.motion.direction_a for step in clip.key_steps])
    return make_pose([step.motion.R_b_a.T for step in clip.key_steps], driven[:, None] * directions)


def _collect_tracks(clip: _Clip) -> FeatureTracks:
    """What the keyframes have seen of the points that agree with the motion of their steps."""
    steps = clip.key_steps
    number = {frame: index for index, frame in enumerate(clip.keyframes)}
    start = np.repeat([number[step.key] for step in steps], [len(step.points) for step in steps])
    rays_key = np.concatenate([step.rays_key for step in steps])
    rays_current = np.concatenate([step.rays_current for step in steps])
    # Steps come in the order of time, so the first time that a point is seen is its anchor.
    seen = np.concatenate([step.points for step in steps])
    _, first, point, count = np.unique(seen, return_index=True, return_inverse=True, return_counts=True)
    # A point seen twice agrees with any motion along its epipolar line, and so adds little but work.
    lasting = count >= LEAST_OBSERVATIONS
    kept = lasting[point]
    number_of = np.cumsum(lasting) - 1
    first = first[lasting]
    return FeatureTracks(start[first], rays_key[first], number_of[point[kept]], start[kept] + 1, rays_current[kept])


def _in_rig_axes(covariance: Array, mounting: Array, key_times: Array, times: Array) -> Array:
    """Covariance (n, 6, 6) at all times of poses known at some, turned from the axes of the camera to those of the rig."""
    index = np.clip(np.searchsorted(key_times, times) - 1, 0, len(key_times) - 2)
    share = ((times - key_times[index]) / (key_times[index + 1] - key_times[index]))[:, None, None]
    turn = np.kron(np.eye(2), mounting[:3, :3])
    return turn @ ((1.0 - share) * covariance[index] + share * covariance[index + 1]) @ turn.T


def _align_mounting(T_key_next: Array, speed: Array, T_rig_camera: Array) -> Array:
    """Mounting with the pitch and yaw for which the rig origin moves along rig x.

    The rear axle does not slip sideways, so the rig origin, which lies at q in the camera, moves straight ahead by
    d + (R - I) q where the camera moves by d and turns by R. Only the faster half of the speeds is asked.
    """
    fast = (speed > 0.0) & (speed >= 0.5 * speed.max())
    if not fast.any():
        return T_rig_camera
    origin = invert(T_rig_camera)[:3, 3]
    moved = T_key_next[fast, :3, 3] + (T_key_next[fast, :3, :3] - np.eye(3)) @ origin
    moved *= np.sign(moved[:, 2:]) / np.linalg.norm(moved, axis=1, keepdims=True)
    return _turn_ahead(T_rig_camera, np.median(moved, axis=0))


def _turn_ahead(T_rig_camera: Array, forward: Array) -> Array:
    """The mounting with its pitch and yaw such that `forward` (3,) in camera axes is rig x."""
    roll = Rotation.from_matrix(T_rig_camera[:3, :3] @ R_FORWARD_CAMERA.T).as_euler("ZYX")[2]
    return aim_camera(T_rig_camera[:3, 3], float(roll), forward)


def _chain(T_key_next: Array) -> Array:
    """Poses (n, 4, 4) in the axes of the first one, of the motions (n - 1, 4, 4) between them."""
    poses = [np.eye(4)]
    for motion in T_key_next:
        poses.append(poses[-1] @ motion)
    return np.stack(poses)
