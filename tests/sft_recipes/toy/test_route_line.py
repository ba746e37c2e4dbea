import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_sft_recipes.toy.birds_eye import route_cells
from olt_sft_recipes.toy.route_line import LATERAL, RouteLine

STRAIGHT = np.column_stack([np.linspace(0.0, 80.0, 20), np.zeros(20)])


def line_of(route):
    return RouteLine.of(route_cells(route, 0.0))


def circle(radius):
    angle = np.linspace(0.0, 80.0, 200) / radius
    return radius * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)])


def test_places_are_told_by_station_metres_to_the_left_and_turn():
    poses = np.array([[10.0, 1.5, 0.1], [20.3, -2.5, 0.0], [-3.0, 0.0, -0.2], [90.0, 4.0, 0.0]])
    assert line_of(STRAIGHT).locate(poses) == pytest.approx(poses)


def test_places_in_a_bend_are_told_from_its_middle():
    angle = np.linspace(0.1, 1.0, 10)
    poses = np.column_stack([28.0 * np.sin(angle), 30.0 - 28.0 * np.cos(angle), angle])
    told = line_of(circle(30.0)).locate(poses)
    assert told[:, 0] == pytest.approx(30.0 * angle, abs=0.3)
    assert told[:, 1] == pytest.approx(np.full(10, 2.0), abs=0.15) and np.abs(told[:, 2]).max() < 0.05


@given(radius=st.floats(15.0, 200.0), left=st.floats(-4.0, 4.0))
def test_a_path_beside_the_line_is_where_it_was_asked_to_be(radius, left):
    line, stations = line_of(circle(radius)), np.arange(3.0, 40.0)
    offsets = left * np.sin(stations / 15.0)
    poses, turned = line.path_beside(stations, offsets)
    told = line.locate(poses)
    assert told[:, 2] == pytest.approx(turned, abs=0.1)
    assert told[:, 0] == pytest.approx(stations, abs=0.4) and told[:, 1] == pytest.approx(offsets, abs=0.15)


def test_it_goes_on_beyond_a_pose_at_the_same_distance_to_its_side():
    poses = line_of(STRAIGHT).beyond(np.array([12.3, 1.0, 0.0]))
    assert (np.diff(poses[:, 0]) > 0.0).all() and poses[0, 0] > 12.3 and poses[:, 1] == pytest.approx(1.0)


def test_beyond_its_end_nothing_goes_on():
    assert line_of(STRAIGHT).beyond(np.array([500.0, 0.0, 0.0])).shape == (0, 3)


def test_bends_are_driven_at_the_speed_of_their_radius():
    assert line_of(circle(12.0)).bend_speed == pytest.approx(np.sqrt(LATERAL * 12.0), rel=0.1)
    assert line_of(STRAIGHT).bend_speed > 100.0
