"""Cyclists: beside, before, across and against the ego."""

import numpy as np

from olt_closed_loop.scenes.scene import Agent
from olt_closed_loop.suite.courses import at_speed, go, go_while_there, stand
from olt_closed_loop.suite.event import Event, oncoming
from olt_closed_loop.suite.grounds import road
from olt_closed_loop.suite.intersections import four

_LANE = 3.5


def riders_ahead(generator: np.random.Generator, riders: int, abreast: bool, curve: float, traffic: bool) -> Event:
    """Slow riders in the ego's lane; oncoming traffic decides when they can be passed."""
    ground = road(generator, curve=curve)
    speed = float(generator.uniform(3.8, 4.8))
    agents: list[Agent] = []
    for index in range(riders):
        along, offset = (0.0, -0.4 - 1.0 * index) if abreast else (4.0 * index, -0.9)
        stations = at_speed(ground.crux + along, ground.arrival(ground.crux), speed)
        agents += go_while_there(f"rider_{index}", "rider", ground.course, stations, offset)
    if traffic:
        when = ground.arrival(ground.crux)
        agents += oncoming(ground, _LANE, ground.crux, when - 1.5, when + 4.0, float(generator.uniform(8.0, 10.0)), 2.2)
    return Event(ground, tuple(agents))


def rider_crosses(generator: np.random.Generator, side: float) -> Event:
    """A rider comes out of a side path across the road."""
    ground = road(generator)
    station, speed = ground.crux, float(generator.uniform(2.8, 3.6))
    when = ground.arrival(station) + float(generator.uniform(0.0, 0.3))
    offsets = -side * speed * at_speed(0.0, when, 1.0)
    rider = go("rider", "rider", ground.course, np.full_like(offsets, station), offsets, turn=-side * np.pi / 2)
    return Event(ground, (rider,))


def rider_swerves(generator: np.random.Generator) -> Event:
    """A rider at the kerb moves into the lane to pass a parked car."""
    ground = road(generator, shoulder=2.4)
    speed = float(generator.uniform(3.6, 4.4))
    meets = ground.arrival(ground.crux)
    car = ground.crux + 2.0
    stations = at_speed(ground.crux, meets, speed)
    offsets = np.interp(stations, [car - 16.0, car - 7.0, car + 6.0, car + 14.0], [-1.8, -0.5, -0.5, -1.8])
    agents = [*go_while_there("rider", "rider", ground.course, stations, offsets)]
    agents.append(stand("parked", "automobile", ground.course, car, -2.6))
    return Event(ground, tuple(agents))


def rider_against(generator: np.random.Generator) -> Event:
    """A rider comes the wrong way in the ego's lane."""
    ground = road(generator)
    speed = float(generator.uniform(3.0, 4.0))
    stations = at_speed(ground.crux, ground.arrival(ground.crux), -speed)
    rider = go("rider", "rider", ground.course, stations, float(generator.uniform(-0.7, -0.4)), turn=np.pi)
    return Event(ground, (rider,))


def turn_over_rider(generator: np.random.Generator) -> Event:
    """The ego turns right, and a rider beside it goes straight on."""
    ground = four(generator, goal=0)
    straight = ground.between("arm3_in_0", "arm1_out_0")
    mine = ground.crux + float(generator.uniform(7.0, 8.0))
    x, y, _ = ground.course.locate(mine)
    theirs = straight.station_of(np.array([x[0], y[0]]))
    speed = float(generator.uniform(3.5, 4.2))
    stations = at_speed(theirs, ground.arrival(mine) + float(generator.uniform(0.2, 0.6)), speed)
    rider = go_while_there("rider", "rider", straight, stations, -1.9)
    return Event(ground, (*rider, *go_while_there("second", "rider", straight, stations - 3.5, -1.9)))
