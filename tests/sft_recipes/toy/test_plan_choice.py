from itertools import pairwise

import numpy as np
import pytest
import torch

from olt_sft_recipes.toy.birds_eye import FRONT, OFFSETS, STATIONS, route_cells
from olt_sft_recipes.toy.image_encoder import SECONDS_AHEAD, Sight
from olt_sft_recipes.toy.occupancy import Occupancy
from olt_sft_recipes.toy.patience import Patience
from olt_sft_recipes.toy.plan_choice import CRUISE, WAY_WORTH, choose_plan, contacts_of_plan
from olt_sft_recipes.toy.route_line import RouteLine

SPEED = 8.0
AHEAD = np.column_stack([SPEED * 0.1 * np.arange(1, 65), np.zeros(64), np.zeros(64)])
ROUTE = np.column_stack([np.linspace(0.0, 80.0, 20), np.zeros(20)])


def see(taken=None, held=None, road=(-99.0, 99.0)):
    """The occupancy of a straight route with what is taken, a function of station, offset and seconds; held; road."""
    route = torch.full((1, len(SECONDS_AHEAD) + 2, len(STATIONS), len(OFFSETS)), -9.0)
    if taken is not None:
        mask = taken(STATIONS[:, None], OFFSETS, np.array(SECONDS_AHEAD)[:, None, None])
        route[0, :-2][torch.from_numpy(np.broadcast_to(mask, route[0, :-2].shape).copy())] = 9.0
    if held is not None:
        route[0, -2][torch.from_numpy(np.abs(STATIONS - held) < 1.5)] = 9.0
    route[0, -1][:, torch.from_numpy((road[0] < OFFSETS) & (road[1] > OFFSETS))] = 9.0
    return Occupancy.of(Sight(torch.zeros(1, 1, 1), route), RouteLine.of(route_cells(ROUTE, 0.0)))


def at_speed(speed):
    return np.column_stack([speed * 0.1 * np.arange(1, 65), np.zeros(64), np.zeros(64)])


def test_a_free_road_is_driven_as_the_plan_does():
    chosen = choose_plan(AHEAD[None], SPEED, see())
    assert chosen[:, :2] == pytest.approx(AHEAD[:, :2], abs=0.3)


def test_it_stops_before_a_wall():
    chosen = choose_plan(AHEAD[None], SPEED, see(lambda station, offset, seconds: (station > 22.0) & (offset < 99.0)))
    assert 2.0 < chosen[39, 0] < 22.0 - FRONT


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_it_goes_around_what_stands_at_one_side(side):
    chosen = choose_plan(
        AHEAD[None], SPEED, see(lambda station, offset, seconds: (abs(station - 28.0) < 4.0) & (side * offset < 0.3))
    )
    beside = np.abs(chosen[:, 0] - 26.0) < 5.0
    assert (side * chosen[beside, 1] > 0.45).all() and chosen[-1, 0] > 45.0


def test_it_waits_where_only_the_ground_beside_the_road_is_free():
    wall = see(lambda station, offset, seconds: (station > 25.0) & (abs(offset) < 2.5), road=(-2.6, 2.6))
    chosen = choose_plan(AHEAD[None], SPEED, wall)
    assert np.abs(chosen[:, 1]).max() < 1.5 and chosen[-1, 0] < 22.0


def test_it_lets_somebody_cross_and_goes_on():
    """Who crosses from the right is on the way after two to three seconds."""
    crossing = see(
        lambda station, offset, seconds: (abs(station - 22.0) < 2.5) & (abs(offset + 8.0 - 4.0 * seconds) < 2.0)
    )
    chosen = choose_plan(AHEAD[None], SPEED, crossing)
    assert contacts_of_plan(AHEAD, crossing) > 0.5 and contacts_of_plan(chosen, crossing) < 0.05


def test_it_stays_behind_who_is_slow_while_somebody_comes():
    def taken(station, offset, seconds):
        slow = (abs(station - 14.0 - 2.0 * seconds) < 3.0) & (abs(offset) < 1.5)
        return slow | ((abs(station - 45.0 + 9.0 * seconds) < 5.0) & (abs(offset - 3.5) < 1.5))

    chosen = choose_plan(AHEAD[None], SPEED, see(taken, road=(-2.6, 6.0)))
    assert chosen[19, 1] < 1.2 and np.hypot(*np.diff(chosen[30:32, :2], axis=0)[0]) / 0.1 < 4.0


def test_who_has_gone_by_then_is_no_contact():
    chosen = choose_plan(AHEAD[None], SPEED, see(lambda station, offset, seconds: (station > 35.0) & (seconds < 0.9)))
    assert chosen[-1, 0] > 45.0


def test_it_does_not_pass_a_line_that_is_held():
    chosen = choose_plan(AHEAD[None], SPEED, see(held=24.0))
    assert chosen[29, 0] + FRONT < 24.0


def test_a_line_under_the_vehicle_holds_it_no_more():
    assert choose_plan(AHEAD[None], SPEED, see(held=2.0))[-1, 0] > 45.0


def test_who_stands_starts_at_once_where_all_is_free():
    late = np.column_stack([0.5 * 0.8 * (0.1 * np.arange(1, 65)) ** 2, np.zeros(64), np.zeros(64)])
    chosen = choose_plan(late[None], 0.0, see())
    assert chosen[19, 0] > 1.5 * late[19, 0]


def test_who_stands_close_behind_somebody_stands():
    chosen = choose_plan(
        at_speed(1.0)[None], 0.0, see(lambda station, offset, seconds: (station > 6.0) & (offset < 99.0))
    )
    assert chosen[39, 0] < 1.0


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_it_does_not_go_straight_on_where_the_route_turns(side):
    """The plan that is drawn does, and leaves the grid, beside which nothing is told of others or of the road."""
    angle = np.linspace(0.0, 0.5 * np.pi, 8)
    turn = np.column_stack([20.0 + 10.0 * np.sin(angle), side * (10.0 - 10.0 * np.cos(angle))])
    route = np.concatenate([[[0.0, 0.0], [10.0, 0.0]], turn, [[30.0, side * 20.0], [30.0, side * 40.0]]])
    line = RouteLine.of(route_cells(route, 0.0))
    free = see()
    chosen = choose_plan(at_speed(10.0)[None], 10.0, Occupancy(free.route, free.held, free.road, line))
    assert np.abs(line.locate(chosen[:40])[:, 1]).max() < 3.0
    assert np.hypot(*(chosen[39, :2] - chosen[38, :2])) / 0.1 < 0.7 * 10.0


def drive_on(pose, speed, taken, steps, road):
    """Pose in the world, along whose x axis a straight road leads, and speed after plans of 0.4 s each."""
    for _ in range(steps):
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        route = np.column_stack([ROUTE[:, 0], np.full(len(ROUTE), -pose[1])]) @ np.array([[cos, -sin], [sin, cos]])
        seen = see(lambda station, offset, seconds, x=pose[0]: taken(station + x, offset, seconds), road=road)
        line = RouteLine.of(route_cells(route, 0.0))
        chosen = choose_plan(at_speed(max(speed, 1.0))[None], speed, Occupancy(seen.route, seen.held, seen.road, line))
        speed = float(np.hypot(*(chosen[3, :2] - chosen[2, :2]))) / 0.1
        x, y, yaw = chosen[3]
        pose = pose + np.array([cos * x - sin * y, sin * x + cos * y, yaw])
    return pose, speed


def test_who_waits_behind_a_van_leaves_room_to_get_around_it():
    """Oncoming traffic takes the other lane all the time; the van, whose end is at 40 m, stays."""

    def taken(x, offset, seconds):
        return ((abs(x - 43.0) < 3.0) & (abs(offset) < 1.5)) | ((offset > 1.6) & (seconds > 0.0))

    pose, speed = drive_on(np.zeros(3), 6.0, taken, 30, (-2.6, 6.0))
    assert speed < 1.0 and 4.5 < 40.0 - FRONT - pose[0] < 12.0


def test_it_does_not_come_back_into_who_is_beside():
    """It is in the oncoming lane, and a car that is as fast has its own, from the vehicle's middle to behind it."""

    def beside(station, offset, seconds):
        return (abs(station - SPEED * seconds + 1.0) < 3.0) & (abs(offset) < 1.3)

    aside = RouteLine.of(route_cells(ROUTE - (0.0, 3.5), 0.0))
    free, lane = see(road=(-2.6, 6.0)), see(beside, road=(-2.6, 6.0))
    free, lane = (Occupancy(seen.route, seen.held, seen.road, aside) for seen in (free, lane))
    back, chosen = (choose_plan(at_speed(SPEED)[None], SPEED, seen) for seen in (free, lane))
    assert contacts_of_plan(back, lane) > 0.3 and contacts_of_plan(chosen, lane) < 0.02


@pytest.mark.parametrize(("others", "passes"), [(9.0, False), (3.0, True)])
def test_who_is_as_fast_as_a_free_road_is_driven_is_not_passed_in_the_oncoming_lane(others, passes):
    """The plan that is drawn would; nobody comes. Who is slow is passed."""

    def taken(station, offset, seconds):
        return (abs(station - 14.0 - others * seconds) < 3.0) & (abs(offset) < 1.5)

    drawn = at_speed(12.0)
    drawn[:, 1] = 3.2 * np.clip(drawn[:, 0] / 10.0, 0.0, 1.0)
    chosen = choose_plan(drawn[None], 10.0, see(taken, road=(-2.6, 6.0)))
    assert (np.abs(chosen[:40, 1]).max() > 2.0) == passes


def test_who_has_waited_long_takes_a_risk_that_does_not_go_away_but_none_that_is_great():
    patience, line = Patience(), see(held=8.0)
    unsure, sure = (Occupancy(line.route, share * line.held, line.road, line.line) for share in (0.08, 0.9))
    worth = {at: patience.way_worth(round(1e6 * at), 0.0) for at in range(25)}
    assert [worth[at] == WAY_WORTH for at in (0, 1, 2)] == [True, True, False]
    assert all(later >= earlier for earlier, later in pairwise(worth.values())) and worth[24] == worth[23]

    def made(occupancy, at):
        return FRONT + choose_plan(at_speed(2.0)[None], 0.0, occupancy, worth[at])[29, 0]

    assert made(unsure, 0) < 7.5 < made(unsure, 24) and made(sure, 24) < 7.5
    assert patience.way_worth(25_000_000, 3.0) == WAY_WORTH


def test_a_bend_is_not_driven_faster_than_it_can_be():
    angle = np.linspace(0.0, 80.0, 20) / 10.0
    route = 10.0 * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)])
    line = RouteLine.of(route_cells(route, 0.0))
    free = see()
    poses, _ = line.path_beside(SPEED * 0.1 * np.arange(1, 65), np.zeros(64))
    chosen = choose_plan(poses[None], SPEED, Occupancy(free.route, free.held, free.road, line))
    assert np.hypot(*np.diff(chosen[-3:, :2], axis=0)[-1]) / 0.1 < 0.8 * CRUISE
