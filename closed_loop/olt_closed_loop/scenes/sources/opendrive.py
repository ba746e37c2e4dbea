"""OpenDRIVE road networks (ASAM OpenDRIVE 1.4 to 1.8): roads, lanes, junctions, and how lanes follow each other.

Read: reference lines, lane offsets, lane sections with widths, types and links, road links, junctions. Heights and
banking are read to say that they are left out: the ground of a scene is flat. Public packages for OpenDRIVE are whole
simulators, or bring a graphics stack; none gives lanes as lines with their successors alone.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
import shapely

from olt_closed_loop.scenes.maps.lanes import Lane, LaneType, Marking, Pattern
from olt_closed_loop.scenes.polylines import without_repeats, wrap
from olt_closed_loop.scenes.sources.assembly import lane_area, usable_line
from olt_closed_loop.scenes.sources.opendrive_lines import (
    LONGEST_ROAD,
    Cubics,
    ReferenceLine,
    read_cubics,
    read_reference_line,
)
from olt_closed_loop.scenes.sources.xml_files import child, number_of, parse_xml, read_xml, text_of
from olt_generator.errors import InputError
from olt_generator.poses import Array

ROOT = "OpenDRIVE"
DRIVING = frozenset(
    {"driving", "entry", "exit", "onRamp", "offRamp", "connectingRamp", "slipLane", "bidirectional", "bus", "taxi"}
    | {"HOV", "special1", "special2", "special3"}
)
"""Types of lanes that cars drive along."""
DRIVABLE = DRIVING | {"shoulder", "stop", "parking", "mwyEntry", "mwyExit"}
"""Types of lanes whose surface a car may be on without being off the road."""
_TYPES: Mapping[str, LaneType] = {
    **dict.fromkeys(DRIVABLE, "shoulder"),
    **dict.fromkeys(DRIVING, "driving"),
    **{"biking": "cycle", "sidewalk": "sidewalk", "walking": "sidewalk"},
}
_PATTERNS: dict[str, Pattern] = {
    "none": "none",
    "solid": "solid",
    "broken": "dashed",
    "botts dots": "dashed",
    "curb": "kerb",
    **dict.fromkeys(("solid solid", "solid broken", "broken solid", "broken broken"), "double"),
}
_SPEED_UNITS = {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704}
_STEP, _STEP_IN_JUNCTION = 1.0, 0.25
_MOST_SAMPLES = 2_000_000
_JOIN_GAP, _JOIN_TURN = 1.0, np.radians(60.0)
_SEAM = 0.05
"""Half of the widest gap in metres that is closed where the edges of two roads do not quite meet."""


class LaneKey(NamedTuple):
    """A lane of a lane section; negative numbers are to the right of the reference line."""

    road: str
    section: int
    lane: int


@dataclass(frozen=True)
class LaneStrip:
    """A lane in one section: its type, width by station, and the numbers of the lanes before and behind it.

    Beside that, what is painted on its outer border, and its own speed limit in m/s; None where the file does not say.
    """

    kind: str
    width: Cubics
    predecessor: int | None
    successor: int | None
    marking: Marking | None = None
    speed_limit: float | None = None


@dataclass(frozen=True)
class Link:
    """What a road ends at: a road (at its start or end) or a junction."""

    kind: str
    id: str
    at_start: bool


@dataclass(frozen=True)
class OpenDriveRoad:
    """A road: stations `s` along its reference line, offsets `t` to its left, metres."""

    id: str
    length: float
    junction: str | None
    right_hand: bool
    line: ReferenceLine
    offset: Cubics
    starts: tuple[float, ...]
    sections: tuple[dict[int, LaneStrip], ...]
    predecessor: Link | None
    successor: Link | None
    centers: tuple[Marking | None, ...] = ()
    """What is painted on the line between the directions, by section."""
    speed_limit: float | None = None

    def section_at(self, s: float) -> int:
        """The number of the lane section at a station."""
        return max(0, int(np.searchsorted(self.starts, s, side="right")) - 1)

    def section_end(self, section: int) -> float:
        """The station at which a section ends."""
        return self.starts[section + 1] if section + 1 < len(self.starts) else self.length

    def borders(self, section: int, lane: int, s: Array) -> tuple[Array, Array]:
        """Offsets (n,) of the inner and outer border of a lane at stations (n,)."""
        strips, side = self.sections[section], 1 if lane > 0 else -1
        inner = self.offset.at(s)
        for number in range(side, lane, side):
            if number in strips:
                inner = inner + side * np.maximum(strips[number].width.at(s), 0.0)
        outer = inner + (side * np.maximum(strips[lane].width.at(s), 0.0) if lane else 0.0)
        return inner, outer

    def lane_offset(self, lane: int, s: float) -> float:
        """Offset of a lane's centre at a station; `InputError` if there is no such lane."""
        section = self.section_at(s)
        if lane and lane not in self.sections[section]:
            raise InputError(f"road {self.id:.40} has no lane {lane} at s = {s:.1f}")
        inner, outer = self.borders(section, lane, np.array([s]))
        return 0.5 * float(inner[0] + outer[0])

    def locate(self, s: Array, t: Array) -> Array:
        """Points (n, 2) at stations (n,) and offsets (n,)."""
        points, heading = self.line.at(s)
        return points + t[:, None] * np.column_stack([-np.sin(heading), np.cos(heading)])

    def ahead(self, lane: int) -> int:
        """1 where traffic of a lane drives along increasing stations, -1 where against them."""
        return 1 if (lane < 0) == self.right_hand else -1


@dataclass(frozen=True)
class Connection:
    """A way through a junction, and the numbers of the lanes that it links."""

    incoming: str
    connecting: str
    at_start: bool
    lanes: tuple[tuple[int, int], ...]


@dataclass
class RoadNetwork:
    """Roads and junctions by id; `notes` says what was left out, `georeference` (PROJ) where on earth the origin is."""

    roads: dict[str, OpenDriveRoad]
    junctions: dict[str, list[Connection]]
    notes: tuple[str, ...]
    georeference: str | None = None
    _following: dict[LaneKey, tuple[LaneKey, ...]] = field(default_factory=dict)

    def road(self, name: str) -> OpenDriveRoad:
        """A road by its id, an `InputError` if there is none."""
        if name not in self.roads:
            raise InputError(f"there is no road {name:.40} in the road network")
        return self.roads[name]

    def strip(self, key: LaneKey) -> LaneStrip | None:
        """The lane of a key, None if there is none."""
        road = self.roads.get(key.road)
        return road.sections[key.section].get(key.lane) if road and key.section < len(road.sections) else None

    def following(self, key: LaneKey) -> tuple[LaneKey, ...]:
        """The lanes that go on where a lane ends in its driving direction."""
        if key not in self._following:
            self._following[key] = tuple(self._find_following(key))
        return self._following[key]

    def _find_following(self, key: LaneKey) -> Iterator[LaneKey]:
        road, strip = self.roads[key.road], self.strip(key)
        if strip is None:
            return
        ahead = road.ahead(key.lane)
        next_lane = strip.successor if ahead > 0 else strip.predecessor
        if 0 <= key.section + ahead < len(road.sections):
            if next_lane is not None:
                yield from self._joined(key, LaneKey(key.road, key.section + ahead, next_lane))
            return
        link = road.successor if ahead > 0 else road.predecessor
        if link is None:
            return
        if link.kind == "road" and link.id in self.roads and next_lane is not None:
            yield from self._joined(key, self._at_end(link.id, link.at_start, next_lane))
        for connection in self.junctions.get(link.id, []) if link.kind == "junction" else []:
            if connection.incoming == key.road and connection.connecting in self.roads:
                for first, second in connection.lanes:
                    if first == key.lane:
                        target = self._at_end(connection.connecting, connection.at_start, second)
                        yield from self._joined(key, target)

    def _at_end(self, road: str, at_start: bool, lane: int) -> LaneKey:
        return LaneKey(road, 0 if at_start else len(self.roads[road].sections) - 1, lane)

    def _joined(self, key: LaneKey, target: LaneKey) -> Iterator[LaneKey]:
        """A lane, if it is there and begins about where another ends: links of real maps, and roads that meet one
        junction with both ends, need that look."""
        if self.strip(target) is None:
            return
        (end, heading), (start, first) = self.end_of(key, last=True), self.end_of(target, last=False)
        turn = abs(float(wrap(np.array(first - heading))))
        if float(np.linalg.norm(start - end)) < _JOIN_GAP and turn < _JOIN_TURN:
            yield target

    def end_of(self, key: LaneKey, last: bool) -> tuple[Array, float]:
        """Where a lane ends (`last`) or begins, and its driving direction there."""
        road = self.roads[key.road]
        ahead = road.ahead(key.lane)
        at_end = (ahead > 0) == last
        s = np.array([road.section_end(key.section) if at_end else road.starts[key.section]])
        inner, outer = road.borders(key.section, key.lane, s)
        heading = float(road.line.at(s)[1][0]) + (0.0 if ahead > 0 else np.pi)
        return road.locate(s, 0.5 * (inner + outer))[0], heading

    def lanes(self) -> tuple[list[Lane], list[shapely.Polygon]]:
        """Lanes of cars, shoulders, and lanes of others, with their successors; and the areas that are drivable."""
        lanes, areas = [], []
        for road in self.roads.values():
            for section, strips in enumerate(road.sections):
                s = _stations(road, section)
                for number, strip in strips.items():
                    if strip.kind not in _TYPES:
                        continue
                    lane = self._lane(LaneKey(road.id, section, number), s)
                    if lane is None:
                        continue
                    lanes.append(lane)
                    if strip.kind in DRIVABLE:
                        areas.append(lane_area(lane.left, lane.right))
        names = {lane.id for lane in lanes}
        linked = [replace(lane, successors=tuple(self._beyond(lane.successors, names))) for lane in lanes]
        return linked, [*areas, *_seams(areas)]

    def _beyond(self, successors: tuple[str, ...], names: set[str]) -> Iterator[str]:
        """The lanes that follow, with those that follow it in place of one that is too short to be a lane."""
        for name in successors:
            if name in names:
                yield name
                continue
            road, section, lane = name.rsplit(":", 2)
            for other in self.following(LaneKey(road, int(section), int(lane))):
                if lane_name(other) in names:
                    yield lane_name(other)

    def _lane(self, key: LaneKey, s: Array) -> Lane | None:
        road = self.roads[key.road]
        inner, outer = road.borders(key.section, key.lane, s)
        lines = [road.locate(s, t) for t in (0.5 * (inner + outer), inner, outer)]
        if road.ahead(key.lane) < 0:
            lines = [line[::-1] for line in lines]
        center, first, second = (np.column_stack([line, np.zeros(len(line))]) for line in lines)
        if not usable_line(without_repeats(center)):
            return None
        # In right-hand traffic the inner border of a lane is on the left of who drives along it.
        left, right = (first, second) if road.right_hand else (second, first)
        successors = tuple(lane_name(other) for other in self.following(key))
        strip, strips = road.sections[key.section][key.lane], road.sections[key.section]
        side = 1 if key.lane > 0 else -1
        inside, outside = key.lane - side or -side, key.lane + side
        beside = [(lane_name(key._replace(lane=one)),) if one in strips else () for one in (inside, outside)]
        inner_marking = road.centers[key.section] if abs(key.lane) == 1 else _marking_of(strips.get(inside))
        paint = [inner_marking, strip.marking]
        if not road.right_hand:
            beside, paint = beside[::-1], paint[::-1]
        return Lane(
            lane_name(key),
            center,
            left,
            right,
            successors,
            type=_TYPES[strip.kind],
            left_neighbours=beside[0],
            right_neighbours=beside[1],
            left_marking=paint[0],
            right_marking=paint[1],
            junction=road.junction,
            speed_limit=strip.speed_limit or road.speed_limit,
        )


def _marking_of(strip: LaneStrip | None) -> Marking | None:
    return strip.marking if strip else None


def lane_name(key: LaneKey) -> str:
    """What a lane is called in a scene."""
    return f"{key.road}:{key.section}:{key.lane}"


def _stations(road: OpenDriveRoad, section: int) -> Array:
    first, last = road.starts[section], road.section_end(section)
    step = _STEP if road.junction is None else _STEP_IN_JUNCTION
    return np.linspace(first, last, max(2, int(np.ceil((last - first) / step)) + 1))


def _seams(areas: list[shapely.Polygon]) -> list[shapely.Polygon]:
    """Slivers between areas that do not quite meet."""
    union = shapely.union_all([shapely.make_valid(area) for area in areas])
    closed = shapely.buffer(shapely.buffer(union, _SEAM, join_style="mitre"), -_SEAM, join_style="mitre")
    parts = shapely.get_parts(shapely.difference(closed, union))
    return [part for part in parts if part.geom_type == "Polygon" and part.area > 1e-6 and not len(part.interiors)]


def read_road_network(path: Path) -> RoadNetwork:
    """Read an OpenDRIVE file.

    Raises:
        InputError: the file is none, or uses what is not read (it says what and where).
    """
    return _named(read_xml(path, "OpenDRIVE road network", ROOT), str(path))


def parse_road_network(content: bytes, where: str) -> RoadNetwork:
    """The road network of an OpenDRIVE text, which errors call `where`; they are those of `read_road_network`."""
    return _named(parse_xml(content, where, "OpenDRIVE road network", ROOT), where)


def _named(root: Element, where: str) -> RoadNetwork:
    try:
        return _read_network(root)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def _read_network(root: Element) -> RoadNetwork:
    roads: dict[str, OpenDriveRoad] = {}
    heights, samples = 0, 0.0
    for element in root.findall("road"):
        road = _read_road(element)
        if road.id in roads:
            raise InputError(f"two roads of id {road.id:.40}; give an unchanged copy")
        roads[road.id] = road
        step = _STEP if road.junction is None else _STEP_IN_JUNCTION
        samples += sum(map(len, road.sections)) * (road.length / step + 2.0)
        if samples > _MOST_SAMPLES:
            raise InputError("more lanes and roads than can be sampled; give a part of the map")
        heights += _has_heights(element, f"road {road.id:.40}")
    if not roads:
        raise InputError("holds no roads; give a road network")
    junctions = {
        text_of(one, "id", "junction"): list(_read_connections(one, roads)) for one in root.findall("junction")
    }
    notes = (
        f"flat ground: heights or banking of {heights} of {len(roads)} roads are left out" if heights else "flat ground"
    )
    drivable = "drivable area: lanes of cars and their shoulders, stopping and parking lanes"
    beside = sum(len(root.findall(kind)) for kind in ("road/signals/signal", "road/objects/object"))
    left_out = (f"{beside} signals and objects beside the roads are left out",) if beside else ()
    return RoadNetwork(
        roads,
        junctions,
        (notes, drivable, *left_out),
        root.findtext("header/geoReference"),
    )


def _has_heights(road: Element, where: str) -> bool:
    profiles = [*road.findall("elevationProfile/elevation"), *road.findall("lateralProfile/superelevation")]
    return not read_cubics(profiles, "s", where).level


def _read_road(element: Element) -> OpenDriveRoad:
    name = text_of(element, "id", "road")
    where = f"road {name:.40}"
    length = number_of(element, "length", where)
    if not 0.0 < length <= LONGEST_ROAD:
        raise InputError(f"{where}: length {length:g} m; up to {LONGEST_ROAD:g} m are read")
    rule, junction = element.get("rule", "RHT"), element.get("junction", "-1")
    if rule not in ("RHT", "LHT"):
        raise InputError(f"{where}: rule {rule:.40} is neither RHT nor LHT")
    lanes = child(element, "lanes", where)
    found = [(number_of(section, "s", where), section) for section in lanes.findall("laneSection")]
    found.sort(key=lambda pair: pair[0])
    starts = [start for start, _ in found]
    if not starts or starts[0] > 0.01 or starts[-1] >= length or np.any(np.diff(starts) <= 0.0):
        raise InputError(f"{where}: lane sections do not begin at s = 0 and lie apart on the road")
    link = element.find("link")
    return OpenDriveRoad(
        id=name,
        length=length,
        junction=None if junction == "-1" else junction,
        right_hand=rule == "RHT",
        line=read_reference_line(element, length, where),
        offset=read_cubics(lanes.findall("laneOffset"), "s", where),
        starts=(0.0, *starts[1:]),
        sections=tuple(_read_section(section, start, where) for start, section in found),
        predecessor=_read_link(link, "predecessor", where),
        successor=_read_link(link, "successor", where),
        centers=tuple(_read_marking(section.find("center/lane")) for _, section in found),
        speed_limit=_read_speed(element.find("type/speed"), where),
    )


def _read_marking(lane: Element | None) -> Marking | None:
    """What is painted at the start of a lane's outer border; None where the file does not say, or says it otherwise."""
    paint = lane.find("roadMark") if lane is not None else None
    if paint is None or paint.get("type") not in _PATTERNS:
        return None
    change = paint.get("laneChange")
    crossable = None if change not in ("both", "none") else change == "both"
    return Marking(_PATTERNS[paint.get("type", "")], crossable)


def _read_speed(speed: Element | None, where: str) -> float | None:
    """A speed limit in m/s; None where there is none, or no number."""
    if speed is None or speed.get("max") in ("no limit", "undefined"):
        return None
    unit = speed.get("unit", "m/s")
    if unit not in _SPEED_UNITS:
        raise InputError(f"{where}: a speed in {unit:.40}")
    limit = number_of(speed, "max", where) * _SPEED_UNITS[unit]
    return limit if limit > 0.0 else None


def _read_link(links: Element | None, name: str, where: str) -> Link | None:
    link = links.find(name) if links is not None else None
    if link is None:
        return None
    kind = text_of(link, "elementType", f"{where}: {name}")
    if kind not in ("road", "junction"):
        raise InputError(f"{where}: {name} is a {kind:.40}; a road or a junction is expected")
    return Link(kind, text_of(link, "elementId", f"{where}: {name}"), link.get("contactPoint", "start") == "start")


def _read_section(section: Element, start: float, where: str) -> dict[int, LaneStrip]:
    strips: dict[int, LaneStrip] = {}
    for side in ("left", "right"):
        for lane in section.findall(f"{side}/lane"):
            number = _read_lane_number(lane, where)
            here = f"{where}, lane {number}"
            if number in strips or number == 0 or (number > 0) != (side == "left"):
                raise InputError(f"{here} is there twice, or on the wrong side")
            widths = lane.findall("width")
            if not widths and lane.find("border") is not None:
                raise InputError(f"{here}: <border> is not read, <width> is")
            strips[number] = LaneStrip(
                kind=text_of(lane, "type", here),
                width=read_cubics(widths, "sOffset", here, offset=start),
                predecessor=_read_lane_link(lane, "predecessor", here),
                successor=_read_lane_link(lane, "successor", here),
                marking=_read_marking(lane),
                speed_limit=_read_speed(lane.find("speed"), here),
            )
    return strips


def _read_lane_link(lane: Element, name: str, where: str) -> int | None:
    link = lane.find(f"link/{name}")
    return None if link is None else _read_lane_number(link, f"{where}: {name}")


def _read_lane_number(element: Element, where: str, name: str = "id") -> int:
    number = number_of(element, name, where)
    if number != round(number) or abs(number) > 100:
        raise InputError(f"{where}: {name} {number:g} is no number of a lane")
    return int(number)


def _read_connections(junction: Element, roads: dict[str, OpenDriveRoad]) -> Iterator[Connection]:
    name = text_of(junction, "id", "junction")
    where = f"junction {name:.40}"
    for element in junction.findall("connection"):
        incoming, at_start = text_of(element, "incomingRoad", where), text_of(element, "contactPoint", where) == "start"
        lanes = tuple(
            (_read_lane_number(link, where, "from"), _read_lane_number(link, where, "to"))
            for link in element.findall("laneLink")
        )
        linked = element.get("linkedRoad")
        yield Connection(incoming, linked or text_of(element, "connectingRoad", where), at_start, lanes)
        if linked is not None and incoming in roads:
            # Of a direct junction, traffic may run from the linked road to the incoming one as well.
            before = roads[incoming].predecessor
            met_at_start = before is not None and (before.kind, before.id) == ("junction", name)
            yield Connection(linked, incoming, met_at_start, tuple((second, first) for first, second in lanes))
