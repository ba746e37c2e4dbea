"""Uncommon vehicles: slow, wide, standing, backing and crossing ones."""

import numpy as np

from olt_closed_loop.scenes.scene import Agent
from olt_closed_loop.suite.courses import TIMES, Size, at_speed, go, go_while_there, staged, stand
from olt_closed_loop.suite.event import Event, oncoming
from olt_closed_loop.suite.grounds import Ground, road

_LANE = 3.5
OVERSIZE: Size = (14.0, 3.7, 4.0)
SWEEPER: Size = (5.8, 2.2, 2.8)
SCOOTER: Size = (1.8, 0.8, 1.7)
VAN: Size = (6.0, 2.1, 2.6)
BUS: Size = (12.0, 2.55, 3.2)
CARRIAGE: Size = (4.2, 1.9, 2.3)
HORSE: Size = (2.3, 0.8, 1.9)
EXCAVATOR: Size = (6.0, 2.6, 3.0)
TRAILER: Size = (4.0, 2.0, 1.4)
TRUCK: Size = (8.5, 2.5, 3.2)


def slow_vehicle(generator: np.random.Generator, size: Size, speed: float, curve: float, traffic: bool) -> Event:
    """A slow vehicle in the ego's lane, which oncoming traffic may keep it from passing."""
    ground = road(generator, curve=curve)
    pace = speed * float(generator.uniform(0.9, 1.1))
    stations = at_speed(ground.crux, ground.arrival(ground.crux), pace)
    agents = go_while_there("slow", "other_vehicle", ground.course, stations, -0.2, size)
    return Event(ground, (*agents, *_traffic(ground, generator, traffic)))


def standing_vehicle(
    generator: np.random.Generator,
    label: str,
    size: Size,
    offset: float,
    turn: float,
    traffic: bool,
    curve: float = 0.0,
) -> Event:
    """A vehicle that stands in the ego's lane, wholly or in part."""
    ground = road(generator, curve=curve)
    place = offset + float(generator.uniform(-0.15, 0.15))
    agents = [stand("standing", label, ground.course, ground.crux, place, turn, size)]
    return Event(ground, (*agents, *_traffic(ground, generator, traffic)))


def oversize_load(generator: np.random.Generator, curve: float) -> Event:
    """A load wider than its lane comes towards the ego, over the middle of the road."""
    ground = road(generator, shoulder=2.2, curve=curve)
    speed = float(generator.uniform(5.0, 6.5))
    stations = at_speed(ground.crux, ground.arrival(ground.crux), -speed)
    offset = float(generator.uniform(1.9, 2.1))
    load = go("oversize", "heavy_truck", ground.course, stations, offset, np.pi, OVERSIZE)
    leader = go("escort", "automobile", ground.course, stations - 14.0, 3.4, np.pi)
    return Event(ground, (load, leader))


def backing_truck(generator: np.random.Generator, side: float) -> Event:
    """A truck backs out of a yard across the ego's lane, stands there, and draws in again."""
    ground = road(generator)
    when = ground.arrival(ground.crux)
    out, stays = float(generator.uniform(4.0, 5.0)), float(generator.uniform(2.5, 4.0))
    hidden, there = -side * 12.5, -side * float(generator.uniform(3.2, 3.8))
    offsets = staged(
        [
            (0.0, hidden),
            (when - out - 0.5, hidden),
            (when - 0.5, there),
            (when + stays, there),
            (when + stays + 4.0, hidden),
        ]
    )
    turn = -side * np.pi / 2
    truck = go("backing", "heavy_truck", ground.course, np.full_like(TIMES, ground.crux), offsets, turn, TRUCK)
    return Event(ground, (truck,))


def wrong_way(generator: np.random.Generator) -> Event:
    """A scooter comes against the ego in its lane."""
    ground = road(generator, shoulder=1.6)
    speed = float(generator.uniform(5.0, 6.5))
    stations = at_speed(ground.crux, ground.arrival(ground.crux), -speed)
    scooter = go(
        "scooter", "other_vehicle", ground.course, stations, float(generator.uniform(-0.9, -0.6)), np.pi, SCOOTER
    )
    return Event(ground, (scooter,))


def bus_pulls_out(generator: np.random.Generator) -> Event:
    """A bus leaves its stop in front of the ego."""
    ground = road(generator, shoulder=3.2)
    when = ground.arrival(ground.crux) - float(generator.uniform(3.6, 4.2))
    speed = float(generator.uniform(3.5, 4.5))
    seconds = np.maximum(TIMES - when, 0.0)
    ramp = speed / 1.2
    moved = np.where(seconds < ramp, 0.6 * seconds**2, 0.6 * ramp**2 + speed * (seconds - ramp))
    stations = ground.crux + moved
    offsets = np.interp(moved, [0.0, 1.0, 14.0], [-3.4, -3.3, 0.0])
    bus = go("bus", "bus", ground.course, stations, offsets, 0.0, BUS)
    return Event(ground, (bus, *_traffic(ground, generator, True)))


def horse_carriage(generator: np.random.Generator) -> Event:
    """A carriage behind a horse."""
    ground = road(generator, curve=float(generator.choice([-1.0, 1.0])) / float(generator.uniform(110.0, 150.0)))
    speed = float(generator.uniform(2.0, 2.6))
    stations = at_speed(ground.crux, ground.arrival(ground.crux), speed)
    carriage = go_while_there("carriage", "other_vehicle", ground.course, stations, -0.3, CARRIAGE)
    return Event(ground, (*carriage, *go_while_there("horse", "animal", ground.course, stations + 3.6, -0.3, HORSE)))


def crossing_machine(generator: np.random.Generator, side: float) -> Event:
    """An excavator creeps across the road from one site to the other."""
    ground = road(generator)
    speed = float(generator.uniform(1.6, 2.2))
    when = ground.arrival(ground.crux) + float(generator.uniform(0.2, 0.6))
    offsets = -side * speed * at_speed(0.0, when, 1.0)
    machine = go(
        "excavator",
        "other_vehicle",
        ground.course,
        np.full_like(TIMES, ground.crux),
        offsets,
        -side * np.pi / 2,
        EXCAVATOR,
    )
    return Event(ground, (machine,))


def _traffic(ground: Ground, generator: np.random.Generator, wanted: bool) -> list[Agent]:
    """Oncoming cars that come to the event as the ego does."""
    if not wanted:
        return []
    when = ground.arrival(ground.crux)
    return oncoming(ground, _LANE, ground.crux, when - 1.2, when + 3.2, float(generator.uniform(8.0, 10.0)), 2.2)
