"""The path of a camera over the keyframes of a clip, from its steps, the road and all tracks together.

In order: the road tells how far each step goes, and whether forward; points that cannot stand still then are dropped;
keyframes are adjusted together to the tracks that are left; the road gives the scale; and what was found by each of
these is held against the others.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from olt_generator.cameras import Camera
from olt_generator.doubts import Doubt
from olt_generator.motion.bundle_adjustment import AdjustedPoses, StepPriors, adjust_poses
from olt_generator.motion.evidence import DOUBTFUL_LOG_SCALE, Evidence, doubt_standstill, find_doubts
from olt_generator.motion.features import Gray
from olt_generator.motion.mounting import align_mounting
from olt_generator.motion.path_covariance import CORRELATED_TRACKS, UNSEEN_SPEED, add_up_drift, roll_on, turning_drift
from olt_generator.motion.road_following import ahead, follow_road, usual_direction
from olt_generator.motion.road_grid import RoadGrid, road_frame
from olt_generator.motion.road_plane import PlaneScale, measure_scale
from olt_generator.motion.road_speed import LEAST_LOG_ODDS, RoadSpeed
from olt_generator.motion.road_structure import find_planes
from olt_generator.motion.road_turn import measure_turn
from olt_generator.motion.rolling_step import fit_rolling_step, roll_step, rolling_direction, slip_angle, straighten
from olt_generator.motion.static_mask import find_static_mask
from olt_generator.motion.steps import (
    TRACK_SIGMA_PIXELS,
    Step,
    look_again,
    radians_per_pixel,
    speaks_against_standstill,
)
from olt_generator.motion.track_equations import FeatureTracks
from olt_generator.motion.two_view import TwoViewMotion, parallax_forward
from olt_generator.poses import R_FORWARD_CAMERA, Array, aim_camera, invert, make_pose

# Keyframes after its first in which a point must be seen.
LEAST_OBSERVATIONS = 2
# Slower than this is standstill, m/s; faster than that the road moves in the picture.
STANDSTILL_SPEED = 0.05
# Slower than this no point moves by pixels between keyframes, m/s.
CRAWLING_SPEED = 0.3
DRIVING_SPEED = 1.0
# A step farther than this from what a vehicle can do that rolls is found again as a step of such a vehicle, radians.
LARGEST_SLIP = np.radians(1.5)
# A step that slips by more than this is held against the road, whose word counts from such a difference on, radians.
SUSPICIOUS_SLIP = np.radians(0.3)
SMALLEST_TURN = np.radians(0.12)
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
class KeyframeSteps:
    """What is known of a clip once every step between its keyframes has been found on its own.

    Attributes:
        grays: k keyframes.
        times: (k,) seconds.
        steps: k - 1 steps between them.
        camera: model of the camera at the size of the keyframes.
        T_rig_camera: (4, 4) rough mounting.
    """

    grays: Sequence[Gray]
    times: Array
    steps: Sequence[Step]
    camera: Camera
    T_rig_camera: Array

    @property
    def ray_sigma(self) -> float:
        """Angular noise of a ray, radians."""
        return TRACK_SIGMA_PIXELS * radians_per_pixel(self.camera)


@dataclass(frozen=True)
class KeyframePath:
    """What was recovered of the keyframes.

    Attributes:
        T_start_key: (k, 4, 4) poses in the axes of the first one.
        covariance: (k, 6, 6) of their errors (`PoseEstimate.covariance`), in the same axes.
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


def recover_path(clip: KeyframeSteps, rounds: int) -> KeyframePath:
    """The motion of the keyframes, adjusted together in so many rounds at most.

    Raises:
        InputError: no road is in view.
    """
    seconds = np.diff(clip.times)
    road = _follow(clip, seconds)
    clip = replace(clip, steps=_look_past_fixed(clip, road))
    driven = np.where(np.abs(road.speed) < STANDSTILL_SPEED, 0.0, road.speed * seconds)
    straight = [straighten(*pair, clip.T_rig_camera) for pair in zip(clip.steps, driven, strict=True) if pair[1] != 0.0]
    usual = _turn_ahead(clip.T_rig_camera, usual_direction(straight, clip.T_rig_camera[0, :3]))
    turned = list(_turn_with_road(clip, driven, usual))
    slip = _usual_slip(turned, driven, usual)
    against_standstill = _against_standstill(clip, road)
    clip = replace(clip, steps=[_settle(clip, *pair, usual) for pair in zip(turned, driven, strict=True)])
    moves = np.array([step.moves for step in clip.steps])
    driven = np.where(moves, np.abs(driven), 0.0)
    if not moves.any():
        standing = roll_on(clip.times, usual[0, :3]) + np.diag([0.0] * 3 + [PRIOR_ROTATION**2] * 3)
        doubts = tuple(doubt_standstill(against_standstill))
        return KeyframePath(_chain(_expect(clip.steps, driven)), standing, clip.T_rig_camera, moves, None, doubts)
    tracks = _collect_tracks(clip.steps)
    adjusted = _adjust(clip, driven, tracks, rounds)
    aligned = align_mounting(adjusted.poses, usual)
    mounting = usual if aligned is None else aligned
    scale = _measure_scale(clip, road, driven, adjusted, mounting)
    evidence = _gather(clip, road, tracks, adjusted, scale, mounting)
    doubts = (*find_doubts(evidence), *doubt_standstill(against_standstill))
    T_key_next = invert(adjusted.poses[:-1]) @ adjusted.poses[1:]
    T_key_next[:, :3, 3] *= scale.factor[:, None]
    T_start_key = _chain(T_key_next)
    turning = CORRELATED_TRACKS**2 * adjusted.rotation_covariance + turning_drift(slip, moves, mounting[2, :3])
    share = driven / driven.sum()
    # What all steps have in common is the scale's; what is left of each bends the path.
    apart = np.eye(len(share)) - share
    stretched = apart @ scale.covariance @ apart.T
    unseen = UNSEEN_SPEED * seconds.sum() / driven.sum()
    doubtful = DOUBTFUL_LOG_SCALE if doubts else 0.0
    return KeyframePath(
        T_start_key,
        add_up_drift(T_start_key[:, :3, 3], turning, stretched),
        mounting,
        moves,
        float(np.sqrt(share @ scale.covariance @ share + unseen**2 + doubtful**2)),
        doubts,
    )


def _follow(clip: KeyframeSteps, seconds: Array) -> RoadSpeed:
    travel = usual_direction(clip.steps, clip.T_rig_camera[0, :3])
    # What stays in the picture is told from the road by its votes: a vehicle that stands sees the road stay too.
    grid = _lay_grid(clip.camera, travel, clip.T_rig_camera)
    return follow_road(clip.grays, seconds, clip.steps, grid, travel, clip.T_rig_camera[2, :3])


def _turn_with_road(clip: KeyframeSteps, driven: Array, mounting: Array) -> Iterator[Step]:
    """The steps, those that slip with the turn that the road tells and the points that agree with it."""
    grid = _lay_grid(clip.camera, mounting[0, :3], mounting)
    for key, (step, metres) in enumerate(zip(clip.steps, driven, strict=True)):
        if not step.moves or abs(metres) < LEAST_TO_SLIP or slip_angle(step, metres, mounting) < SUSPICIOUS_SLIP:
            yield step
            continue
        R, up = step.motion.R_b_a, mounting[2, :3]
        axes = road_frame(mounting[0, :3], up, rolling_direction(R, abs(metres), mounting))
        first = grid.rectify(clip.grays[key], axes)
        second = grid.rectify(clip.grays[key + 1], axes.rotated(R))
        turn = measure_turn(first, second, grid, metres)
        if turn is None or abs(turn) < SMALLEST_TURN:
            yield step
            continue
        R = Rotation.from_rotvec(-turn * (R @ up)).as_matrix() @ R
        yield replace(step, motion=roll_step(step.rays_key, step.rays_current, R, metres, mounting, clip.ray_sigma))


def _look_past_fixed(clip: KeyframeSteps, road: RoadSpeed) -> list[Step]:
    """The steps without points on what stays in the picture while the road says that the vehicle drives."""
    hidden = _find_fixed(clip, road, clip.T_rig_camera)
    return [look_again(step, hidden, clip.camera, clip.T_rig_camera[2, :3]) for step in clip.steps]


def _find_fixed(clip: KeyframeSteps, road: RoadSpeed, mounting: Array) -> NDArray[np.bool_]:
    driving = np.flatnonzero(np.abs(road.speed) > DRIVING_SPEED).tolist()
    return find_static_mask([clip.grays[key] for key in driving], clip.camera, mounting)


def _usual_slip(steps: Sequence[Step], driven: Array, mounting: Array) -> float:
    """Median angle in radians between the directions of steps and those of a vehicle that rolls."""
    pairs = [pair for pair in zip(steps, driven, strict=True) if abs(pair[1]) > LEAST_TO_SLIP and pair[0].moves]
    return float(np.median([slip_angle(*pair, mounting) for pair in pairs])) if pairs else 0.0


def _against_standstill(clip: KeyframeSteps, road: RoadSpeed) -> float:
    """Share of the steps in which the vehicle stands only for want of road, or while what cannot move then does."""
    against, up = 0, clip.T_rig_camera[2, :3]
    for step, speed, told in zip(clip.steps, road.speed, road.log_odds, strict=True):
        if abs(speed) < CRAWLING_SPEED or not step.moves:
            untold = step.moves and told < LEAST_LOG_ODDS
            against += untold or speaks_against_standstill(step, clip.camera, up)
    return against / len(clip.steps)


def _settle(clip: KeyframeSteps, step: Step, driven: float, mounting: Array) -> Step:
    """The step once it is known how far it goes, with only those points that then can stand still."""
    if not step.moves:
        return step
    if driven == 0.0:
        # A vehicle that stands does not turn, whatever drives past it.
        return replace(step, moves=False, motion=TwoViewMotion(np.eye(3), np.zeros(3), step.motion.inliers))
    sigma = clip.ray_sigma
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


def _lay_grid(camera: Camera, forward: Array, T_rig_camera: Array, hidden: NDArray[np.bool_] | None = None) -> RoadGrid:
    hidden = np.zeros((camera.height, camera.width), np.bool_) if hidden is None else hidden
    axes = road_frame(forward, T_rig_camera[2, :3], forward)
    return RoadGrid(camera, float(T_rig_camera[2, 3]), axes, hidden)


def _adjust(clip: KeyframeSteps, driven: Array, tracks: FeatureTracks, rounds: int) -> AdjustedPoses:
    """Keyframe poses that agree best with all tracks."""
    moves = np.array([step.moves for step in clip.steps])
    priors = StepPriors(
        _expect(clip.steps, driven),
        np.where(moves, PRIOR_ROTATION, STANDING_ROTATION),
        np.where(moves, PRIOR_SPEED_SHARE * driven, 0.0) + STANDING_METRES,
        np.where(moves, PRIOR_DIRECTION * driven, 0.0) + STANDING_METRES,
    )
    return adjust_poses(_chain(priors.T_key_next), tracks, clip.ray_sigma, priors, rounds)


def _expect(steps: Sequence[Step], driven: Array) -> Array:
    """Motion (k, 4, 4) from keyframe to keyframe as each step tells it."""
    directions = np.array([step.motion.direction_a for step in steps])
    return make_pose([step.motion.R_b_a.T for step in steps], driven[:, None] * directions)


def _collect_tracks(steps: Sequence[Step]) -> FeatureTracks:
    """What the keyframes have seen of the points that agree with the motion of their steps."""
    start = np.repeat(np.arange(len(steps)), [len(step.points) for step in steps])
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


def _measure_scale(
    clip: KeyframeSteps, road: RoadSpeed, driven: Array, adjusted: AdjustedPoses, mounting: Array
) -> PlaneScale:
    grid = _lay_grid(clip.camera, mounting[0, :3], mounting, _find_fixed(clip, road, mounting))
    return measure_scale(clip.grays, clip.times, adjusted.poses, driven, grid, mounting[2, :3])


def _gather(
    clip: KeyframeSteps,
    road: RoadSpeed,
    tracks: FeatureTracks,
    adjusted: AdjustedPoses,
    scale: PlaneScale,
    mounting: Array,
) -> Evidence:
    moves = np.array([step.moves for step in clip.steps])
    metric = np.append(scale.factor, scale.factor[-1])
    below, above = find_planes(tracks, adjusted, metric, clip.ray_sigma, mounting)
    aside = float(np.arccos(np.clip(mounting[0, :3] @ clip.T_rig_camera[0, :3], -1.0, 1.0)))
    return Evidence(road, moves, below, above, aside)


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
