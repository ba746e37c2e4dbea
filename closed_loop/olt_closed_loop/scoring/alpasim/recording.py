"""Where the ego is along, and how far it is from, the recorded drive."""

import numpy as np
import shapely

from olt_closed_loop.scoring.alpasim.series import MetricSeries, UnmeasuredError
from olt_closed_loop.scoring.alpasim.surroundings import Surroundings
from olt_closed_loop.scoring.alpasim.tracks import ego_track
from olt_generator.poses import Array

UNCOMPUTED = 2
"""The first samples, at which nothing is computed and fixed values stand instead."""
MAX_PATH_DISTANCE = 4.0
"""Metres from the recorded path at which the drive ends and, beside it, the corridor is left."""
_AT_END = 1e-9


def measure_along_recording(surroundings: Surroundings) -> dict[str, MetricSeries]:
    """Progress along the recorded path, distances to it, and lengths.

    Raises:
        UnmeasuredError: the recording does not cover the drive or is a single pose, or the drive has under 3 samples.
    """
    record = surroundings.record
    times = record.timestamps_us
    recorded = ego_track(record.recorded_us, record.recorded_poses, record.box)
    if len(recorded.times_us) < 2 or len(times) <= UNCOMPUTED:
        raise UnmeasuredError("progress needs two recorded poses and three samples")
    path, driven = (shapely.linestrings(track.positions) for track in (recorded, surroundings.ego))
    shapely.prepare(path)
    along, _ = recorded.at(times)
    centers = surroundings.ego_centers[UNCOMPUTED:]

    progress = shapely.line_locate_point(path, centers, normalized=True)
    progress = np.concatenate([np.linspace(0.0, progress[0], 3)[:UNCOMPUTED], progress])
    # For each computed sample the line through the recorded positions up to then.
    counts = np.arange(UNCOMPUTED + 1, len(along) + 1)
    points = np.concatenate([along[:count] for count in counts])
    paths_so_far = shapely.linestrings(points, indices=np.repeat(np.arange(len(counts)), counts))
    so_far = shapely.line_locate_point(paths_so_far, centers, normalized=True)
    to_path = shapely.distance(path, centers)
    to_location = shapely.distance(shapely.points(along[UNCOMPUTED:]), centers)
    distance = shapely.line_locate_point(driven, centers)
    return {
        "progress": MetricSeries(times, progress, "last"),
        "progress_rel_to_total": MetricSeries(times, progress, "last"),
        "progress_rel": MetricSeries(times, _behind(1.0, so_far), "min"),
        "dist_to_gt_trajectory": MetricSeries(times, _behind(0.0, to_path), "max"),
        "dist_to_gt_location": MetricSeries(times, _behind(0.0, to_location), "max"),
        "dist_traveled_m": MetricSeries(times, _behind(0.0, distance), "last"),
        "gt_dist_traveled_m": MetricSeries(times, np.full(len(times), shapely.length(path)), "last"),
    }


def measure_corridor(surroundings: Surroundings) -> dict[str, MetricSeries]:
    """What `challenge-2026-09` measures along the recording: besides all of the above, whether the ego left sideways.

    Its `progress_rel_to_total` is a share of what the recording reached at the last scored time, and may exceed 1.

    Raises:
        UnmeasuredError: see `measure_along_recording`.
    """
    along = measure_along_recording(surroundings)
    record, progress = surroundings.record, along["progress"]
    recorded = ego_track(record.recorded_us, record.recorded_poses, record.box)
    path = shapely.linestrings(recorded.positions)
    last, _ = recorded.at(record.timestamps_us[-1:])
    reachable = float(shapely.line_locate_point(path, shapely.points(last[0])))
    scale = float(shapely.length(path)) / reachable if reachable > 0.0 else 1.0
    centers = shapely.get_coordinates(surroundings.ego_centers[UNCOMPUTED:])
    lateral = _behind(0.0, lateral_distances(recorded.positions.astype(np.float64), centers))
    left = (lateral >= MAX_PATH_DISTANCE).astype(np.float64)
    return along | {
        "progress_rel_to_total": MetricSeries(progress.times_us, progress.values * scale, "last"),
        "lateral_dist_to_gt_trajectory": MetricSeries(progress.times_us, lateral, "max"),
        "left_corridor_laterally": MetricSeries(progress.times_us, left, "max"),
    }


def lateral_distances(path: Array, points: Array) -> Array:
    """Metres (n,) of points (n, 2) beside a path (m, 2): driving on past its end is not beside it.

    Up to the end of the path it is the distance to it; beyond, only the part across its last segment. A path without
    length or whose last segment has none leaves the plain distance.
    """
    line, places = shapely.linestrings(path), shapely.points(points)
    distances = np.asarray(shapely.distance(line, places))
    direction = path[-1] - path[-2]
    length, step = float(shapely.length(line)), float(np.linalg.norm(direction))
    if step == 0.0:
        return distances
    ahead, aside = direction / step
    offsets = points - path[-1]
    across = np.abs(offsets[:, 0] * aside - offsets[:, 1] * ahead)
    return np.where(shapely.line_locate_point(line, places) < length - _AT_END, distances, across)


def _behind(first: float, values: Array) -> Array:
    """Values (n,) whose first two are `first`."""
    return np.concatenate([np.full(UNCOMPUTED, first), values])
