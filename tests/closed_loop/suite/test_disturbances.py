"""Pushes: smooth, and as strong as they say."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from olt_closed_loop.privileged.paths import Path
from olt_closed_loop.privileged.plan import Drive, plan_drive
from olt_closed_loop.privileged.speeds import Progress
from olt_closed_loop.privileged.truth import Truth
from olt_closed_loop.scenes.scene import Agent
from olt_closed_loop.suite.disturbances import (
    HESITATES,
    PUSH_US,
    SHORTEST_US,
    Disturbance,
    Push,
    misjudged_drive,
)
from olt_generator.seeds import make_generator
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

STEP_US = 20_000
ROUTE = np.column_stack([np.linspace(0.0, 400.0, 100), np.zeros(100)])
TRUTH = Truth(ROUTE, shapely.box(-20.0, -1.8, 420.0, 1.8), (), (), DEFAULT_VEHICLE, 10.0, 20_000_000)


def straight_drive(speed):
    arc = np.arange(0.0, 400.0, 1.0)
    times = np.arange(0, 20_000_001, 100_000)
    line = CubicSpline(arc, np.column_stack([arc, np.zeros_like(arc)]))
    return Drive(Path(line, float(arc[-1])), Progress(times, speed * times * 1e-6, False))


@given(st.floats(-1.0, 1.0), st.floats(-0.1, 0.1), st.floats(-2.0, 2.0), st.floats(8.0, 14.0))
def test_a_push_ends_at_its_offset_angle_and_speed(offset, angle, faster, speed):
    push = Push(3_000_000, offset, angle, faster)
    x, y, yaw = push.move(straight_drive(speed), push.times(STEP_US))
    assert y[0] == pytest.approx(0.0, abs=1e-9) and yaw[0] == pytest.approx(0.0, abs=1e-9)
    assert y[-1] == pytest.approx(offset, abs=1e-6) and yaw[-1] == pytest.approx(angle, abs=1e-6)
    speeds = np.hypot(np.diff(x), np.diff(y)) / (1e-6 * STEP_US)
    assert speeds[0] == pytest.approx(speed, abs=0.1) and speeds[-1] == pytest.approx(speed + faster, abs=0.1)
    # The rig moves along its heading.
    np.testing.assert_allclose(np.arctan2(np.diff(y), np.diff(x)), 0.5 * (yaw[1:] + yaw[:-1]), atol=2e-3)


def test_who_stands_is_not_pushed():
    push = Push(1_000_000, 1.0, 0.1, 2.0)
    x, y, yaw = push.move(straight_drive(0.0), push.times(STEP_US))
    assert np.all(x == 0.0) and np.all(y == 0.0) and np.all(yaw == 0.0)


@given(st.integers(0, 10_000), st.integers(SHORTEST_US, 10_000_000))
def test_pushes_leave_time_between_them(seed, every_us):
    pushes = Disturbance(every_us).pushes(make_generator("test", seed), 13_000_000)
    assert all(push.begin_us % 100_000 == 0 and push.end_us <= 13_000_000 for push in pushes)
    gaps = np.diff([push.begin_us for push in pushes])
    assert np.all(gaps >= every_us / 2 - 100_000) and np.all(gaps > PUSH_US)
    assert all(push.begin_us >= 2_000_000 for push in pushes)


@given(st.integers(0, 10_000))
def test_as_many_pushes_misjudge_the_way_as_is_asked_and_nothing_else_changes(seed):
    def pushes(**shares):
        return Disturbance(**shares).pushes(make_generator("test", seed), 13_000_000)

    assert {push.misjudged for push in pushes()} == {None}
    assert {push.misjudged for push in pushes(blind=1.0)} == {"blind"}
    assert {push.misjudged for push in pushes(hesitant=1.0)} == {"hesitant"}
    assert pushes(blind=1.0) == tuple(replace(push, misjudged="blind") for push in pushes(hesitant=1.0))


def test_the_shares_are_kept():
    asked = Disturbance(blind=0.5, hesitant=0.25)
    drawn = [push.misjudged for seed in range(300) for push in asked.pushes(make_generator("test", seed), 13_000_000)]
    share = {kind: drawn.count(kind) / len(drawn) for kind in ("blind", "hesitant", None)}
    assert share == pytest.approx({"blind": 0.5, "hesitant": 0.25, None: 0.25}, abs=0.05)


@given(st.floats(0.0, 14.0))
def test_who_hesitates_brakes_to_a_stand_and_no_farther(speed):
    push = Push(3_000_000, 0.0, 0.0, 0.0, "hesitant")
    times = push.times(STEP_US)
    before = straight_drive(speed)
    x, _, _ = push.move(misjudged_drive(TRUTH, push, before), times)
    assert x[0] == pytest.approx(before.poses(times[:1])[0][0]) and (np.diff(x) >= 0.0).all()
    speeds = np.diff(x) / (1e-6 * STEP_US)
    assert speeds[-1] == pytest.approx(max(speed - HESITATES * 1e-6 * PUSH_US, 0.0), abs=0.2)


def test_who_is_blind_sees_neither_others_nor_lines_that_are_held():
    poses = np.array([[48.0, 0.0, 0.75, 0.0]] * 2)
    wall = Agent("wall", "automobile", 4.0, 2.0, 1.5, np.array([0, 20_000_000]), poses)
    push = Push(3_000_000, 0.0, 0.0, 0.0, "blind")
    seen = plan_drive(replace(TRUTH, agents=(wall,)), 0, 0.0, 0.0, 10.0)
    blind = misjudged_drive(replace(TRUTH, agents=(wall,)), push, seen)
    times = push.times(STEP_US)
    assert blind.poses(times)[0][0] == pytest.approx(seen.poses(times)[0][0], abs=0.05)
    assert blind.poses(times)[0][-1] > seen.poses(times)[0][-1] + 1.0
