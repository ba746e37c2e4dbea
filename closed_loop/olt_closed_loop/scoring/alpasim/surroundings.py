"""Contact with the agents: whom the ego touches at each sample, with which of its zones, and how near they come.

An outline with rounded corners is costly to make. So pairs of boxes are first judged as the plain boxes that hold the
outlines, and outlines are made only where those leave the answer open.
"""

from functools import cached_property

import numpy as np
import shapely

from olt_closed_loop.rollouts.rollout_record import RolloutRecord
from olt_closed_loop.scoring.alpasim.series import MetricSeries
from olt_closed_loop.scoring.alpasim.tracks import (
    Geometries,
    Indices,
    RoundedBoxes,
    Single,
    agent_tracks,
    ego_track,
    ego_tracks,
)
from olt_closed_loop.scoring.moving_boxes import separations
from olt_generator.poses import Array

_SINGLE, _CLOSE = 1e-6, 1e-4
"""Share of the largest coordinate by which single precision may move a corner, and metres by which all the rest may."""
_ROUNDING = 0.43
"""Share of the corner radius by which rounding, by chords of an arc, takes a corner back: a little over sqrt(2) - 1."""


class Surroundings:
    """The ego and the agents of a drive as AlpaSim sees them.

    Attributes:
        ego, plans, agents: tracks of box centres: of the ego at the scored times, along each plan, and of the agents.
        ego_shape, agent_shapes: their shapes, (1,) and (agents,).
        ego_places: positions (n, 2) and yaws (n,) of the ego's box centre at the scored times.
    """

    def __init__(self, record: RolloutRecord) -> None:
        self.record, plans, agents = record, record.plans, record.agents
        self.ego = ego_track(record.timestamps_us, record.poses, record.box)
        self.plans = ego_tracks([plan.timestamps_us for plan in plans], [plan.poses for plan in plans], record.box)
        self.agents = agent_tracks(agents)
        self.ego_shape = RoundedBoxes.of([record.box.length], [record.box.width])
        self.agent_shapes = RoundedBoxes.of([agent.length for agent in agents], [agent.width for agent in agents])
        self.ego_places = self.ego.at(record.timestamps_us)

    @cached_property
    def ego_outlines(self) -> Geometries:
        """The ego's outline at each scored time (n,)."""
        return self.ego_shape.polygons(*self.ego_places)

    @cached_property
    def ego_centers(self) -> Geometries:
        """Centroids (n,) of the ego's outlines, the points that all other metrics look at."""
        return np.asarray(shapely.centroid(self.ego_outlines))

    def agents_at(self, times_us: Indices) -> tuple[Single, Single]:
        """Positions (agents, n, 2) and yaws (agents, n) at times (n,); NaN where an agent does not exist."""
        positions = np.full((len(self.agents), len(times_us), 2), np.nan, dtype=np.float32)
        yaws = np.full((len(self.agents), len(times_us)), np.nan, dtype=np.float32)
        everyone = np.arange(len(self.agents))[:, None]
        agent, sample = np.nonzero(self.agents.exists(times_us, everyone))
        if len(agent):
            positions[agent, sample], yaws[agent, sample] = self.agents.at(times_us[sample], agent)
        return positions, yaws

    @cached_property
    def agent_places(self) -> tuple[Single, Single]:
        """The agents at the scored times."""
        return self.agents_at(self.record.timestamps_us)

    @cached_property
    def slack(self) -> float:
        """Metres by which single precision, and all other rounding, may change the distance between two outlines."""
        largest = max(np.abs(tracks.positions).max(initial=0.0) for tracks in (self.ego, self.agents, self.plans))
        return _CLOSE + 4.0 * _SINGLE * float(largest)

    @cached_property
    def distances(self) -> Array:
        """Distances (agents, n) between outlines, metres; NaN where an agent is absent or another one is nearer."""
        positions, yaws = self.agent_places
        agent, sample = np.nonzero(~np.isnan(yaws))
        ego = tuple(place[sample] for place in self.ego_places)
        others = positions[agent, sample], yaws[agent, sample]
        at_least, at_most = self.distance_bounds(ego, others, agent)
        nearest = np.full(yaws.shape[1], np.inf)
        np.minimum.at(nearest, sample, at_most)
        open_ = at_least <= nearest[sample]
        outlines = self.agent_shapes.select(agent[open_]).polygons(*(place[open_] for place in others))
        distances = np.full(yaws.shape, np.nan)
        distances[agent[open_], sample[open_]] = shapely.distance(self.ego_outlines[sample[open_]], outlines)
        return distances

    def distance_bounds(
        self, ego: tuple[Single, ...], others: tuple[Single, ...], agents: Indices
    ) -> tuple[Array, Array]:
        """Between which distances (m,) the outlines of the ego and of agents (m,) are, from their boxes.

        Boxes are no nearer than along any of their axes, and no farther apart than one is from the other's centre.
        `ego` and `others` are positions (m, 2) and yaws (m,).
        """
        shapes = self.agent_shapes.select(agents)
        own_half, half = self.ego_shape.half_sizes, shapes.half_sizes
        gaps, offsets = separations(_poses(*ego), own_half[0], _poses(*others), half)
        to_other, to_ego = (
            np.hypot(*np.maximum(np.abs(along) - size[:, :2], 0.0).T) + _ROUNDING * radii
            for along, size, radii in (
                (offsets[:, :2], own_half, self.ego_shape.corner_radii),
                (offsets[:, 2:4], half, shapes.corner_radii),
            )
        )
        return gaps[:, :4].max(axis=1) - self.slack, np.minimum(to_other, to_ego) + self.slack

    def last_touched(self, sample: int) -> int:
        """The agent that counts as touched at a sample: with several, the last one that the search tree names.

        The tree orders agents by position, so that is none in particular: a quirk that is kept.
        """
        touched = np.flatnonzero(self.distances[:, sample] <= 0.0)
        if len(touched) == 1:
            return int(touched[0])
        outlines = self.outlines_at(sample)
        named = shapely.STRtree(list(outlines)).query(outlines[0], predicate="intersects")
        there = np.flatnonzero(~np.isnan(self.agent_places[1][:, sample]))
        return int(there[named[named != 0][-1] - 1])

    def outlines_at(self, sample: int) -> Geometries:
        """Outlines (1 + k,) of the ego and of all agents that exist at a sample."""
        positions, yaws = (places[:, sample] for places in self.agent_places)
        there = np.flatnonzero(~np.isnan(yaws))
        others = self.agent_shapes.select(there).polygons(positions[there], yaws[there])
        return np.concatenate([self.ego_outlines[[sample]], others])


def _poses(positions: Single, yaws: Single) -> Array:
    """Poses (n, 4) x, y, 0, yaw in double precision."""
    return np.column_stack([positions, np.zeros(len(yaws)), yaws]).astype(np.float64)


def measure_contact(surroundings: Surroundings) -> dict[str, MetricSeries]:
    """The collision metrics and the distance to the nearest agent."""
    times, distances = surroundings.record.timestamps_us, surroundings.distances
    samples = np.flatnonzero((distances <= 0.0).any(axis=0))
    touched = np.array([surroundings.last_touched(int(sample)) for sample in samples], dtype=np.int64)
    positions, yaws = surroundings.agent_places
    others = surroundings.agent_shapes.select(touched).polygons(positions[touched, samples], yaws[touched, samples])
    front, rear = surroundings.ego_shape.end_zones(*(place[samples] for place in surroundings.ego_places))
    zones = np.where(shapely.intersects(others, front), 0, np.where(shapely.intersects(others, rear), 1, 2))
    flags = np.zeros((3, len(times)))
    flags[zones, samples] = 1.0
    nearest = np.where(np.isnan(distances), np.inf, distances).min(axis=0, initial=np.inf)
    names = ("collision_front", "collision_rear", "collision_lateral")
    return {
        **{name: MetricSeries(times, values, "max") for name, values in zip(names, flags, strict=True)},
        "collision_any": MetricSeries(times, flags.max(axis=0), "max"),
        "min_distance_to_obstacle_m": MetricSeries(times, np.where(np.isinf(nearest), np.nan, nearest), "min"),
    }
