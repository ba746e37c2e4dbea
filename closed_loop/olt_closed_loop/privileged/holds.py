"""Which lines a scene holds, and when: red lights, and people who stop traffic, whose hands outrank lights."""

import numpy as np
import shapely

from olt_closed_loop.privileged.truth import Hold
from olt_closed_loop.scenes.maps.lanes import Lane, Light

_ON_ROUTE = 1.0


def holds_of(lanes: tuple[Lane, ...], lights: tuple[Light, ...], route: np.ndarray, end_us: int) -> tuple[Hold, ...]:
    """The lines that lights hold on a route (n, 2), where a person directs the lane only theirs."""
    people = {lane for light in lights if light.by_hand for lane in light.lanes}
    by_id, line = {lane.id: lane for lane in lanes}, shapely.LineString(route[:, :2])
    holds = []
    for light in lights:
        for name in light.lanes:
            lane = by_id[name]
            # Other ways cross the route, and those of the same arm begin on it: it follows those that do both.
            places = shapely.points(lane.center[[0, len(lane.center) // 2], :2])
            outranked = name in people and not light.by_hand
            if outranked or shapely.distance(places, line).max() > _ON_ROUTE:
                continue
            ends = np.stack([lane.left[0, :2], lane.right[0, :2]])
            holds += [Hold(ends, int(begin), int(end)) for begin, end in light.spans("red", end_us)]
    return tuple(holds)
