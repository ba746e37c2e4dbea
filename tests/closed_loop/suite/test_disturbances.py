"""Pushes: smooth, and as strong as they say."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from olt_closed_loop.privileged.paths import Path
from olt_closed_loop.privileged.plan import Drive
from olt_closed_loop.privileged.speeds import Progress
from olt_closed_loop.suite.disturbances import PUSH_US, SHORTEST_US, Disturbance, Push
from olt_generator.seeds import make_generator

STEP_US = 20_000


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
