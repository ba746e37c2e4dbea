"""What is painted on the road, as strokes: for the camera's ground and for pictures from above."""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import shapely

from olt_closed_loop.scenes.maps.lanes import Crossing, Lane, Marking, StopLine
from olt_closed_loop.scenes.polylines import beside, length_of, points_along
from olt_generator.poses import Array

LINE_WIDTH = 0.15
_DASH, _GAP = 3.0, 4.5
_DOUBLE_GAP = 0.15
_STOP_WIDTH, _YIELD_WIDTH, _YIELD_DASH = 0.4, 0.3, 0.5
_BAR = 0.5


class Stroke(NamedTuple):
    """A line (n, 3) of a width in metres, whether it is a kerb and not paint, and which share of its paint is gone."""

    line: Array
    width: float
    kerb: bool
    wear: float


def line_strokes(lanes: Sequence[Lane]) -> Iterator[Stroke]:
    """The borders of lanes, each once.

    Where the marking is not known, borders between two lanes are drawn dashed and the others solid.
    """
    for line, marking in _borders(lanes):
        if marking.pattern == "dashed":
            yield from (Stroke(dash, LINE_WIDTH, False, marking.wear) for dash in _dashes(line, _DASH, _GAP))
        elif marking.pattern == "double":
            aside = (LINE_WIDTH + _DOUBLE_GAP) / 2.0
            yield from (Stroke(beside(line, side * aside), LINE_WIDTH, False, marking.wear) for side in (-1.0, 1.0))
        elif marking.pattern != "none":
            yield Stroke(line, LINE_WIDTH, marking.pattern == "kerb", marking.wear)


def stop_strokes(stop_lines: Sequence[StopLine]) -> Iterator[Stroke]:
    """Stop lines; broken ones where one has to yield."""
    for stop in stop_lines:
        if stop.control == "yield":
            yield from (
                Stroke(dash, _YIELD_WIDTH, False, 0.0) for dash in _dashes(stop.points, _YIELD_DASH, _YIELD_DASH)
            )
        else:
            yield Stroke(stop.points, _STOP_WIDTH, False, 0.0)


def crossing_bars(crossings: Sequence[Crossing]) -> Iterator[Array]:
    """Outlines (n, 2) of what is painted at crossings: bars along the lanes, or the two border lines.

    Nothing where it is not known how a crossing is painted.
    """
    for place in crossings:
        if place.zebra is None:
            continue
        area = shapely.Polygon(place.outline[:, :2])
        corners = shapely.get_coordinates(area.minimum_rotated_rectangle)
        sides = np.diff(corners[:3], axis=0)
        lengths = np.linalg.norm(sides, axis=1)
        longer = int(np.argmax(lengths))
        # Across the road, and from there along its lanes.
        walk, drive = sides[longer] / lengths[longer], sides[1 - longer] * (1.0 if longer == 0 else -1.0)
        base = corners[0] if longer == 0 else corners[1]
        if place.zebra:
            starts = [base + at * walk for at in np.arange(_BAR / 2.0, lengths[longer] - _BAR / 2.0, 2.0 * _BAR)]
            bars = [(start, _BAR * walk, drive) for start in starts]
        else:
            along = sides[longer], LINE_WIDTH * drive / np.linalg.norm(drive)
            bars = [(base, *along), (base + drive - along[1], *along)]
        for start, first, second in bars:
            bar = shapely.Polygon([start, start + first, start + first + second, start + second]).intersection(area)
            yield from (
                shapely.get_coordinates(part.exterior)
                for part in shapely.get_parts(bar)
                if isinstance(part, shapely.Polygon) and not part.is_empty
            )


def _borders(lanes: Sequence[Lane]) -> Iterator[tuple[Array, Marking]]:
    """Borders (n, 3) by where they end, each once, with what is known of their marking."""
    borders, known, uses = dict[object, Array](), dict[object, Marking](), Counter[object]()
    for lane in lanes:
        for border, marking in ((lane.left, lane.left_marking), (lane.right, lane.right_marking)):
            ends = tuple(sorted(tuple(np.round(point[:2], 1).tolist()) for point in (border[0], border[-1])))
            borders.setdefault(ends, border)
            uses[ends] += 1
            if marking is not None:
                known.setdefault(ends, marking)
    for ends, border in borders.items():
        guessed = Marking("dashed" if uses[ends] > 1 else "solid")
        yield border, known.get(ends, guessed)


def _dashes(line: Array, dash: float, gap: float) -> list[Array]:
    length = length_of(line)
    starts = np.arange(0.0, length, dash + gap)
    return [points_along(line, np.linspace(start, min(start + dash, length), 4)) for start in starts]
