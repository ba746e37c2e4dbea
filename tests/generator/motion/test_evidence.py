"""Each doubt on its situation, and none on a clean one."""

import re
from dataclasses import replace

import numpy as np
import pytest

from olt_generator.motion.evidence import Evidence, doubt_standstill, find_doubts
from olt_generator.motion.road_speed import RoadSpeed
from olt_generator.motion.road_structure import Plane

STEPS = 30
ROAD = Plane(400, 0.02, 0.7, 0.65)


def drive(speed=12.0, told=1.0, rival=0.1, direction=20.0):
    """A course of the speed; the road tells a share of its steps, and `direction` is per step, as a logarithm."""
    log_odds = np.where(np.arange(STEPS) < round(told * STEPS), 15.0, 0.0)
    total = float(log_odds.sum())
    speeds = np.full(STEPS, float(speed))
    sign = np.sign(speed) * STEPS
    return RoadSpeed(speeds, np.full(STEPS, 0.2), log_odds, total, direction * sign, rival * total)


CLEAN = Evidence(drive(), np.ones(STEPS, np.bool_), ROAD, Plane(100, 1.0, 0.4, 0.1), np.radians(3.0))


def doubts(**changed):
    return list(find_doubts(replace(CLEAN, **changed)))


@pytest.mark.parametrize(
    "changed",
    [
        {},
        {"road": drive(speed=-2.0)},
        {"road": drive(speed=-5.5)},
        {"road": drive(speed=35.0, told=0.6)},
        {"road": drive(rival=0.5)},
        {"below": None, "above": None},
        {"below": Plane(60, 0.1, 0.35, 0.3)},
        # Lorries beside: their points lie higher, but as many lie on the road.
        {"below": Plane(400, -0.6, 0.4, 0.3)},
        {"aside": np.radians(30.0)},
    ],
    ids=[
        "clean",
        "reverse",
        "fast reverse",
        "fast, partly told",
        "weak rival",
        "no points",
        "few on plane",
        "points on vehicles too",
        "yawed",
    ],
)
def test_what_agrees_is_not_doubted(changed):
    assert doubts(**changed) == []


@pytest.mark.parametrize(
    ("what", "said", "changed"),
    [
        ("view direction", "looks back", {"road": drive(speed=-14.0)}),
        ("view direction", "at 80 degrees", {"aside": np.radians(80.0)}),
        ("speed", "only 30%", {"road": drive(told=0.3)}),
        ("speed", "another course of the speed has 80%", {"road": drive(rival=0.8)}),
        ("direction", r"exp\(15.0\)", {"road": drive(direction=0.5)}),
        ("direction", r"exp\(15.0\)", {"road": drive(speed=-2.0, direction=0.5)}),
        ("upright", "turn the video", {"below": Plane(80, 0.1, 0.3, 0.2), "above": Plane(300, 0.0, 0.75, 0.7)}),
        ("road", "only 20% of the 400 points", {"below": Plane(400, 0.0, 0.2, 0.2)}),
        ("road", "0.50 times as far down", {"below": Plane(400, float(np.log(0.5)), 0.6, 0.1)}),
    ],
)
def test_what_does_not_agree_is_told_with_its_numbers(what, said, changed):
    (doubt,) = doubts(**changed)
    assert doubt.what == what
    assert re.search(said, doubt.why)


def test_only_steps_that_move_must_be_told():
    """A clip that mostly stands is judged by the steps in which it drives."""
    road = drive(told=0.3)
    driven = np.arange(STEPS) < 9
    standing = replace(road, speed=np.where(driven, road.speed, 0.0))
    assert doubts(road=standing, moves=driven) == []


def test_several_reasons_are_all_told():
    found = doubts(road=drive(told=0.2, rival=0.9, direction=0.1), below=Plane(50, 0.0, 0.1, 0.1), above=None)
    assert [doubt.what for doubt in found] == ["speed", "speed", "direction", "road"]


def test_a_standstill_against_which_the_surroundings_move():
    assert list(doubt_standstill(0.05)) == []
    (doubt,) = doubt_standstill(0.8)
    assert doubt.what == "standstill" and "80% of the steps" in doubt.why
