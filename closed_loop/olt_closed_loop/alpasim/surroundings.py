"""Contact with the agents: whom the ego touches at each sample, with which of its zones, and how near they come."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely

from olt_closed_loop.alpasim.series import MetricSeries
from olt_closed_loop.alpasim.tracks import Geometries, RoundedBox, Single, Track, agent_track, ego_track
from olt_closed_loop.drive_record import DriveRecord
from olt_generator.poses import Array

_SLACK = 2e-6
"""Share of the largest coordinate by which single precision may move a box."""


@dataclass(frozen=True)
class Surroundings:
    """The ego and the agents of a drive as AlpaSim sees them."""

    record: DriveRecord

    @cached_property
    def ego(self) -> Track:
        """The ego's box centre at the scored times."""
        return ego_track(self.record.timestamps_us, self.record.poses, self.record.box)

    @cached_property
    def ego_shape(self) -> RoundedBox:
        """The ego's shape."""
        return RoundedBox.of(self.record.box.length, self.record.box.width)

    @cached_property
    def ego_outlines(self) -> Geometries:
        """The ego's outline at each scored time (n,)."""
        return self.ego_shape.polygons(*self.ego.at(self.record.timestamps_us))

    @cached_property
    def ego_centers(self) -> Geometries:
        """Centroids (n,) of the ego's outlines, the points that all other metrics look at."""
        return np.asarray(shapely.centroid(self.ego_outlines))

    @cached_property
    def agents(self) -> list[tuple[RoundedBox, Track]]:
        """Shape and track of each agent."""
        return [(RoundedBox.of(agent.length, agent.width), agent_track(agent)) for agent in self.record.agents]

    @cached_property
    def agent_places(self) -> tuple[Single, Single]:
        """Positions (agents, n, 2) and yaws (agents, n) at the scored times; NaN where an agent does not exist."""
        times = self.record.timestamps_us
        positions = np.full((len(self.agents), len(times), 2), np.nan, dtype=np.float32)
        yaws = np.full((len(self.agents), len(times)), np.nan, dtype=np.float32)
        for index, (_, track) in enumerate(self.agents):
            there = track.exists(times)
            positions[index, there], yaws[index, there] = track.at(times[there])
        return positions, yaws

    @cached_property
    def distances(self) -> Array:
        """Distances (agents, n) between outlines, metres; NaN where an agent is absent or another one is nearer."""
        positions, yaws = self.agent_places
        times = self.record.timestamps_us
        centers = self.ego.at(times)[0].astype(np.float64)
        apart = np.linalg.norm(positions - centers, axis=-1)
        apart[np.isnan(apart)] = np.inf
        reach = np.array([shape.reach + self.ego_shape.reach for shape, _ in self.agents]).reshape(-1, 1)
        slack = _SLACK * max(np.abs(centers).max(), 1.0)
        # A box holds its centre, so boxes are no farther apart than centres are; whoever is farther still is left out.
        chosen = np.isfinite(apart) & (apart - reach - slack <= apart.min(axis=0, initial=np.inf))
        distances = np.full(apart.shape, np.nan)
        for index, (shape, _) in enumerate(self.agents):
            at = chosen[index]
            outlines = shape.polygons(positions[index, at], yaws[index, at])
            distances[index, at] = shapely.distance(self.ego_outlines[at], outlines)
        return distances

    def outlines_at(self, sample: int) -> Geometries:
        """Outlines (1 + k,) of the ego and of all agents that exist at a sample."""
        positions, yaws = self.agent_places
        there = np.flatnonzero(~np.isnan(yaws[:, sample]))
        others = [
            self.agents[index][0].polygons(positions[index, sample][None], yaws[index, sample][None])[0]
            for index in there
        ]
        return np.array([self.ego_outlines[sample], *others], dtype=object)


def measure_contact(surroundings: Surroundings) -> dict[str, MetricSeries]:
    """The collision metrics and the distance to the nearest agent."""
    times = surroundings.record.timestamps_us
    distances = surroundings.distances
    touching = (distances <= 0.0).any(axis=0)
    flags = np.zeros((3, len(times)))
    for sample in np.flatnonzero(touching):
        flags[_touched_zone(surroundings, int(sample)), sample] = 1.0
    nearest = np.where(np.isnan(distances), np.inf, distances).min(axis=0, initial=np.inf)
    names = ("collision_front", "collision_rear", "collision_lateral")
    return {
        **{name: MetricSeries(times, values, "max") for name, values in zip(names, flags, strict=True)},
        "collision_any": MetricSeries(times, flags.max(axis=0), "max"),
        "min_distance_to_obstacle_m": MetricSeries(times, np.where(np.isinf(nearest), np.nan, nearest), "min"),
    }


def _touched_zone(surroundings: Surroundings, sample: int) -> int:
    """0 front, 1 rear, 2 neither: the zone of the ego that is touched by the last agent that the search tree names.

    The tree orders agents by position, so with several in contact that is none in particular: a quirk that is kept.
    """
    outlines = surroundings.outlines_at(sample)
    touched = shapely.STRtree(list(outlines)).query(outlines[0], predicate="intersects")
    other = outlines[touched[touched != 0][-1]]
    place = surroundings.ego.at(surroundings.record.timestamps_us[sample : sample + 1])
    front, rear = surroundings.ego_shape.end_zones(*place)
    if shapely.intersects(other, front[0]):
        return 0
    return 1 if shapely.intersects(other, rear[0]) else 2
