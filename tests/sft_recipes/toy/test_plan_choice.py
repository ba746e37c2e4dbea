import numpy as np
import pytest
import torch

from olt_sft_recipes.toy.birds_eye import FRONT, OFFSETS, STATIONS, WORLD_X, WORLD_Y, route_cells
from olt_sft_recipes.toy.image_encoder import SECONDS_AHEAD, Sight
from olt_sft_recipes.toy.plan_choice import Occupancy, choose_plan
from olt_sft_recipes.toy.route_line import RouteLine

SPEED = 8.0
AHEAD = np.column_stack([SPEED * 0.1 * np.arange(1, 65), np.zeros(64), np.zeros(64)])
ROUTE = np.column_stack([np.linspace(0.0, 80.0, 20), np.zeros(20)])


def see(taken=None, held=None, known=True):
    """The occupancy of a straight route with what is taken: a function of station, offset and seconds; and held."""
    route = torch.full((1, len(SECONDS_AHEAD) + 1, len(STATIONS), len(OFFSETS)), -9.0)
    if taken is not None:
        mask = taken(STATIONS[:, None], OFFSETS, np.array(SECONDS_AHEAD)[:, None, None])
        route[0, :-1][torch.from_numpy(np.broadcast_to(mask, route[0, :-1].shape).copy())] = 9.0
    if held is not None:
        route[0, -1][torch.from_numpy(np.abs(STATIONS - held) < 1.5)] = 9.0
    world = torch.full((1, len(SECONDS_AHEAD), len(WORLD_X), len(WORLD_Y)), -9.0)
    return Occupancy.of(Sight(torch.zeros(1, 1, 1), route, world), RouteLine.of(route_cells(ROUTE, 0.0), known))


def test_a_free_plan_is_driven_as_it_is():
    assert np.array_equal(choose_plan(AHEAD[None], SPEED, see()), AHEAD)


def test_it_stops_before_a_wall():
    chosen = choose_plan(AHEAD[None], SPEED, see(lambda station, offset, seconds: (station > 22.0) & (offset < 99.0)))
    assert 2.0 < chosen[-1, 0] < 22.0 - 3.0


def test_it_goes_around_what_stands_at_one_side():
    chosen = choose_plan(
        AHEAD[None], SPEED, see(lambda station, offset, seconds: (abs(station - 20.0) < 4.0) & (offset < 0.3))
    )
    assert chosen[-1, 1] == pytest.approx(0.6) and chosen[-1, 0] > 50.0


def test_who_has_gone_by_then_is_no_contact():
    chosen = choose_plan(AHEAD[None], SPEED, see(lambda station, offset, seconds: (station > 30.0) & (seconds < 0.9)))
    assert np.array_equal(chosen, AHEAD)


def test_it_does_not_pass_a_line_that_is_held():
    chosen = choose_plan(AHEAD[None], SPEED, see(held=20.0))
    assert chosen[-1, 0] + FRONT < 20.0


def test_a_line_under_the_vehicle_holds_it_no_more():
    assert np.array_equal(choose_plan(AHEAD[None], SPEED, see(held=2.0)), AHEAD)


def test_of_two_plans_the_free_one_is_taken():
    left = AHEAD + np.array([0.0, 0.2, 0.0]) * np.minimum(np.arange(64), 15)[:, None]
    wall = see(lambda station, offset, seconds: (station > 18.0) & (offset < 1.3))
    assert choose_plan(np.stack([AHEAD, left]), SPEED, wall)[-1, 1] > 2.0


def test_it_stays_on_the_road_and_waits_where_only_the_ground_beside_it_is_free():
    right = AHEAD - np.array([0.0, 0.1, 0.0]) * np.minimum(np.arange(64), 30)[:, None]
    wall = see(lambda station, offset, seconds: (station > 25.0) & (offset > -2.0))
    chosen = choose_plan(np.stack([AHEAD, right]), SPEED, wall)
    assert chosen[:, 1].min() > -1.2 and chosen[-1, 0] < 22.0


def test_without_a_route_no_road_is_left():
    right = AHEAD - np.array([0.0, 0.1, 0.0]) * np.minimum(np.arange(64), 30)[:, None]
    wall = see(lambda station, offset, seconds: (station > 25.0) & (offset > -2.0), known=False)
    chosen = choose_plan(np.stack([AHEAD, right]), SPEED, wall)
    assert chosen[-1, 1] < -2.0 and chosen[-1, 0] > 40.0


def test_who_stands_starts_at_once_where_all_is_free():
    late = np.column_stack([0.5 * 0.8 * (0.1 * np.arange(1, 65)) ** 2, np.zeros(64), np.zeros(64)])
    chosen = choose_plan(late[None], 0.0, see())
    assert chosen[19, 0] > 2.0 * late[19, 0]


def test_who_stands_starts_gently_where_the_plan_runs_into_somebody():
    fast = np.column_stack([0.5 * 1.5 * (0.1 * np.arange(1, 65)) ** 2, np.zeros(64), np.zeros(64)])
    chosen = choose_plan(fast[None], 0.0, see(lambda station, offset, seconds: (station > 11.0) & (offset < 99.0)))
    assert 2.0 < chosen[39, 0] < 11.0 - 3.0
