import numpy as np
import pytest

from olt_sft_recipes.toy.birds_eye import FRONT, route_cells
from olt_sft_recipes.toy.route_line import LATERAL, ROAD, RouteLine

STRAIGHT = np.column_stack([np.linspace(0.0, 80.0, 20), np.zeros(20)])


def line_of(route, known=True):
    return RouteLine.of(route_cells(route, 0.0), known)


def circle(radius):
    angle = np.linspace(0.0, 80.0, 200) / radius
    return radius * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)])


def beside(metres):
    return np.column_stack([np.linspace(1.0, 30.0, 40), np.full(40, metres), np.zeros(40)])


def test_offsets_are_metres_to_the_left():
    places = np.array([[10.0, 1.5], [20.3, -2.5], [5.0, 0.0]])
    assert line_of(STRAIGHT).offsets(places) == pytest.approx([1.5, -2.5, 0.0])


def test_offsets_in_a_bend_are_those_from_its_middle():
    angle = np.linspace(0.1, 1.0, 10)
    places = 28.0 * np.column_stack([np.sin(angle), -np.cos(angle)]) + [0.0, 30.0]
    assert line_of(circle(30.0)).offsets(places) == pytest.approx(np.full(10, 2.0), abs=0.15)


@pytest.mark.parametrize(
    ("metres", "share"), [(0.0, 0.0), (ROAD[1], 0.0), (ROAD[0], 1.0), (3.5, 0.0), (ROAD[3], 1.0), (-1.6, 0.5)]
)
def test_the_road_ends_sooner_to_the_right_than_to_the_left(metres, share):
    assert line_of(STRAIGHT).off_road(beside(metres)) == pytest.approx(share)


def test_who_comes_back_is_off_the_road_for_less_time():
    back = beside(-2.0)
    back[:, 1] = np.linspace(-2.0, 0.0, 40)
    stays, comes = line_of(STRAIGHT).off_road(np.stack([beside(-2.0), back]))
    assert comes < 0.6 * stays


def test_the_front_leaves_the_road_first():
    turned = beside(-0.8)
    turned[:, 2] = -0.2
    assert line_of(STRAIGHT).off_road(turned) == pytest.approx(np.clip(0.8 + FRONT * np.sin(0.2) - 1.1, 0.0, 1.0))


def test_without_a_route_nothing_is_known_of_the_road():
    assert line_of(STRAIGHT, known=False).off_road(beside(-3.0)) == 0.0


def test_it_goes_on_beyond_a_pose_at_the_same_distance_to_its_side():
    poses = line_of(STRAIGHT).beyond(np.array([12.3, 1.0, 0.0]))
    assert (np.diff(poses[:, 0]) > 0.0).all() and poses[0, 0] > 12.3 and poses[:, 1] == pytest.approx(1.0)


def test_bends_are_driven_at_the_speed_of_their_radius():
    assert line_of(circle(12.0)).bend_speed == pytest.approx(np.sqrt(LATERAL * 12.0), rel=0.1)
    assert line_of(STRAIGHT).bend_speed > 100.0
