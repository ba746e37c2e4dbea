import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_sft_recipes.toy.birds_eye import route_cells
from olt_sft_recipes.toy.route_line import RouteLine
from olt_sft_recipes.toy.tried_plans import (
    ASIDE,
    BRAKING,
    PACES,
    SPEEDING,
    paced_plans,
    path_beside,
    try_plans,
    ways_along,
)

SPEED, BEND = 8.0, 0.02
TIME = 0.1 * np.arange(1, 65)
FIRST_FASTER = 1 + len(BRAKING) + 1


def along_bend(ways):
    yaw = BEND * ways
    return np.stack([np.sin(yaw) / BEND, (1.0 - np.cos(yaw)) / BEND, yaw], axis=-1)


def straight_line():
    return RouteLine.of(route_cells(np.column_stack([np.linspace(0.0, 80.0, 20), np.zeros(20)]), 0.0))


def test_braking_plans_brake_along_the_same_path():
    plans = paced_plans(along_bend(SPEED * TIME), SPEED, 99.0)
    for braking, plan in zip(BRAKING, plans[1:], strict=False):
        assert plan[-1, 2] / BEND == pytest.approx(min(SPEED**2 / (2.0 * braking), 51.2), rel=0.02)
        assert np.allclose(plan[:, 1], (1.0 - np.cos(plan[:, 2])) / BEND, atol=0.05)


def test_faster_plans_come_sooner_to_the_speed_that_the_plan_ends_with():
    path = along_bend(np.concatenate([0.5 * TIME**2, 21.0 + np.arange(20.0)]))
    for rate, plan in zip(SPEEDING[1:], paced_plans(path, 0.0, 99.0)[FIRST_FASTER + 1 :], strict=True):
        speeds = np.diff(ways_along(plan)) / 0.1
        assert speeds[:20] == pytest.approx(rate * TIME[:20] + 0.05 * rate, rel=0.05)
        assert speeds.max() == pytest.approx(5.9, rel=0.02)
        assert np.allclose(plan[:, 1], (1.0 - np.cos(plan[:, 2])) / BEND, atol=0.05)


def test_in_bends_they_do_not_come_to_more_than_those_allow():
    path = along_bend(np.concatenate([0.5 * 0.5 * TIME**2, 10.5 + np.arange(30.0)]))
    plan = paced_plans(path, 0.0, 2.0)[-1]
    assert ways_along(plan)[19] == pytest.approx(3.0, rel=0.01)


def test_a_plan_that_slows_down_is_not_sped_up():
    path = along_bend(np.concatenate([SPEED * TIME - 0.5 * TIME**2, 31.0 + np.arange(20.0)]))
    plans = paced_plans(path, SPEED, 99.0)
    assert np.allclose(plans[FIRST_FASTER - 1 :], plans[0], atol=1e-9)


def test_a_standing_vehicle_gets_plans_that_stand():
    assert not paced_plans(np.zeros((64, 3)), 0.0, 99.0).any()


@given(speed=st.floats(0.0, 20.0), rate=st.floats(-1.0, 2.0), aside=st.sampled_from(ASIDE), bend=st.floats(0.5, 50.0))
def test_no_plan_jumps_or_goes_back(speed, rate, aside, bend):
    ends = np.minimum(TIME, -speed / rate) if rate < 0.0 else TIME
    ways = speed * ends + 0.5 * rate * ends**2
    path = np.concatenate([along_bend(ways), along_bend(ways[-1] + np.arange(2.0, 40.0))])
    plans = paced_plans(path_beside(path, aside, speed), speed, bend)
    steps = np.diff(ways_along(plans), prepend=0.0)
    assert plans.shape == (PACES, 64, 3) and np.isfinite(plans).all()
    assert (steps >= 0.0).all() and steps.max() < 0.1 * (speed + 2.0 * 6.4) * 1.3 + 1e-6


def test_beside_a_plan_is_so_far_to_its_left_in_time_and_no_sharper_than_it_can_be_driven():
    for speed in (0.5, 3.0, 8.0):
        beside = path_beside(np.column_stack([np.arange(60.0), np.zeros(60), np.zeros(60)]), 0.6, speed)
        assert beside[-1, 1] == pytest.approx(0.6) and beside[int(max(2.5 * speed, 8.0)) + 1, 1] == pytest.approx(0.6)
        sharpest = np.abs(np.diff(beside[:, 2])).max()
        assert sharpest * speed**2 < 1.0


def test_the_first_of_what_is_tried_is_the_plan_itself_and_all_begin_where_the_vehicle_is():
    plan = np.column_stack([SPEED * TIME, np.zeros(64), np.zeros(64)])
    tried, aside = try_plans(plan[None], SPEED, straight_line())
    assert np.array_equal(tried[0, 0], plan) and aside.tolist() == list(ASIDE)
    assert np.linalg.norm(tried[:, :, 0, :2], axis=-1).max() <= 0.1 * SPEED + 0.05


def test_who_gets_farther_than_its_plan_goes_on_along_the_route():
    bend = RouteLine.of(route_cells(along_bend(np.linspace(0.0, 80.0, 20))[:, :2], 0.0))
    short = along_bend(0.5 * TIME**2)
    fastest = try_plans(short[None], 0.0, bend)[0][0, -1]
    assert ways_along(fastest)[-1] > ways_along(short)[-1] + 5.0
    assert np.allclose(fastest[:, 1], (1.0 - np.cos(fastest[:, 2])) / BEND, atol=0.3)
