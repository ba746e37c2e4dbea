"""How fast to drive along a path: dynamic programming over time, arc length and speed.

What agents and held lines take of the path at each time is known, so waiting, following, and going first are all found
by one search (the path-time space of Kant and Zucker, Int. J. Robot. Res. 5, 1986).
"""

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from olt_closed_loop.privileged.paths import Path
from olt_closed_loop.privileged.truth import Truth, box_of, stands
from olt_closed_loop.scoring.moving_boxes import separations
from olt_generator.poses import Array

TIME_STEP, SPEED_STEP = 0.5, 0.5
ARC_STEP = 0.5 * TIME_STEP * SPEED_STEP
"""Metres: what one step of speed more is worth over half a step of time."""
ACCELERATIONS = np.arange(-6, 3)
"""Steps of speed in a step of time, which are m/s^2."""
LATERAL = 2.0
"""Comfortable acceleration in bends, m/s^2."""
AHEAD, ASIDE = 1.5, 0.4
"""Metres that are kept from who moves: before and behind, and to the sides."""
STANDING_ROOM = 0.15
"""Metres that are kept from who stands; paths are planned with more."""
STOP_SHORT = 1.0
"""Metres between the front and a held line."""

_SAMPLE_US, _SPREAD = 100_000, 4
_SPACING = 0.5
_HIT, _TOO_FAST, _SLOW, _PUSH = 1e5, 40.0, 1.0, 0.25
_SMOOTHING = 2.5


@dataclass(frozen=True)
class Progress:
    """Arc lengths (n,) in metres along a path at times (n,) in microseconds, and whether something is in the way."""

    timestamps_us: NDArray[np.int64]
    arc: Array
    obstructed: bool


def plan_speeds(truth: Truth, path: Path, now_us: int, speed: float) -> Progress:
    """The cheapest progress along a path from its start at `speed` m/s that touches nobody."""
    times = now_us + _SAMPLE_US * np.arange((truth.end_us - now_us) // _SAMPLE_US + 1, dtype=np.int64)
    arc = np.arange(0.0, path.length, ARC_STEP)
    taken = _taken(truth, path, times)
    every = round(TIME_STEP * 1e6) // _SAMPLE_US
    layers = np.asarray(maximum_filter1d(taken, 2 * _SPREAD + 1, axis=0), dtype=bool)[::every]
    layers = layers[:, np.minimum((arc / _SPACING).round().astype(np.int64), taken.shape[1] - 1)]
    limits = np.minimum(truth.cruise, np.sqrt(LATERAL / np.maximum(path.curvature(arc), 1e-4)))
    steps, obstructed = _cheapest(layers, limits, speed, truth.cruise)
    planned = np.concatenate([[0.0], np.cumsum(0.5 * TIME_STEP * (steps[1:] + steps[:-1]))])
    layer_us = now_us + round(TIME_STEP * 1e6) * np.arange(len(steps), dtype=np.int64)
    speeds = np.interp(times, layer_us, steps)
    speeds = np.maximum(gaussian_filter1d(speeds, _SMOOTHING, mode="nearest"), 0.0)
    # The grid knows the present speed to a quarter of a metre a second.
    seconds = 1e-6 * (times - now_us)
    speeds = np.maximum(speeds + (speed - speeds[0]) * np.exp(-seconds / 0.6), 0.0)
    driven = np.concatenate([[0.0], np.cumsum(0.05 * (speeds[1:] + speeds[:-1]))])
    # Smoothing moves no standstill: what is off fades with the path.
    drift = np.interp(times, layer_us, planned) - driven
    driven = np.maximum.accumulate(driven + gaussian_filter1d(drift, 5.0, mode="nearest") * (1.0 - np.exp(-seconds)))
    return Progress(times, driven, obstructed)


def _taken(truth: Truth, path: Path, times: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which places every _SPACING metres of the path are taken at times: (times, places)."""
    places = np.arange(0.0, path.length + _SPACING, _SPACING)
    x, y, yaw = path.poses(places)
    ego = truth.box_poses(x, y, yaw)
    ego[:, 2] = 0.0
    taken = np.zeros((len(times), len(places)), dtype=bool)
    for agent in truth.agents:
        box = box_of(agent)
        room = (STANDING_ROOM, STANDING_ROOM) if stands(agent, int(times[0]), truth.end_us) else (AHEAD, ASIDE)
        half = truth.half_size + np.array([*room, 0.0])
        reach = float(np.hypot(*half[:2]))
        there = np.flatnonzero(box.covers(times))
        if len(there) == 0:
            continue
        poses = box.at(times[there])
        apart = np.hypot(ego[None, :, 0] - poses[:, None, 0], ego[None, :, 1] - poses[:, None, 1])
        when, where = np.nonzero(apart < reach + box.radius)
        gaps, _ = separations(ego[where], half, poses[when], box.half_size)
        touched = gaps[:, :4].max(axis=1) < 0.0
        taken[there[when[touched]], where[touched]] = True
    for hold in truth.holds:
        held = (times >= hold.from_us) & (times < hold.until_us)
        crossing = shapely.LineString(np.column_stack([x, y])).intersection(shapely.LineString(hold.line))
        if crossing.is_empty:
            continue
        front = truth.vehicle.rear_axle_to_bbox_center + 0.5 * truth.vehicle.length
        at = shapely.LineString(np.column_stack([x, y])).project(shapely.Point(crossing.centroid))
        beyond = (places > at - front - STOP_SHORT) & (places < at + 2.0)
        taken |= held[:, None] & beyond[None]
    return taken


def _cheapest(layers: NDArray[np.bool_], limits: Array, start: float, cruise: float) -> tuple[Array, bool]:
    """Speeds (layers,) in m/s of the cheapest drive, and whether it passes a place that is taken."""
    count, fastest = layers.shape[1], int(np.ceil(max(cruise, start) / SPEED_STEP)) + 1
    speeds = SPEED_STEP * np.arange(fastest + 1)
    standing = _SLOW * (cruise - np.minimum(speeds, cruise))
    # (speeds, places): what it costs to be there at that speed.
    too_fast = _TOO_FAST * np.maximum(speeds[:, None] - limits - 0.25, 0.0) ** 2 + standing[:, None]
    total = np.full((fastest + 1, count), np.inf)
    total[min(round(start / SPEED_STEP), fastest), 0] = 0.0
    came: list[NDArray[np.int8]] = []
    for taken in layers[1:]:
        best, action = np.full_like(total, np.inf), np.zeros(total.shape, dtype=np.int8)
        for change in ACCELERATIONS.tolist():
            push = _PUSH * change**2
            for before in range(max(0, -change), min(fastest, fastest - change) + 1):
                moved, after = 2 * before + change, before + change
                if moved >= count:
                    continue
                value = total[before, : count - moved] + push
                target = best[after, moved:]
                better = value < target
                target[better] = value[better]
                action[after, moved:][better] = change
        total = best + too_fast + _HIT * taken
        came.append(action)
    at = int(np.argmin(total))
    speed, place = np.unravel_index(at, total.shape)
    cost = float(total[speed, place])
    chosen = [int(speed)]
    for action in reversed(came):
        change = int(action[speed, place])
        speed, place = speed - change, place - (2 * speed - change)
        chosen.append(int(speed))
    return SPEED_STEP * np.array(chosen[::-1], dtype=np.float64), cost >= _HIT
