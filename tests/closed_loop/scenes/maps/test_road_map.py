"""What is asked of a map: the nearest lane, routes, conflicts, lights; on maps of ours and on poor ones."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_closed_loop.scenes.maps.arms import Arm
from olt_closed_loop.scenes.maps.carriageways import LaneChange, carriageway
from olt_closed_loop.scenes.maps.cross_sections import CrossSection
from olt_closed_loop.scenes.maps.junctions import junction
from olt_closed_loop.scenes.maps.lanes import Lane, Light, Marking
from olt_closed_loop.scenes.maps.road_map import RoadMap
from olt_closed_loop.scenes.maps.signals import SignalPlan, with_signals
from olt_generator.errors import InputError

TOWN = junction([Arm(k * np.pi / 2.0, 2, 2, control="light", crossing=True) for k in range(4)])


def lane(name, points, **more):
    center = np.column_stack([np.array(points, dtype=float), np.zeros(len(points))])
    aside = np.array([0.0, 1.75, 0.0])
    return Lane(name, center, center + aside, center - aside, **more)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-90.0, 90.0), st.floats(-90.0, 90.0), st.floats(-9.0, 9.0)), min_size=1, max_size=8)
)
def test_the_nearest_lane_is_that_of_shapely(rows):
    values = np.array(rows)
    points, headings = values[:, :2], values[:, 2]
    lines = [shapely.LineString(one.center[:, :2]) for one in TOWN.lanes]
    distances = np.array([[line.distance(shapely.Point(point)) for line in lines] for point in points])
    places = TOWN.nearest(points)
    drives = np.array([one.for_cars for one in TOWN.lanes])
    assert drives.sum() < len(TOWN.lanes)
    for row, index in enumerate(places.lanes):
        least = distances[row][drives].min()
        if least > 6.0:
            assert index == -1 and np.isnan(places.offsets[row])
            continue
        assert abs(places.offsets[row]) == pytest.approx(least, abs=1e-8)
        assert distances[row][index] == pytest.approx(least, abs=1e-8)
        along = lines[index].project(shapely.Point(points[row]))
        assert lines[index].interpolate(places.along[row]).distance(lines[index].interpolate(along)) < 1e-6
    same_way = TOWN.nearest(points, headings)
    found = same_way.lanes >= 0
    assert np.all(np.cos(same_way.headings[found] - headings[found]) >= 0.0)
    assert np.all(np.abs(same_way.offsets[found]) >= np.abs(places.offsets[found]) - 1e-8)


def test_sides_and_headings_beside_a_lane():
    road_map = RoadMap((lane("west", [(10.0, 0.0), (-10.0, 1e-9)]),))
    places = road_map.nearest(np.array([[0.0, 2.0], [0.0, -3.0], [0.0, 7.0]]))
    np.testing.assert_allclose(places.offsets, [-2.0, 3.0, np.nan], atol=1e-8)
    np.testing.assert_allclose(places.along, [10.0, 10.0, np.nan], atol=1e-8)
    np.testing.assert_array_equal(places.lanes, [0, 0, -1])
    # A heading on the other side of pi is the same way.
    assert road_map.nearest(np.zeros((1, 2)), np.array([-np.pi + 0.01])).lanes == 0
    assert road_map.nearest(np.zeros((1, 2)), np.array([0.01])).lanes == -1


@pytest.mark.parametrize("lanes", [(), (lane("walk", [(0.0, 0.0), (9.0, 0.0)], type="sidewalk"),)])
def test_a_map_without_lanes_for_cars_answers(lanes):
    road_map = RoadMap(lanes)
    places = road_map.nearest(np.zeros((3, 2)), np.zeros(3))
    assert np.array_equal(places.lanes, [-1, -1, -1]) and np.isnan(places.along).all()
    assert road_map.entries == () == road_map.exits
    assert road_map.lanes_at(np.array([1e6, 1e6])) == []
    assert all(others == () for others in road_map.conflicts.values())


def test_no_lane_under_the_ego_and_lanes_of_one_point():
    road_map = RoadMap((lane("point", [(0.0, 0.0)]), lane("twice", [(0.0, 0.0), (0.0, 0.0)])))
    assert road_map.nearest(np.zeros((1, 2))).lanes == -1
    assert TOWN.lanes_at(np.array([60.0, 60.0])) == []
    assert "arm0_out_0" in TOWN.lanes_at(TOWN.lane("arm0_out_0").center[5])


def test_lanes_that_cross_themselves_have_an_area():
    """A loop: what is inside of its borders counts, and nothing fails."""
    turn = np.linspace(0.0, 2.2 * np.pi, 60)
    loop = np.column_stack([10.0 * np.cos(turn), 10.0 * np.sin(turn), np.zeros(60)])
    crossing = Lane("loop", loop, 0.9 * loop, 1.1 * loop, junction="here")
    road_map = RoadMap((crossing, lane("by", [(-20.0, 0.0), (20.0, 0.0)], junction="here")))
    assert road_map.lanes_at(np.array([10.0, 0.5])) == ["loop", "by"]
    assert road_map.conflicts == {"loop": ("by",), "by": ("loop",)}


def test_a_route_is_the_shortest_and_its_line_runs_along_it():
    ids = TOWN.route("arm3_in_1", "arm0_out_1")
    assert ids == ("arm3_in_1", "arm3_in_1>arm0_out_1", "arm0_out_1")
    line = TOWN.route_line(ids)
    np.testing.assert_array_equal(line[0], TOWN.lane(ids[0]).center[0])
    np.testing.assert_array_equal(line[-1], TOWN.lane(ids[-1]).center[-1])
    steps = np.linalg.norm(np.diff(line[:, :2], axis=0), axis=1)
    assert steps.min() > 0.0 and steps.max() < 2.5
    through = TOWN.route("arm3_in_0", "arm1_out_0", via=("arm3_in_0>arm1_out_0",))
    assert through == ("arm3_in_0", "arm3_in_0>arm1_out_0", "arm1_out_0")


def test_a_route_changes_lanes_where_it_may():
    ids = TOWN.route("arm3_in_0", "arm0_out_1")  # turning right starts in the outer lane
    assert ids[:2] == ("arm3_in_0", "arm3_in_1")
    line = TOWN.route_line(ids)
    for end, lane_id in ((0, "arm3_in_0"), (-1, "arm0_out_1")):
        np.testing.assert_allclose(line[end], TOWN.lane(lane_id).center[end], atol=1e-9)
    headings = np.unwrap(np.arctan2(*np.diff(line[:, :2], axis=0).T[::-1]))
    assert np.abs(np.diff(headings)).max() < 0.1
    solid = replace(TOWN.lane("arm3_in_0"), right_marking=Marking("solid", False))
    unknown = replace(TOWN.lane("arm3_in_0"), right_marking=Marking("dashed"))
    for kept in (solid, unknown):
        lanes = tuple(kept if one.id == kept.id else one for one in TOWN.lanes)
        with pytest.raises(InputError, match="no way leads from lane arm3_in_0 to lane arm0_out_1"):
            RoadMap(lanes).route("arm3_in_0", "arm0_out_1")


def test_routes_that_are_none_are_refused():
    with pytest.raises(InputError, match="no way leads"):
        TOWN.route("arm0_out_0", "arm0_in_0")
    with pytest.raises(InputError, match="no lane nowhere"):
        TOWN.route("arm0_in_0", "nowhere")
    with pytest.raises(InputError, match="neither follows"):
        TOWN.route_line(["arm0_in_0", "arm0_out_0"])


def test_overtaking_is_no_route_but_oncoming_lanes_are_neighbours():
    road_map = carriageway(100.0)
    assert road_map.lane("forward_0").left_neighbours == ("backward_0",)
    assert road_map.lane("forward_0").left_marking == Marking("dashed", True)
    with pytest.raises(InputError, match="no way leads"):
        road_map.route("forward_0", "backward_0")


def test_kinds_of_lanes_lie_from_the_inside_out():
    section = CrossSection(cycle_width=1.5, sidewalk_width=2.0, wear=0.6, speed_limit=13.9)
    road_map = carriageway(200.0, 2, 1, section, change=LaneChange(60.0, 120.0, 1))
    order = ["forward_0", "forward_1", "forward_cycle", "forward_shoulder", "forward_sidewalk"]
    offsets = [road_map.lane(name).center[0, 1] for name in order]
    assert offsets == sorted(offsets, reverse=True)
    assert [road_map.lane(name).type for name in order] == ["driving", "driving", "cycle", "shoulder", "sidewalk"]
    for inner, outer in pairwise(order):
        one, other = road_map.lane(inner), road_map.lane(outer)
        assert one.right_neighbours == (outer,) and other.left_neighbours == (inner,)
        assert one.right_marking == other.left_marking and one.right_marking is not None
        np.testing.assert_allclose(one.right, other.left, atol=1e-9)
    assert road_map.lane("forward_0").right_marking == Marking("dashed", True, 0.6)
    assert road_map.lane("forward_shoulder").right_marking == Marking("kerb", False, 0.6)
    assert road_map.lane("forward_0").speed_limit == 13.9 and road_map.lane("forward_sidewalk").speed_limit is None


def test_lights_change_in_turns():
    road_map = with_signals(TOWN, SignalPlan(green=8.0, amber=3.0, all_red=1.0), end=30.0)
    assert [light.id for light in road_map.lights] == ["arm0_light", "arm2_light", "arm1_light", "arm3_light"]
    light = {light.id: light for light in road_map.lights}
    seconds = [0.0, 7.99, 8.0, 11.0, 12.0, 23.9, 24.0]
    states = {
        name: [light[name].state_at(round(second * 1e6)) for second in seconds] for name in ("arm0_light", "arm1_light")
    }
    assert states["arm0_light"] == ["green", "green", "amber", "red", "red", "red", "green"]
    assert states["arm1_light"] == ["red", "red", "red", "red", "green", "red", "red"]
    for time_us in range(0, 30_000_000, 250_000):
        open_ = {name for name, one in light.items() if one.state_at(time_us) != "red"}
        assert not (open_ & {"arm0_light", "arm2_light"} and open_ & {"arm1_light", "arm3_light"})
    assert road_map.light_of("arm0_in_0>arm2_out_0") is light["arm0_light"]
    assert road_map.light_of("arm0_in_0") is None and road_map.red_us("arm0_in_0", 1) is None
    red = road_map.red_us("arm0_in_0>arm2_out_0", 30_000_000)
    assert red is not None and [11_000_000, 24_000_000] in red.tolist()


@pytest.mark.parametrize("left_hand", [False, True])
def test_lamps_hang_over_the_kerb_at_the_side_of_the_inbound_lanes(left_hand):
    arms = [Arm(0.3 + k * 2.0, 1, 1, control="light") for k in range(3)]
    road_map = with_signals(junction(arms, left_hand=left_hand), SignalPlan(phases=((0,), (1,), (2,))))
    area = shapely.union_all([shapely.Polygon(outline[:, :2]) for outline in road_map.drivable])
    for k, light in enumerate(road_map.lights):
        assert light.position is not None and light.position[2] > 2.0
        spot = shapely.Point(light.position[:2])
        assert 0.3 < area.distance(spot) < 0.7
        inbound, outbound = (
            shapely.LineString(road_map.lane(f"arm{k}_{way}_0").center[:, :2]) for way in ("in", "out")
        )
        assert inbound.distance(spot) < outbound.distance(spot)


def test_a_light_before_its_first_state_is_unknown():
    light = Light("one", ("a",), np.array([5, 9]), ("red", "off"))
    assert [light.state_at(time) for time in (4, 5, 8, 9)] == ["unknown", "red", "red", "off"]
    assert light.spans("red", 20).tolist() == [[5, 9]] and light.spans("off", 20).tolist() == [[9, 20]]
    assert light.spans("green", 20).shape == (0, 2)


@pytest.mark.parametrize(
    ("plan", "why"),
    [
        (SignalPlan(phases=((0, 1), (1, 2))), "an arm twice"),
        (SignalPlan(phases=((0,), (7,))), "arm 7 has no stop line"),
        (SignalPlan(green=0.0), "longer than 0 s"),
    ],
)
def test_plans_that_no_junction_can_show_are_refused(plan, why):
    with pytest.raises(InputError, match=why):
        with_signals(TOWN, plan)
