"""How near a drive comes to the border of the road and to others: at each of its samples, in the plane."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import shapely

from olt_closed_loop.rollouts.rollout_record import RolloutRecord
from olt_closed_loop.scenes.actors import corners, footprints
from olt_closed_loop.scenes.scene import Agent
from olt_closed_loop.scoring.drivable import drivable_area_of
from olt_closed_loop.scoring.moving_boxes import MovingBox, agent_box, ego_box
from olt_generator.poses import Array


@dataclass(frozen=True)
class NarrowPlace:
    """Where a drive comes nearest to something.

    Attributes:
        what: "the border of the road", or label and id of an agent.
        metres: between the ego's box and it; 0 where they touch.
        time_us: when.
        x, y: centre of the ego's box then, metres in the world.
    """

    what: str
    metres: float
    time_us: int
    x: float
    y: float

    def to_dict(self) -> dict[str, Any]:
        """The place as JSON can hold it."""
        return asdict(self)


def narrow_places(record: RolloutRecord) -> tuple[NarrowPlace, ...]:
    """The narrowest place to the border of the road, and that to any agent, from the hand-over on.

    What the scene lacks, border or agents, has none.
    """
    scored = record.timestamps_us >= record.handover_us
    whole = ego_box(record)
    ego = MovingBox(record.timestamps_us[scored], whole.poses[scored], whole.half_size)
    places = [_nearest("the border of the road", _to_border(record, ego), ego), _nearest_agent(record.agents, ego)]
    return tuple(place for place in places if place is not None)


def _nearest(what: str, metres: Array, ego: MovingBox) -> NarrowPlace | None:
    at = int(np.argmin(metres))
    if not np.isfinite(metres[at]):
        return None
    return NarrowPlace(what, float(metres[at]), int(ego.timestamps_us[at]), *ego.poses[at, :2].tolist())


def _to_border(record: RolloutRecord, ego: MovingBox) -> Array:
    """Distances (n,) to the border of the drivable area, or to the road's edges; infinite where the scene has none."""
    drivable = drivable_area_of(record)
    if drivable is None:
        return np.full(len(ego.poses), np.inf)
    border = shapely.boundary(drivable.area) if drivable.edges is None else drivable.edges
    boxes = shapely.polygons(corners(ego.poses, ego.half_size) - drivable.origin)
    return np.where(drivable.leaves(ego.poses, ego.half_size), 0.0, shapely.distance(boxes, border))


def _nearest_agent(agents: Sequence[Agent], ego: MovingBox) -> NarrowPlace | None:
    """The narrowest place to an agent: the nearest by centres first, until no other can be nearer."""
    apart = [_centres_apart(agent, ego) for agent in agents]
    radii = [float(np.hypot(agent.length, agent.width)) / 2.0 + ego.radius for agent in agents]
    best: NarrowPlace | None = None
    for index in sorted(range(len(agents)), key=lambda i: apart[i].min() - radii[i]):
        if apart[index].min() - radii[index] >= (best.metres if best else np.inf):
            break
        agent, near = agents[index], apart[index] - radii[index] <= apart[index].min()
        metres = np.full(len(near), np.inf)
        theirs = footprints(agent_box(agent).at(ego.timestamps_us[near]), agent.length, agent.width)
        metres[near] = shapely.distance(footprints(ego.poses[near], *(2.0 * ego.half_size[:2])), theirs)
        place = _nearest(f"{agent.label} {agent.id}", metres, ego)
        best = min((p for p in (best, place) if p), key=lambda p: p.metres)
    return best


def _centres_apart(agent: Agent, ego: MovingBox) -> Array:
    """Distances (n,) between the centres; infinite while the agent is not there."""
    box, apart = agent_box(agent), np.full(len(ego.poses), np.inf)
    there = box.covers(ego.timestamps_us)
    apart[there] = np.hypot(*(box.at(ego.timestamps_us[there], columns=2) - ego.poses[there, :2]).T)
    return apart
