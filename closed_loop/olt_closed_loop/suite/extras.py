"""Beside the 53 events: animals, debris, cut-ins, emergency vehicles, and drives in which nothing happens."""

import numpy as np

from olt_closed_loop.scenes.scene import Agent
from olt_closed_loop.suite.courses import TIMES, Size, at_speed, go, go_while_there, staged, stand
from olt_closed_loop.suite.event import Event, lead_car, oncoming
from olt_closed_loop.suite.grounds import road
from olt_closed_loop.suite.intersections import four, three

_LANE = 3.5
DOG: Size = (0.9, 0.35, 0.7)
COW: Size = (2.3, 0.8, 1.5)
AMBULANCE: Size = (6.0, 2.1, 2.7)


def animals_cross(generator: np.random.Generator, size: Size, count: int, speed: float) -> Event:
    """Animals come onto the road and cross it."""
    ground = road(generator, shoulder=2.0)
    side, when = float(generator.choice([-1.0, 1.0])), ground.arrival(ground.crux)
    agents = []
    for index in range(count):
        pace = speed * float(generator.uniform(0.9, 1.1))
        offsets = -side * pace * at_speed(0.0, when + 0.2 + 0.7 * index, 1.0)
        stations = np.full_like(TIMES, ground.crux + float(generator.uniform(-1.0, 1.0)))
        agents.append(go(f"animal_{index}", "animal", ground.course, stations, offsets, -side * np.pi / 2, size))
    return Event(ground, tuple(agents))


def debris(generator: np.random.Generator, size: Size, count: int, traffic: bool) -> Event:
    """Things lie in the lane."""
    ground = road(generator, curve=float(generator.uniform(-0.004, 0.004)))
    agents: list[Agent] = [
        stand(
            f"debris_{index}",
            "other",
            ground.course,
            ground.crux + 3.0 * index,
            float(generator.uniform(-0.7, 0.4)),
            float(generator.uniform(-0.8, 0.8)),
            size,
        )
        for index in range(count)
    ]
    if traffic:
        when = ground.arrival(ground.crux)
        agents += oncoming(ground, _LANE, ground.crux, when - 1.2, when + 2.4, 9.0, 2.2)
    return Event(ground, tuple(agents))


def cut_in(generator: np.random.Generator, brakes: bool) -> Event:
    """A car of the next lane comes over just before the ego, and may brake."""
    ground = road(generator, forward=2)
    when = ground.arrival(ground.crux) - 2.5
    speed = ground.cruise + 1.0
    slow = float(generator.uniform(2.0, 3.0)) if brakes else ground.cruise - 3.0
    seconds = np.maximum(TIMES - when, 0.0)
    braked = np.minimum(seconds, (speed - slow) / 2.5)
    beside = ground.start + ground.cruise * when + float(generator.uniform(9.0, 10.0))
    stations = (
        beside
        + speed * (TIMES - when)
        - np.where(seconds > braked, 1.25 * braked**2 + (speed - slow) * (seconds - braked), 1.25 * seconds**2)
    )
    offsets = staged([(0.0, _LANE), (when - 1.0, _LANE), (when + 1.2, 0.0), (30.0, 0.0)])
    return Event(ground, tuple(go_while_there("cutter", "automobile", ground.course, stations, offsets)))


def ambulance_crosses(generator: np.random.Generator) -> Event:
    """An ambulance crosses at speed where the ego has right of way."""
    ground = four(generator, goal=1)
    course = ground.between("arm2_in_0", "arm0_out_0")
    mine, theirs = ground.course.meets(course, after=ground.crux)
    speed = float(generator.uniform(12.0, 14.0))
    stations = at_speed(theirs, ground.arrival(mine) + 0.1, speed)
    agents = go_while_there("ambulance", "heavy_truck", course, stations, 0.0, AMBULANCE)
    second = go_while_there("fire_engine", "heavy_truck", course, stations - 13.0)
    return Event(ground, (*agents, *second))


def fire_engine_comes(generator: np.random.Generator) -> Event:
    """A fire engine passes stopped traffic on the ego's side of the road."""
    ground = road(generator, shoulder=2.6)
    speed = float(generator.uniform(9.0, 11.0))
    meets = ground.arrival(ground.crux)
    stations = at_speed(ground.crux, meets, -speed)
    offset = float(generator.uniform(1.0, 1.3))
    agents = [go("fire_engine", "heavy_truck", ground.course, stations, offset, np.pi)]
    agents += [
        stand(f"stopped_{index}", "automobile", ground.course, ground.crux + 14.0 + 7.0 * index, 4.3, np.pi)
        for index in range(4)
    ]
    return Event(ground, tuple(agents))


def nothing_ahead(generator: np.random.Generator, curve: float) -> Event:
    """A road with a car well ahead and some that come."""
    ground = road(generator, curve=curve, shoulder=2.0)
    agents = lead_car(ground, float(generator.uniform(22.0, 30.0)), ground.cruise)
    agents += oncoming(ground, _LANE, ground.crux, 3.0, 12.0, 9.0, float(generator.uniform(3.0, 4.0)))
    return Event(ground, tuple(agents))


def free_junction(generator: np.random.Generator, goal: int, arms: int) -> Event:
    """A junction that is free when the ego comes."""
    ground = (four if arms == 4 else three)(generator, goal=goal)
    other = ground.between("arm0_in_0", f"arm{arms - 1}_out_0")
    return Event(ground, tuple(go_while_there("other", "automobile", other, at_speed(20.0, 0.0, 8.0))))
