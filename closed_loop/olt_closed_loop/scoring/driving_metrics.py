"""How a drive went beside its score: speed, comfort, and how near it came to others.

Speed and comfort are finite differences of the poses after the hand-over, nothing is smoothed. A drive is comfortable
when it keeps the limits of nuPlan's comfort metric (Karnchanachari et al., Towards learning-based planning: the nuPlan
benchmark for real-world autonomous driving, 2024).
"""

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import KDTree

from olt_closed_loop.rollouts.rollout_record import RolloutRecord
from olt_closed_loop.scenes.actors import corners
from olt_closed_loop.scoring.drivable import LANE_WIDTH, lane_area, lanes_within
from olt_closed_loop.scoring.moving_boxes import MovingBox, separations
from olt_generator.poses import Array

FASTEST_ACCELERATION, HARDEST_BRAKING, LATERAL_ACCELERATION = 2.40, -4.05, 4.89
YAW_RATE, YAW_ACCELERATION, LONGITUDINAL_JERK, JERK = 0.95, 1.93, 4.13, 8.37
"""Limits of comfort: m/s^2, rad/s, rad/s^2, m/s^3."""
COLLISION_HORIZON = 10.0
"""Seconds up to which the time to a collision is looked for."""
WRONG_WAY = np.deg2rad(120.0)


def measure_driving(
    record: RolloutRecord, ego: MovingBox, others: Sequence[MovingBox]
) -> dict[str, float | bool | None]:
    """Figures of a drive that has two samples or more from the hand-over on; None is "not measured".

    Args:
        record: the drive.
        ego: its box.
        others: boxes of the agents.

    Returns:
        distance_m: driven.
        reversed_m: of it, against the ego's heading.
        mean_speed, max_speed: m/s.
        min_acceleration, max_acceleration: along the ego, m/s^2.
        max_lateral_acceleration: m/s^2.
        max_jerk: m/s^3.
        max_yaw_rate: rad/s.
        comfortable: whether all limits of comfort are kept.
        min_time_to_collision: seconds to the next contact if everybody kept velocity and heading; 0 in a contact, 10
            for 10 or more.
        min_distance_to_agents_m: between boxes, heights included; None when nobody was there.
        wrong_way: whether the ego was on lanes of which all run more than 120 degrees from its yaw; None without lanes.
    """
    driven = record.timestamps_us >= record.handover_us
    times, poses = record.timestamps_us[driven], record.poses[driven]
    seconds, positions, yaws = (times - times[0]) * 1e-6, poses[:, :2], np.unwrap(poses[:, 3])
    ways, spans = np.diff(positions, axis=0), np.diff(seconds)
    steps, middle = np.linalg.norm(ways, axis=1), 0.5 * (yaws[1:] + yaws[:-1])
    ahead = ways[:, 0] * np.cos(middle) + ways[:, 1] * np.sin(middle)
    yaw_rates = np.diff(yaws) / spans
    distance, time_to_collision = _nearness(ego, others, times)
    return {
        "distance_m": float(steps.sum()),
        "reversed_m": float(np.maximum(-ahead, 0.0).sum()),
        "mean_speed": float(steps.sum() / seconds[-1]),
        "max_speed": float((steps / spans).max()),
        "max_yaw_rate": float(np.abs(yaw_rates).max()),
        **_comfort(seconds, positions, yaws, yaw_rates),
        "min_time_to_collision": time_to_collision,
        "min_distance_to_agents_m": distance,
        "wrong_way": _drives_wrong_way(record, ego, times) if record.lanes else None,
    }


def _comfort(seconds: Array, positions: Array, yaws: Array, yaw_rates: Array) -> dict[str, float | bool | None]:
    """Accelerations from three samples each, jerks from four; None with fewer than four samples."""
    names = ("min_acceleration", "max_acceleration", "max_lateral_acceleration", "max_jerk")
    if len(seconds) < 4:
        return dict.fromkeys((*names, "comfortable"))
    velocity, middles = _slopes(positions, seconds)
    acceleration, _ = _slopes(velocity, middles)
    heading = np.stack([np.cos(yaws[1:-1]), np.sin(yaws[1:-1])], axis=-1)
    along = (acceleration * heading).sum(axis=1)
    aside = np.abs(acceleration[:, 1] * heading[:, 0] - acceleration[:, 0] * heading[:, 1])
    jerk = np.linalg.norm(_slopes(acceleration, seconds[1:-1])[0], axis=1)
    comfortable = bool(
        along.min() >= HARDEST_BRAKING
        and along.max() <= FASTEST_ACCELERATION
        and aside.max() <= LATERAL_ACCELERATION
        and jerk.max() <= JERK
        and np.abs(_slopes(along, seconds[1:-1])[0]).max() <= LONGITUDINAL_JERK
        and np.abs(yaw_rates).max() <= YAW_RATE
        and np.abs(_slopes(yaw_rates, middles)[0]).max() <= YAW_ACCELERATION
    )
    values = (float(value) for value in (along.min(), along.max(), aside.max(), jerk.max()))
    return {**dict(zip(names, values, strict=True)), "comfortable": comfortable}


def _slopes(values: Array, seconds: Array) -> tuple[Array, Array]:
    """Slopes (n - 1, ...) of values (n, ...), and the times halfway."""
    spans = np.diff(seconds)
    return np.diff(values, axis=0) / spans.reshape(-1, *[1] * (values.ndim - 1)), seconds[:-1] + 0.5 * spans


def _nearness(ego: MovingBox, others: Sequence[MovingBox], times: NDArray[np.int64]) -> tuple[float | None, float]:
    """Smallest distance to anybody and smallest time to a collision at the times (n,)."""
    own, own_velocity = ego.at(times), _velocities(ego, times)
    pairs = [
        (own[there], box.at(times[there]), _velocities(box, times[there]) - own_velocity[there], box.half_size)
        for box, there in ((box, box.covers(times)) for box in others)
        if there.any()
    ]
    if not pairs:
        return None, COLLISION_HORIZON
    ours, theirs, velocities = (np.concatenate([pair[part] for pair in pairs]) for part in range(3))
    halves = np.repeat([pair[3] for pair in pairs], [len(pair[0]) for pair in pairs], axis=0)
    gaps, offsets = separations(ours, ego.half_size, theirs, halves)
    ahead, aside = velocities[:, 0], velocities[:, 1]
    turned = [
        part
        for cos, sin in ((np.cos(yaws), np.sin(yaws)) for yaws in (ours[:, 3], theirs[:, 3]))
        for part in (cos * ahead + sin * aside, cos * aside - sin * ahead)
    ]
    ttc = times_to_collision(gaps, offsets, np.stack([*turned, velocities[:, 2]], axis=-1))
    lowest = gaps.max(axis=1)
    # The largest gap is at most the distance, so only pairs below the nearest one's distance can be the nearest.
    best = box_distances(ours, ego.half_size, theirs, halves, at=np.array([int(np.argmin(lowest))]))[0]
    close = np.flatnonzero(lowest <= best)
    distances = box_distances(ours, ego.half_size, theirs, halves, at=close)
    return float(min(best, distances.min(initial=best))), float(min(ttc.min(), COLLISION_HORIZON))


def _velocities(box: MovingBox, times: NDArray[np.int64]) -> Array:
    """Velocities (n, 3) in m/s of the centre on the pieces that end at the times (n,), or that a box begins with."""
    if len(box.timestamps_us) == 1:
        return np.zeros((len(times), 3))
    velocity = np.diff(box.poses[:, :3], axis=0) / (np.diff(box.timestamps_us) * 1e-6)[:, None]
    piece = np.clip(np.searchsorted(box.timestamps_us, times) - 1, 0, len(velocity) - 1)
    return velocity[piece]


def times_to_collision(gaps: Array, offsets: Array, speeds: Array) -> Array:
    """Seconds (n,) until boxes touch that keep their velocities and headings; infinite where they never do.

    Args:
        gaps, offsets: along the separating axes, as `separations` gives them, (n, 5).
        speeds: of the other relative to the ego along these axes, (n, 5), m/s.
    """
    sizes = np.abs(offsets) - gaps
    with np.errstate(divide="ignore", invalid="ignore"):
        enter, leave = np.sort(np.stack([(-sizes - offsets) / speeds, (sizes - offsets) / speeds]), axis=0)
    still = speeds == 0.0
    enter = np.where(still, np.where(gaps < 0.0, -np.inf, np.inf), enter).max(axis=1)
    leave = np.where(still, np.where(gaps < 0.0, np.inf, -np.inf), leave).min(axis=1)
    return np.where((enter <= leave) & (leave >= 0.0), np.maximum(enter, 0.0), np.inf)


def box_distances(ours: Array, our_half: Array, theirs: Array, their_halves: Array, at: NDArray[np.int64]) -> Array:
    """Distances (k,) in metres between boxes, heights included, of the pairs `at` (k,).

    Poses are (n, 4), as in `MovingBox`; half sizes (3,) of the one and (n, 3) of the others, metres.
    """
    origin = ours[at, :2][:, None]
    first, second = (
        np.asarray(shapely.polygons(corners(poses[at], half) - origin))
        for poses, half in ((ours, our_half), (theirs, their_halves[at]))
    )
    vertical = np.abs(theirs[at, 2] - ours[at, 2]) - our_half[2] - their_halves[at, 2]
    return np.hypot(shapely.distance(first, second), np.maximum(vertical, 0.0))


def _drives_wrong_way(record: RolloutRecord, ego: MovingBox, times: NDArray[np.int64]) -> bool:
    poses = ego.at(times)
    origin = poses[0, :2]
    centers = poses[:, :2] - origin
    near = lanes_within(record.lanes, poses[:, :2], LANE_WIDTH)
    areas = [shapely.make_valid(lane_area(lane, origin)) for lane in near]
    samples, lanes = shapely.STRtree(areas).query(shapely.points(centers), predicate="within")
    proper = np.zeros(len(times), dtype=bool)
    for lane in np.unique(lanes):
        inside = samples[lanes == lane]
        line = near[lane].center[:, :2] - origin
        _, nearest = KDTree(line).query(centers[inside])
        ahead = line[np.minimum(nearest + 1, len(line) - 1)] - line[np.maximum(nearest - 1, 0)]
        turn = np.angle(np.exp(1j * (np.arctan2(ahead[:, 1], ahead[:, 0]) - poses[inside, 3])))
        proper[inside[np.abs(turn) <= WRONG_WAY]] = True
    return bool((~proper[samples]).any())
