import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_sft_recipes.toy.birds_eye import OFFSETS, STATIONS, route_cells
from olt_sft_recipes.toy.free_path import find_free_path
from olt_sft_recipes.toy.image_encoder import SECONDS_AHEAD
from olt_sft_recipes.toy.occupancy import Occupancy
from olt_sft_recipes.toy.paces import ACCELERATIONS, pace_ways
from olt_sft_recipes.toy.route_line import RouteLine
from olt_sft_recipes.toy.tried_paths import LONG, SHORT, TriedPath, drawn_paths, path_aside

STRAIGHT = np.column_stack([np.linspace(0.0, 80.0, 20), np.zeros(20)])
LINE = RouteLine.of(route_cells(STRAIGHT, 0.0))
ROAD = np.ones((len(STATIONS), len(OFFSETS)))


def occupancy(
    taken=lambda second, station, offset: np.zeros(np.broadcast_shapes(second.shape, station.shape, offset.shape)),
    road=ROAD,
    line=LINE,
):
    route = taken(np.array(SECONDS_AHEAD)[:, None, None], STATIONS[:, None], OFFSETS).astype(float)
    return Occupancy(route, np.zeros(len(STATIONS)), road, line)


@given(speed=st.floats(0.0, 20.0), most=st.floats(0.0, 20.0))
def test_paces_keep_their_acceleration_never_go_back_and_do_not_exceed_their_speed(speed, most):
    ways, speeds = pace_ways(speed, most)
    steps = np.diff(ways, prepend=0.0)
    assert (steps >= 0.0).all() and (speeds >= 0.0).all() and speeds.max() <= max(speed, most) + 1e-9
    first = ACCELERATIONS[0]
    expected = np.clip(speed + 0.1 * first, 0.0, np.where(first > 0.0, max(speed, most), np.inf))
    assert speeds[:, 0] == pytest.approx(expected)


def test_a_braking_pace_makes_the_way_of_its_deceleration():
    ways, _ = pace_ways(8.0, 8.0)
    (both,) = np.flatnonzero((ACCELERATIONS == -3.0).all(axis=0))
    assert ways[both, -1] == pytest.approx(8.0**2 / 6.0, rel=0.02)


@pytest.mark.parametrize("over", [SHORT, LONG])
def test_a_path_aside_gets_there_in_its_way_and_begins_as_the_vehicle_goes(over):
    path = path_aside(LINE, 2.5, over, 6.0)
    least, seconds, most = over
    _, left, turned = path.beside_at(np.array([0.0, min(max(seconds * 6.0, least), most) + 1.0, 60.0]))
    assert left == pytest.approx([0.0, 2.5, 2.5], abs=0.05) and turned[0] == pytest.approx(0.0, abs=0.02)
    assert (np.diff(path.arc) > 0.0).all() and path.bends.max() < 0.35


def test_drawn_plans_go_on_along_the_route_also_such_that_stand():
    plan = np.column_stack([0.3 * np.arange(1, 65), np.full(64, 0.0), np.zeros(64)])
    for path in drawn_paths(np.stack([plan, np.zeros((64, 3))]), LINE):
        assert path.poses_at(np.array([5.0]))[0] == pytest.approx([5.0, 0.0, 0.0]) and path.arc[-1] > 60.0


def test_places_where_nothing_moves_are_left_out_of_a_path():
    poses = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [3.0, 0.0, 0.0]])
    assert TriedPath.of(poses, LINE).arc.tolist() == [0.0, 1.0, 3.0]


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_freest_path_leads_around_what_stands_and_back(side):
    def stands(second, station, offset):
        return (abs(station - 25.0) < 4.0) & (side * offset < 0.5) & (second >= 0.0)

    path = find_free_path(occupancy(stands), None)
    _, left, _ = path.beside_at(np.array([0.0, 24.0, 50.0]))
    assert side * left[1] > 1.0 and abs(left[0]) < 0.1 and abs(left[2]) < 0.6


def test_the_freest_path_stays_on_the_road():
    def stands(second, station, offset):
        return (abs(station - 25.0) < 4.0) & (offset < 0.5) & (second >= 0.0)

    narrow = ROAD * (OFFSETS < 2.2)
    path = find_free_path(occupancy(stands, narrow), None)
    assert path.beside_at(np.arange(0.0, 45.0))[1].max() < 1.6


def test_who_has_gone_when_the_vehicle_comes_is_not_driven_around():
    def leaves(second, station, offset):
        return (abs(station - 30.0) < 4.0) & (second < 1.0) & (abs(offset) < 1.5)

    assert np.abs(find_free_path(occupancy(leaves), 8.0).places[:, 1]).max() < 0.3
    assert np.abs(find_free_path(occupancy(leaves), None).places[:, 1]).max() < 0.3
