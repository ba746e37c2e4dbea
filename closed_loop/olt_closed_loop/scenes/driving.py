"""How a careful human drives along a road: a smooth path, and a speed that fits its bends and the event ahead."""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import BPoly, CubicSpline
from scipy.ndimage import gaussian_filter1d

from olt_closed_loop.scenes.polylines import arc_lengths
from olt_closed_loop.scenes.roads import Road
from olt_generator.poses import Array, planar_pose
from olt_generator.trajectory import Trajectory

SAMPLE_US = 20_000

# Comfort values below the hard limits (3 lateral, -4 to 2 longitudinal), so that smoothing cannot break those.
_LATERAL = 2.0
_FORWARD = 1.2
_BRAKING = 2.2
_PATH_STEP = 0.25
_SPEED_SMOOTHING = 4.0

Knots = tuple[tuple[float, float], ...]
"""(station, offset) of a path, sorted; between two knots it moves over smoothly."""
Limits = tuple[tuple[float, float, float], ...]
"""(from station, to station, speed) of stretches with a lower speed."""


@dataclass(frozen=True)
class EgoMotion:
    """How the ego drove: its trajectory, and the stations (n,) of its rig origin in metres."""

    trajectory: Trajectory
    stations: Array

    @property
    def duration_us(self) -> int:
        """Time of the last pose, microseconds."""
        return int(self.trajectory.timestamps_us[-1])

    def time_at(self, station: float) -> float:
        """Seconds from the start until the rig origin passes `station`; the end if it does not come so far."""
        return float(np.interp(station, self.stations, self.trajectory.times))

    def station_at(self, times: Array) -> Array:
        """Stations (n,) of the rig origin at seconds (n,)."""
        return np.interp(times, self.trajectory.times, self.stations)


def offset_profile(knots: Knots, start_slope: float = 0.0) -> BPoly:
    """Offset by station: quintic pieces without bend at the knots, and without slope at all but the first."""
    stations, offsets = np.array(knots).T
    slopes = np.zeros_like(offsets)
    slopes[0] = start_slope
    return BPoly.from_derivatives(stations, np.stack([offsets, slopes, np.zeros_like(offsets)], axis=-1))


def drive(road: Road, profile: BPoly, cruise: float, limits: Limits, duration_us: int) -> EgoMotion:
    """Drive for `duration_us` from the start of an `offset_profile`; the rig origin follows the path, tangent to it.

    The speed is `cruise` m/s where neither bends nor `limits` ask for less.
    """
    stations = np.arange(profile.x[0], profile.x[-1], _PATH_STEP)
    points = road.locate(stations, profile(stations))
    arc = arc_lengths(points)
    path = CubicSpline(arc, points)
    tangent, bend = path(arc, 1), path(arc, 2)
    curvature = np.abs(tangent[:, 0] * bend[:, 1] - tangent[:, 1] * bend[:, 0])
    # The speed of each place, reached with the comfortable accelerations, by path length.
    limit = np.minimum(cruise, np.sqrt(_LATERAL / np.maximum(curvature, 1e-4)))
    for start, end, speed in limits:
        limit = np.where((stations >= start) & (stations <= end), np.minimum(limit, speed), limit)
    squared, steps = limit**2, np.diff(arc)
    for i in range(1, len(arc)):
        squared[i] = min(squared[i], squared[i - 1] + 2.0 * _FORWARD * steps[i - 1])
    for i in range(len(arc) - 2, -1, -1):
        squared[i] = min(squared[i], squared[i + 1] + 2.0 * _BRAKING * steps[i])
    speeds = gaussian_filter1d(np.sqrt(squared), _SPEED_SMOOTHING / _PATH_STEP, mode="nearest")

    elapsed = cumulative_trapezoid(1.0 / speeds, arc, initial=0.0)
    timestamps_us = np.arange(0, duration_us + 1, SAMPLE_US, dtype=np.int64)
    driven = CubicSpline(elapsed, arc)(timestamps_us * 1e-6)
    (x, y), tangent = path(driven).T, path(driven, 1)
    poses = planar_pose(x, y, np.arctan2(tangent[:, 1], tangent[:, 0]))
    return EgoMotion(Trajectory(timestamps_us, poses), np.interp(driven, arc, stations))


def drive_at_speed(road: Road, offset: float, start: float, times: Array, speeds: Array) -> EgoMotion:
    """Drive along a constant offset from station `start` with speeds (n,) m/s at times (n,) s, straight between them.

    Negative speeds drive backwards. The rig origin follows the path, tangent to it, for as long as the times reach.
    """
    timestamps_us = np.arange(0, round(times[-1] * 1e6) + 1, SAMPLE_US, dtype=np.int64)
    speed = np.interp(timestamps_us * 1e-6, times, speeds)
    stations = np.arange(0.0, road.length, _PATH_STEP)
    points = road.locate(stations, np.full_like(stations, offset))
    arc = arc_lengths(points)
    path = CubicSpline(arc, points)
    driven = np.interp(start, stations, arc) + cumulative_trapezoid(speed, timestamps_us * 1e-6, initial=0.0)
    (x, y), tangent = path(driven).T, path(driven, 1)
    poses = planar_pose(x, y, np.arctan2(tangent[:, 1], tangent[:, 0]))
    return EgoMotion(Trajectory(timestamps_us, poses), np.interp(driven, arc, stations))
