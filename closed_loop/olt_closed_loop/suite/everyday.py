"""Drives in which nothing out of the ordinary happens, for training: roads, bends, junctions, lights, other traffic."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from olt_closed_loop.scenes.maps.lanes import Control
from olt_closed_loop.scenes.maps.signals import SignalPlan, with_signals
from olt_closed_loop.scenes.scene import Agent
from olt_closed_loop.suite.courses import TIMES, Course, at_speed, go_while_there, stand, stream
from olt_closed_loop.suite.event import FRONT_GAP, Event, in_mirror, lead_car
from olt_closed_loop.suite.grounds import Ground, road
from olt_closed_loop.suite.intersections import four, skewed, three

Maker = Callable[[np.random.Generator], Event]
_SOMEBODY = 0.6
_MAIN: tuple[Control, ...] = ("stop", "priority", "stop", "priority")
_MAIN3: tuple[Control, ...] = ("priority", "stop", "priority")
_LIGHTS: tuple[Control, ...] = ("light", "light", "light", "light")
_OWN_GREEN, _OTHERS_GREEN = (1, 3), (0, 2)
_BRAKES = 2.0


def open_road(generator: np.random.Generator, curve: float = 0.0, forward: int = 1) -> Event:
    """A road, at times with somebody ahead and with traffic that comes."""
    ground = road(generator, forward, curve * float(generator.choice([-1.0, 1.0])), 1.5)
    agents: list[Agent] = []
    if generator.random() < _SOMEBODY:
        pace = ground.cruise * float(generator.uniform(0.9, 1.05))
        agents += lead_car(ground, float(generator.uniform(14.0, 40.0)), pace)
    return Event(ground, (*agents, *_comes_by(ground, generator, "backward_0")))


def junction_drive(
    generator: np.random.Generator,
    roads: Callable[..., Ground],
    goal: int,
    controls: tuple[Control, ...],
) -> Event:
    """A junction on which the ego goes first; others wait for it, or leave."""
    ground = roads(generator, goal=goal, controls=controls)
    return Event(ground, tuple(_harmless(ground, generator, len(controls) - 1)))


def green_light(generator: np.random.Generator, goal: int) -> Event:
    """A junction with lights that are green for the ego."""
    ground = four(generator, goal=goal, controls=_LIGHTS)
    plan = SignalPlan((_OWN_GREEN, _OTHERS_GREEN), green=40.0, start=-float(generator.uniform(1.0, 8.0)))
    ground = replace(ground, road_map=with_signals(ground.road_map, plan))
    return Event(ground, tuple(_harmless(ground, generator, 3)))


def red_light(generator: np.random.Generator, goal: int) -> Event:
    """A junction whose light turns green only after the ego has come to it."""
    ground = four(generator, goal=goal, controls=_LIGHTS)
    turns = ground.arrival(ground.crux) + float(generator.uniform(0.0, 5.0))
    plan = SignalPlan((_OWN_GREEN, _OTHERS_GREEN), green=12.0, start=turns)
    ground = replace(ground, road_map=with_signals(ground.road_map, plan))
    return Event(ground, tuple(_harmless(ground, generator, 3)))


def traffic_stops(generator: np.random.Generator, curve: float) -> Event:
    """The car ahead brakes, stands for a while, and goes on."""
    ground = road(generator, curve=curve)
    brakes, stands = float(generator.uniform(3.0, 7.0)), float(generator.uniform(2.0, 5.0))
    stops = brakes + ground.cruise / _BRAKES
    knots = ((0.0, ground.cruise), (brakes, ground.cruise), (stops, 0.0), (stops + stands, 0.0))
    times, speeds = np.array([*knots, (stops + stands + 6.0, ground.cruise)]).T
    steps = np.diff(TIMES, prepend=TIMES[0])
    gap = float(generator.uniform(10.0, 20.0))
    stations = ground.start + FRONT_GAP + gap + np.cumsum(steps * np.interp(TIMES, times, speeds))
    agents = go_while_there("lead", "automobile", ground.course, stations)
    return Event(ground, (*agents, *_comes_by(ground, generator, "backward_0")))


def _comes_by(ground: Ground, generator: np.random.Generator, lane: str) -> list[Agent]:
    """Cars on the other side of the road, at times none."""
    if generator.random() > _SOMEBODY:
        return []
    course = Course(ground.road_map.lane(lane).center)
    gap, first = float(generator.uniform(2.0, 6.0)), float(generator.uniform(-2.0, 6.0))
    return stream("oncoming", course, 0.6 * course.length, first, 16.0, float(generator.uniform(6.0, 11.0)), gap)


def _harmless(ground: Ground, generator: np.random.Generator, arms: int) -> list[Agent]:
    """On each other arm at times a car that waits for the ego, and one that has just left the junction."""
    agents: list[Agent] = []
    for arm in range(arms):
        waits = Course(ground.road_map.lane(f"arm{arm}_in_0").center)
        leaves = Course(ground.road_map.lane(f"arm{arm}_out_0").center)
        if generator.random() < 0.5 * _SOMEBODY:
            agents.append(stand(f"waiting_{arm}", "automobile", waits, waits.length - 5.0, 0.0))
        if generator.random() < 0.5 * _SOMEBODY:
            ahead, speed = float(generator.uniform(10.0, 40.0)), float(generator.uniform(8.0, 11.0))
            agents += go_while_there(f"leaving_{arm}", "automobile", leaves, at_speed(ahead, 0.0, speed))
    return agents


_main4, _main3 = partial(junction_drive, controls=_MAIN), partial(junction_drive, controls=_MAIN3)

NOMINAL: dict[str, Maker] = {
    "open_road": open_road,
    "open_road_left_hand": in_mirror(open_road),
    "gentle_bend": partial(open_road, curve=1 / 150),
    "sharp_bend": partial(open_road, curve=1 / 70),
    "bend_left_hand": in_mirror(partial(open_road, curve=1 / 100)),
    "two_lanes": partial(open_road, forward=2),
    "two_lanes_bend": partial(open_road, forward=2, curve=1 / 140),
    "priority_straight": partial(_main4, roads=four, goal=1),
    "priority_right": partial(_main4, roads=four, goal=0),
    "priority_left": partial(_main4, roads=four, goal=2),
    "priority_skewed": partial(_main4, roads=skewed, goal=1),
    "priority_left_hand": in_mirror(partial(_main4, roads=four, goal=1)),
    "left_hand_right_turn": in_mirror(partial(_main4, roads=four, goal=2)),
    "left_hand_left_turn": in_mirror(partial(_main4, roads=four, goal=0)),
    "three_arms_right": partial(_main3, roads=three, goal=0),
    "three_arms_left": partial(_main3, roads=three, goal=1),
    "green_straight": partial(green_light, goal=1),
    "green_right": partial(green_light, goal=0),
    "green_left": partial(green_light, goal=2),
}
"""Ordinary drives by name."""

ORDINARY_STOPS: dict[str, dict[str, Maker]] = {
    "traffic_light": {
        "red_straight": partial(red_light, goal=1),
        "red_right": partial(red_light, goal=0),
        "red_left": partial(red_light, goal=2),
    },
    "stopped_traffic": {
        "traffic_stops": partial(traffic_stops, curve=0.0),
        "traffic_stops_on_curve": partial(traffic_stops, curve=1 / 140),
    },
}
"""Ordinary drives in which the ego stops, by category and name."""
