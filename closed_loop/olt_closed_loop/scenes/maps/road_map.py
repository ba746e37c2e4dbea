"""A map of roads, and what is asked of it: what lane is here, what leads where, who goes first."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scenes.maps.lanes import Crossing, Lane, Light, StopLine
from olt_generator.poses import Array


@dataclass(frozen=True)
class LanePlaces:
    """Places beside lanes.

    Attributes:
        lanes: (n,) index of the lane in `RoadMap.lanes`; -1 where none is near.
        along: (n,) metres along its centre line.
        offsets: (n,) metres to the left of its centre line; infinite where no lane is near.
        headings: (n,) its direction there, radians.
    """

    lanes: NDArray[np.int64]
    along: Array
    offsets: Array
    headings: Array


@dataclass(frozen=True)
class RoadMap:
    """Lanes, what regulates them, and where one may drive. World frame, metres.

    Attributes:
        lanes: every lane, ids unique.
        road_edges: polylines (n, 3) that bound the drivable area, which lies to their left.
        drivable: closed outlines (n, 3) without holes, counter-clockwise, whose union is the drivable area.
        stop_lines, crossings, lights: what regulates traffic.
    """

    lanes: tuple[Lane, ...]
    road_edges: tuple[Array, ...] = ()
    drivable: tuple[Array, ...] = ()
    stop_lines: tuple[StopLine, ...] = ()
    crossings: tuple[Crossing, ...] = ()
    lights: tuple[Light, ...] = ()
