"""Road maps seen from above."""

from typing import TYPE_CHECKING

import numpy as np

from olt_closed_loop.scenes.maps.cross_sections import PAVED
from olt_closed_loop.scenes.maps.markings import crossing_bars, line_strokes, stop_strokes
from olt_closed_loop.scenes.maps.road_map import RoadMap

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ROAD, _SIDEWALK, _PAINT, _EDGE, _CENTER = "#c8c8c8", "#ece7dc", "white", "gray", "#8fa9c4"
_LIGHTS = {"red": "#d62728", "amber": "#ff9800", "green": "#2ca02c", "off": "black", "unknown": "gray"}


def draw_map(axes: "Axes", road_map: RoadMap, time_us: int = 0) -> None:
    """Draw pavement, sidewalks, markings, stop lines, crossings, centre lines of ways through junctions, and lights.

    Lights show their state at `time_us`. Widths are those of the drawing, not of the road; worn paint is pale.
    """
    for lane in road_map.lanes:
        if lane.type == "sidewalk":
            axes.fill(*np.concatenate([lane.left, lane.right[::-1]])[:, :2].T, color=_SIDEWALK, linewidth=0.0)
    paved = [np.concatenate([lane.left, lane.right[::-1]]) for lane in road_map.lanes if lane.type in PAVED[1:]]
    for outline in (*road_map.drivable, *paved):
        axes.fill(*outline[:, :2].T, color=_ROAD, linewidth=0.0)
    for edge in road_map.road_edges:
        axes.plot(*edge[:, :2].T, color=_EDGE, linewidth=0.8)
    for bar in crossing_bars(road_map.crossings):
        axes.fill(*bar.T, color=_PAINT, linewidth=0.0)
    for stroke in (*line_strokes(road_map.lanes), *stop_strokes(road_map.stop_lines)):
        color, width = (_EDGE if stroke.kerb else _PAINT), 0.8 * stroke.width / 0.15
        axes.plot(*stroke.line[:, :2].T, color=color, linewidth=width, alpha=1.0 - stroke.wear)
    for lane in road_map.lanes:
        if lane.for_cars and (lane.type is None or lane.junction is not None):
            axes.plot(*lane.center[:, :2].T, color=_CENTER, linewidth=0.5)
    for light in road_map.lights:
        if light.position is not None:
            axes.plot(*light.position[:2], "o", color=_LIGHTS[light.state_at(time_us)], markersize=4)
