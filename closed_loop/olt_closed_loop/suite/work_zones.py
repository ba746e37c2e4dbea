"""Work zones: closed lanes, cones that lead another way, and people with signs."""

import numpy as np

from olt_closed_loop.scenes.scene import Agent
from olt_closed_loop.suite.courses import TIMES, at_speed, go, go_while_there, staged, stand
from olt_closed_loop.suite.event import Event, closure, cone_line, oncoming
from olt_closed_loop.suite.grounds import cut_lane, road
from olt_closed_loop.suite.people import flagger

_LANE = 3.5


def lane_shift(generator: np.random.Generator, curve: float) -> Event:
    """Two rows of cones lead over onto the other lane, against the marking."""
    ground = road(generator, curve=curve, wear=0.6)
    course, half, shift = ground.course, float(generator.uniform(2.1, 2.3)), float(generator.uniform(2.4, 3.0))
    begin, end = ground.crux, ground.crux + float(generator.uniform(26.0, 34.0))
    agents: list[Agent] = []
    for name, sign in (("left", 1.0), ("right", -1.0)):
        edge = sign * half
        agents += cone_line(f"cone_{name}_in", course, (begin - 26.0, edge), (begin - 20.0, edge))
        agents += cone_line(f"cone_{name}_over", course, (begin - 17.0, edge), (begin, edge + shift))
        agents += cone_line(f"cone_{name}", course, (begin + 3.0, edge + shift), (end, edge + shift))
    agents.append(stand("roller", "other_vehicle", course, begin + 16.0, -0.9))
    agents.append(stand("worker", "person", course, begin + 22.0, -0.8, turn=np.pi / 2))
    return Event(ground, tuple(agents))


def one_lane(generator: np.random.Generator) -> Event:
    """One lane is left for both directions; a worker with a sign holds the ego until the others are through."""
    ground = road(generator)
    begin, end = ground.crux + 14.0, ground.crux + float(generator.uniform(40.0, 46.0))
    agents = closure(ground, begin, end, float(generator.uniform(1.1, 1.3)), -1.6)
    speed = float(generator.uniform(6.5, 8.0))
    when = ground.arrival(ground.crux)
    agents += oncoming(ground, _LANE, begin, when - 1.0, when + 2.6, speed, 1.8)
    held = ((0.0, when + 2.6 + 1.6),)
    ground = cut_lane(ground, ground.crux - 6.0).directed(held)
    agents += flagger(ground.course, ground.crux + 1.0, -2.5, held)
    return Event(ground, tuple(agents))


def closed_lane(generator: np.random.Generator, traffic: bool, curve: float) -> Event:
    """The ego's lane is closed; it must use the oncoming one when that is free."""
    ground = road(generator, curve=curve)
    begin, end = ground.crux, ground.crux + float(generator.uniform(16.0, 22.0))
    agents = closure(ground, begin, end, float(generator.uniform(0.6, 0.9)), -1.6)
    agents.append(stand("excavator", "other_vehicle", ground.course, begin + 9.0, -0.6, size=(6.0, 2.3, 3.0)))
    if traffic:
        when = ground.arrival(begin)
        agents += oncoming(ground, _LANE, begin, when - 1.2, when + 2.6, float(generator.uniform(8.0, 9.5)), 2.0)
    return Event(ground, tuple(agents))


def worker_steps_out(generator: np.random.Generator) -> Event:
    """A worker beside the road walks into the ego's lane, works there, and goes back."""
    ground = road(generator, shoulder=2.0)
    when = ground.arrival(ground.crux)
    stays = float(generator.uniform(2.5, 3.5))
    there = float(generator.uniform(-0.3, 0.3))
    offsets = staged(
        [(0.0, -3.4), (when - 4.5, -3.4), (when - 2.0, there), (when + stays, there), (when + stays + 3.0, -3.4)]
    )
    worker = go("worker", "person", ground.course, np.full_like(TIMES, ground.crux), offsets, np.pi / 2)
    agents = cone_line("cone", ground.course, (ground.crux - 14.0, -2.3), (ground.crux + 12.0, -2.3))
    agents.append(stand("work_truck", "heavy_truck", ground.course, ground.crux + 18.0, -4.0))
    return Event(ground, (*agents, worker))


def taper_merge(generator: np.random.Generator) -> Event:
    """The right one of two lanes is closed by a taper; cars in the other one leave little room."""
    ground = road(generator, forward=2)
    begin = ground.crux
    agents = closure(ground, begin, begin + float(generator.uniform(26.0, 32.0)), 1.4, -1.6)
    when, speed = ground.arrival(begin), float(generator.uniform(6.0, 7.0))
    for index in range(2):
        stations = at_speed(begin, when - 0.4 + 1.8 * index, speed)
        agents += go_while_there(f"beside_{index}", "automobile", ground.course, stations, _LANE)
    return Event(ground, tuple(agents))
