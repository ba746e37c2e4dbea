"""Layouts: lanes join without a step or a kink, lie on the road, and are all reached; the mirror image is exact."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from olt_closed_loop.scenes.maps.arms import Arm
from olt_closed_loop.scenes.maps.carriageways import LaneChange, carriageway
from olt_closed_loop.scenes.maps.courses import Place, connect, follow
from olt_closed_loop.scenes.maps.cross_sections import CrossSection
from olt_closed_loop.scenes.maps.frames import mirrored, moved
from olt_closed_loop.scenes.maps.junctions import junction
from olt_closed_loop.scenes.maps.lanes import CONTROLS
from olt_closed_loop.scenes.maps.road_map import RoadMap
from olt_closed_loop.scenes.maps.roundabouts import roundabout
from olt_generator.errors import InputError

NORTH, WEST, SOUTH = np.pi / 2.0, np.pi, -np.pi / 2.0
SECTIONS = st.builds(
    CrossSection,
    lane_width=st.floats(2.6, 4.5),
    cycle_width=st.sampled_from([0.0, 1.5]),
    shoulder=st.sampled_from([0.0, 0.5, 2.0]),
    sidewalk_width=st.sampled_from([0.0, 2.0]),
)


@st.composite
def many_arms(draw, most_lanes=3):
    """Two to five arms, at least 29 degrees apart, turned anyhow."""
    count = draw(st.integers(2, 5))
    shares = np.array(draw(st.lists(st.floats(0.0, 1.0), min_size=count, max_size=count))) + 0.1
    gaps = 0.5 + shares / shares.sum() * (2.0 * np.pi - 0.5 * count)
    headings = draw(st.floats(-10.0, 10.0)) + np.cumsum(gaps)
    return [
        Arm(
            float(heading),
            draw(st.integers(0, most_lanes)),
            draw(st.integers(1, most_lanes)),
            section=draw(SECTIONS),
            offset=draw(st.floats(-3.0, 3.0)) if most_lanes > 1 else 0.0,
            crossing=draw(st.booleans()),
            control=draw(st.sampled_from([None, *CONTROLS])) if most_lanes > 1 else None,
        )
        for heading in headings
    ]


def laid(make, *args, **more) -> RoadMap:
    """The map, unless the layout says that it has no room."""
    try:
        return make(*args, **more)
    except InputError:
        assume(False)
        raise


def cross_town() -> RoadMap:
    arms = [Arm(0.0, control="priority"), Arm(NORTH, control="stop"), Arm(WEST, control="priority")]
    return junction([*arms, Arm(SOUTH, control="stop", crossing=True)])


def step(line: np.ndarray, at: int) -> np.ndarray:
    return line[1, :2] - line[0, :2] if at == 0 else line[-1, :2] - line[-2, :2]


def assert_joined(road_map: RoadMap) -> None:
    """Centre lines go on in place and direction, borders in place."""
    for lane in road_map.lanes:
        for name in lane.successors:
            after = road_map.lane(name)
            np.testing.assert_allclose(lane.center[-1], after.center[0], rtol=0.0, atol=1e-6)
            (ax, ay), (bx, by) = step(lane.center, -1), step(after.center, 0)
            assert abs(np.arctan2(ax * by - ay * bx, ax * bx + ay * by)) <= 1e-6
            for side in ("left", "right"):
                np.testing.assert_allclose(getattr(lane, side)[-1], getattr(after, side)[0], rtol=0.0, atol=1e-6)


def assert_sound(road_map: RoadMap) -> None:
    """No lane crosses itself, all lanes for vehicles are drivable, outlines are simple and counter-clockwise."""
    rings = [shapely.Polygon(outline[:, :2]) for outline in road_map.drivable]
    assert all(ring.is_valid and ring.exterior.is_ccw for ring in rings)
    area = shapely.union_all(rings).buffer(1e-3)
    for lane in road_map.lanes:
        polygon = shapely.Polygon(np.concatenate([lane.left, lane.right[::-1]])[:, :2])
        assert polygon.is_valid and polygon.area > 0.0
        assert area.covers(polygon) == (lane.type != "sidewalk")
        across = lane.left[:, :2] - lane.right[:, :2]
        assert np.all(np.linalg.norm(across, axis=1) > 0.49)
        ahead = np.gradient(lane.center[:, :2], axis=0)
        side = ahead[:, 0] * across[:, 1] - ahead[:, 1] * across[:, 0]
        assert np.all(side > 0.0)
    for edge in road_map.road_edges:
        middle, along = 0.5 * (edge[1:, :2] + edge[:-1, :2]), np.diff(edge[:, :2], axis=0)
        left = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True)
        long = np.linalg.norm(along, axis=1) > 0.1
        assert shapely.covers(area, shapely.points((middle + 0.02 * left)[long])).all()
        assert shapely.distance(area.boundary, shapely.points(middle[long])).max() < 2e-3


def assert_served(road_map: RoadMap) -> None:
    """Every lane for cars is reached from an entry or is one, and leads to an exit or is one."""
    for ends, following in (
        (road_map.entries, lambda lane: road_map.lane(lane).successors),
        (road_map.exits, lambda lane: road_map.predecessors[lane]),
    ):
        open_, seen = list(ends), set(ends)
        while open_:
            new = set(following(open_.pop())) - seen
            seen |= new
            open_ += new
        assert {lane.id for lane in road_map.lanes if lane.for_cars} <= seen


@settings(max_examples=25, deadline=None)
@given(many_arms(), st.floats(4.0, 12.0), st.booleans())
def test_junctions_are_sound_however_their_arms_lie(arms, turn_radius, left_hand):
    road_map = laid(junction, arms, turn_radius, left_hand=left_hand)
    for check in (assert_joined, assert_sound, assert_served):
        check(road_map)
    ends = {f"arm{k}" for k in range(len(arms))}
    assert {name.split("_")[0] for name in (*road_map.entries, *road_map.exits)} <= ends


@settings(max_examples=10, deadline=None)
@given(many_arms(most_lanes=1), st.floats(15.0, 40.0), st.booleans())
def test_roundabouts_are_sound(arms, radius, left_hand):
    road_map = laid(roundabout, arms, radius, left_hand=left_hand)
    for check in (assert_joined, assert_sound, assert_served):
        check(road_map)
    for lane in road_map.lanes:
        if lane.id.startswith("arm") and lane.junction:  # a way in
            merged = [name for name in road_map.predecessors[lane.successors[0]] if name != lane.id]
            assert set(merged) <= set(lane.yields_to or ())
        elif lane.id.startswith("ring"):
            assert lane.yields_to == ()


@settings(max_examples=15, deadline=None)
@given(st.integers(1, 4), st.integers(0, 3), st.sampled_from([-1, 1]), SECTIONS, st.floats(20.0, 90.0), st.booleans())
def test_roads_gain_and_lose_lanes(forward, backward, more, section, length, left_hand):
    assume(forward + more >= 1)
    change = LaneChange(40.0, 40.0 + length, forward + more)
    road_map = laid(carriageway, 160.0, forward, backward, section, change=change, left_hand=left_hand)
    for check in (assert_joined, assert_sound, assert_served):
        check(road_map)
    if more < 0:
        last, kept = f"forward_{forward - 1}>after_{forward - 2}", f"forward_{forward - 2}>after_{forward - 2}"
        assert road_map.goes_first(kept, last) is True and road_map.goes_first(last, kept) is False
        assert kept in road_map.conflicts[last]


@settings(max_examples=15, deadline=None)
@given(many_arms(), st.floats(-1e6, 1e6), st.floats(-1e6, 1e6), st.floats(-7.0, 7.0))
def test_a_map_far_away_is_the_same_map(arms, x, y, heading):
    near = laid(junction, arms)
    far = moved(near, x, y, heading)
    assert_joined(far)
    assert far.conflicts == near.conflicts and far.entries == near.entries
    point = near.lanes[0].center[3:4, :2] + 0.3
    turn = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    one, other = near.nearest(point), far.nearest(point @ turn + [x, y])
    assert one.lanes == other.lanes
    np.testing.assert_allclose([one.along, one.offsets], [other.along, other.offsets], atol=1e-6)


@settings(max_examples=15, deadline=None)
@given(many_arms())
def test_the_mirror_image_of_the_mirror_image_is_the_map(arms):
    road_map = laid(junction, arms)
    again, image = mirrored(mirrored(road_map)), mirrored(road_map)
    for first, second in zip(road_map.lanes, again.lanes, strict=True):
        assert all(np.array_equal(getattr(first, line), getattr(second, line)) for line in ("center", "left", "right"))
        assert replace(first, center=0, left=0, right=0) == replace(second, center=0, left=0, right=0)
    assert all(map(np.array_equal, road_map.road_edges, again.road_edges))
    assert all(map(np.array_equal, road_map.drivable, again.drivable))
    assert image.conflicts == road_map.conflicts
    assert_sound(image)


def test_left_hand_traffic_is_mirrored_but_gives_way_to_the_right():
    arms = [Arm(heading) for heading in (0.0, NORTH, WEST, SOUTH)]
    right, left = junction(arms), junction(arms, left_hand=True)
    np.testing.assert_array_equal(left.lane("arm1_in_0").center, right.lane("arm1_in_0").center * [1.0, -1.0, 1.0])
    # Eastwards from the west (arm 2): in right-hand traffic arm 3, in the south, is on the right; in the mirror arm 1.
    east, from_south, from_north = "arm2_in_0>arm0_out_0", "arm3_in_0>arm1_out_0", "arm1_in_0>arm3_out_0"
    assert right.goes_first(from_south, east) is True and right.goes_first(from_north, east) is False
    assert left.lane("arm1_in_0").center[0, 1] < 0.0
    assert left.goes_first(from_north, east) is True and left.goes_first(from_south, east) is False


def test_who_goes_first():
    town = cross_town()
    straight, left, across = "arm0_in_0>arm2_out_0", "arm2_in_0>arm1_out_0", "arm1_in_0>arm3_out_0"
    assert town.goes_first(straight, left) is True  # who turns left waits for oncoming traffic
    assert town.goes_first(straight, across) is True and town.goes_first(left, across) is True
    assert town.goes_first("arm0_in_0>arm1_out_0", "arm2_in_0>arm3_out_0") is None  # they do not meet
    for one, others in town.conflicts.items():
        assert all(one in town.conflicts[other] for other in others)
        assert all(other in others for other in town.lane(one).yields_to or ())
        assert all(one not in (town.lane(other).yields_to or ()) for other in town.lane(one).yields_to or ())


def test_junction_curves_of_four_metres():
    road_map = junction([Arm(0.0), Arm(NORTH), Arm(WEST), Arm(SOUTH)], turn_radius=4.0)
    way = road_map.lane("arm3_in_0>arm0_out_0").center[:, :2]
    steps = np.diff(way, axis=0)
    turns = np.abs(np.diff(np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))))
    lengths = np.linalg.norm(steps, axis=1)
    tightest = 0.5 * (lengths[1:] + lengths[:-1])[turns > 1e-6] / turns[turns > 1e-6]
    assert 3.9 < tightest[1:-1].min() < 4.1
    assert_sound(road_map)


@settings(max_examples=30, deadline=None)
@given(st.floats(1.0, 60.0), st.floats(-3.0, 3.0), st.floats(-4.0, 4.0))
def test_a_course_follows_its_curvature(length, heading, turn):
    """An arc ends where trigonometry says, also where its heading passes pi."""
    curvature = turn / length
    course = follow(Place(1.0, 2.0, heading), [(length, curvature, curvature)])
    assert course.headings[-1] == pytest.approx(heading + turn, abs=1e-9)
    chord = length * np.sinc(turn / 2.0 / np.pi)
    end = np.array([1.0, 2.0]) + chord * np.array([np.cos(heading + turn / 2.0), np.sin(heading + turn / 2.0)])
    np.testing.assert_allclose(course.points[-1], end, atol=1e-9)


def test_ways_that_turn_back_are_refused():
    with pytest.raises(InputError, match="without turning back"):
        connect(Place(0.0, 0.0, 0.0), Place(-10.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("make", "why"),
    [
        (lambda: junction([Arm(0.0)]), "two or more"),
        (lambda: junction([Arm(0.0), Arm(0.3)]), "17 degrees apart"),
        (lambda: junction([Arm(-0.1), Arm(2.0 * np.pi + 0.1)]), "11 degrees apart"),
        (lambda: junction([Arm(0.0), Arm(NORTH)], turn_radius=2.0), "4 to 100 m"),
        (lambda: junction([Arm(0.0, 0, 1), Arm(NORTH, 0, 1)]), "nothing leads through"),
        (lambda: junction([Arm(0.0, bend=0.4), Arm(WEST)]), "a bend has a radius of"),
        (
            lambda: junction([Arm(0.0, length=300.0, bend=0.03), Arm(NORTH, length=300.0), Arm(WEST)]),
            "run into each other",
        ),
        (lambda: Arm(np.nan), "finite"),
        (lambda: Arm(0.0, 0, 0), "0 lanes in and 0 out"),
        (lambda: Arm(0.0, turns=("back",)), "turns back"),
        (lambda: roundabout([Arm(0.0, 2), Arm(WEST)]), "more than one lane"),
        (lambda: roundabout([Arm(0.0, control="light"), Arm(WEST)]), "control light"),
        (lambda: roundabout([Arm(k * 2.0 * np.pi / 9.0) for k in range(9)], 12.0), "no room between arms"),
        (lambda: carriageway(100.0, 0, 0), "0 lanes forward and 0 backward"),
        (lambda: carriageway(200.0, bends=((0.0, 0.3),)), "a bend has a radius of"),
        (lambda: carriageway(400.0, bends=((0.0, 0.02),)), "runs into itself"),
        (lambda: carriageway(200.0, 2, change=LaneChange(50.0, 100.0, 4)), "one more or one less"),
        (
            lambda: carriageway(200.0, 2, bends=((0.0, 0.0), (90.0, 0.01)), change=LaneChange(50.0, 100.0, 1)),
            "bends between",
        ),
        (lambda: CrossSection(lane_width=1.0), "2 to 8 m"),
        (lambda: CrossSection(wear=1.5), "wear"),
    ],
)
def test_layouts_without_room_are_refused_in_words(make, why):
    with pytest.raises(InputError, match=why):
        make()
