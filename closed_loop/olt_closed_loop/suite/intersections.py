"""Complex intersections: right of way kept and taken, people who direct traffic, and paths that cones lay anew."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from olt_closed_loop.scenes.maps.lanes import Control
from olt_closed_loop.scenes.maps.signals import SignalPlan
from olt_closed_loop.scenes.scene import Agent
from olt_closed_loop.suite.courses import Course, at_speed, go, go_while_there, stand
from olt_closed_loop.suite.event import Event, closure, cone_line, cross_traffic, last_passes
from olt_closed_loop.suite.grounds import Ground, circle, crossroads, place
from olt_closed_loop.suite.people import flagger, officer

Roads = Callable[..., Ground]
_CLEARS = 1.2
"""Seconds from the last car of cross traffic to the hand that lets the ego go."""
_RED_BEFORE, _LONG_GREEN, _NEVER = 2.0, 40.0, 35.0
"""Seconds from the red light to the hand that overrules it, of a green that is there all along, and after the end."""

FOUR = (0.0, 90.0, 180.0, 270.0)
SKEWED = (20.0, 90.0, 200.0, 270.0)
THREE = (0.0, 180.0, 270.0)
WYE = (40.0, 150.0, 270.0)
FIVE_WAYS = (0.0, 60.0, 125.0, 190.0, 270.0)


def ground_of(
    generator: np.random.Generator,
    headings: tuple[float, ...] = FOUR,
    goal: int = 1,
    controls: Sequence[Control | None] | None = None,
    lead: float | None = None,
    wear: float = 0.0,
    bend: float = 0.0,
    lit: bool = False,
) -> Ground:
    """A junction that the ego comes to on its last arm and leaves on arm `goal`.

    A `lit` one of four arms has lights, green for the ego's arm and the opposite one and red for the others.
    """
    own = len(headings) - 1
    told: Sequence[Control | None] = controls or ("light" if lit else None,) * len(headings)
    road_map = crossroads(generator, headings, told, wear=wear, bend=bend)
    ground = place(road_map, f"arm{own}_in_0", f"arm{goal}_out_0", generator, lead)
    return ground.signalled(_turns_red(_NEVER)) if lit else ground


def directed_hold(
    generator: np.random.Generator,
    roads: Roads,
    streams: tuple[tuple[int, int], ...],
    waiting: int | None = None,
    overruled: bool = False,
) -> Event:
    """Somebody stops the ego with both arms, lets cross traffic pass, and then waves it through.

    When the stream is through and the way looks free, a late and fast one still comes: only the arms tell. And who
    waits on arm `waiting` stays there, so that it is the arms again that tell when to go. Where the lights of the
    junction are `overruled`, that of the ego is green while the hand stops it, and red when the hand waves it through.
    """
    ground = roads(generator)
    speed = float(generator.uniform(8.0, 10.0))
    agents: list[Agent] = []
    last = 0.0
    for start, goal in streams:
        names = f"arm{start}_in_0", f"arm{goal}_out_0"
        agents += cross_traffic(ground, *names, speed, name=f"crossing_{start}")
        last = max(last, last_passes(ground, *names))
    start, goal = streams[0]
    late = ground.between(f"arm{start}_in_0", f"arm{goal}_out_0")
    _, theirs = ground.course.meets(late, after=ground.crux)
    comes = last + float(generator.uniform(2.6, 3.2))
    agents += go_while_there("late", "automobile", late, at_speed(theirs, comes, speed + 2.5))
    if waiting is not None:
        lane = Course(ground.road_map.lane(f"arm{waiting}_in_0").center)
        agents.append(stand("waiting", "automobile", lane, lane.length - 4.0, 0.0))
    held = ((0.0, comes + _CLEARS),)
    if overruled:
        others = [name for start, goal in streams for name in ground.ways(f"arm{start}_in_0", f"arm{goal}_out_0")]
        ground = ground.signalled(_turns_red(held[0][1] - _RED_BEFORE)).waved_on(others)
    ground = ground.directed(held)
    side = float(generator.uniform(2.6, 3.0))
    return Event(ground, (*agents, *officer(ground.course, ground.crux + 3.0, -side, held)))


def _turns_red(when: float) -> SignalPlan:
    """Lights of crossroads: the ego's arm and the opposite one are green, then amber, and red from `when` seconds."""
    plan = SignalPlan(phases=((1, 3), (0, 2)), green=_LONG_GREEN)
    return replace(plan, start=when - plan.amber - plan.green)


def directed_detour(generator: np.random.Generator, roads: Roads, side: float) -> Event:
    """The ego's lane is closed by cones up to the junction, and a worker with a sign sends it past on the other one."""
    ground = roads(generator, lead=float(generator.uniform(9.5, 10.5)))
    begin, end = ground.crux - float(generator.uniform(26.0, 30.0)), ground.crux - 9.0
    inner = side * float(generator.uniform(0.7, 1.0))
    agents = closure(ground, begin, end, inner, -side * 1.6)
    until = ground.arrival(begin - 24.0) + float(generator.uniform(2.0, 3.0))
    held = ((0.0, until),)
    agents += flagger(ground.course, begin - 14.0, -side * 2.6, held)
    return Event(ground, tuple(agents))


def give_way(generator: np.random.Generator, roads: Roads, streams: tuple[tuple[int, int], ...]) -> Event:
    """Cross traffic comes, and goes first."""
    ground = roads(generator)
    speed = float(generator.uniform(7.5, 9.5))
    agents: list[Agent] = []
    for start, goal in streams:
        agents += cross_traffic(ground, f"arm{start}_in_0", f"arm{goal}_out_0", speed, name=f"crossing_{start}")
    return Event(ground, tuple(agents))


def way_taken(generator: np.random.Generator, roads: Roads, start: int, goal: int) -> Event:
    """The ego has right of way, and a car that should give way does not stop."""
    ground = roads(generator)
    course = ground.between(f"arm{start}_in_0", f"arm{goal}_out_0")
    mine, theirs = ground.course.meets(course, after=ground.crux)
    when = ground.arrival(mine) + float(generator.uniform(0.0, 0.3))
    # It slows down as if it would stop, and goes on.
    slow, speed = float(generator.uniform(3.0, 4.0)), float(generator.uniform(8.0, 9.5))
    dips = theirs - 14.0
    entry = when - 14.0 / slow
    knots = [(-30.0, dips - speed * (entry + 30.0)), (entry, dips), (when, theirs)]
    stations = np.interp(at_speed(0.0, 0.0, 1.0), *np.array([*knots, (when + 30.0, theirs + speed * 30.0)]).T)
    agents = go_while_there("taker", "automobile", course, stations)
    follows = go_while_there("follower", "automobile", course, stations - float(generator.uniform(9.0, 11.0)))
    return Event(ground, (*agents, *follows))


def turn_across(generator: np.random.Generator, roads: Roads, start: int, goal: int) -> Event:
    """The ego turns across oncoming traffic that goes straight on."""
    ground = roads(generator)
    speed = float(generator.uniform(8.0, 10.0))
    names = f"arm{start}_in_0", f"arm{goal}_out_0"
    return Event(ground, tuple(cross_traffic(ground, *names, speed, name="oncoming", before=2.5, after=3.5)))


def ring_entry(generator: np.random.Generator, headings: tuple[float, ...], goal: int, start: int, leave: int) -> Event:
    """The ego enters a roundabout whose traffic goes first."""
    own = len(headings) - 1
    ground = place(circle(generator, headings), f"arm{own}_in_0", f"arm{goal}_out_0", generator)
    speed = float(generator.uniform(5.0, 6.0))
    names = f"arm{start}_in_0", f"arm{leave}_out_0"
    return Event(ground, tuple(cross_traffic(ground, *names, speed, name="ring", before=2.5, after=3.5, gap=1.9)))


def coned_path(generator: np.random.Generator, roads: Roads, side: float) -> Event:
    """Two rows of cones lay a path through the junction that leaves the ego's lane."""
    ground = roads(generator, lead=float(generator.uniform(8.5, 9.5)))
    course, half = ground.course, float(generator.uniform(2.1, 2.3))
    begin, end = ground.crux - 22.0, ground.crux + 26.0
    shift = side * float(generator.uniform(2.2, 2.6))
    agents: list[Agent] = []
    for name, sign in (("left", 1.0), ("right", -1.0)):
        edge = sign * half
        agents += cone_line(f"cone_{name}_in", course, (begin - 22.0, edge), (begin - 18.0, edge))
        agents += cone_line(f"cone_{name}_over", course, (begin - 15.0, edge), (begin, edge + shift))
        agents += cone_line(f"cone_{name}", course, (begin + 3.0, edge + shift), (end, edge + shift))
    middle = np.arange(begin + 6.0, end - 4.0, 8.0)
    agents += [
        stand(f"barrier_{index}", "barrier", course, station, -side * 0.9, turn=np.pi / 2)
        for index, station in enumerate(middle.tolist())
    ]
    return Event(ground, tuple(agents))


def people_cross(generator: np.random.Generator, roads: Roads, group: int) -> Event:
    """People cross the arm that the ego turns into."""
    ground = roads(generator)
    exit_station = ground.crux + float(generator.uniform(22.0, 25.0))
    when = ground.arrival(exit_station)
    agents: list[Agent] = []
    for index in range(group):
        pace = float(generator.uniform(1.2, 1.5))
        ahead, shift = float(generator.uniform(-0.8, 0.8)), 0.8 * index
        offsets = pace * (at_speed(0.0, when + 0.3 + shift, 1.0))
        x_station = np.full_like(offsets, exit_station + ahead)
        agents.append(go(f"walker_{index}", "person", ground.course, x_station, offsets, turn=np.pi / 2))
    return Event(ground, tuple(agents))


def blocked_exit(generator: np.random.Generator, roads: Roads, side: float) -> Event:
    """A broken-down car stands in the ego's way behind the junction, and an officer waves traffic past it."""
    ground = roads(generator)
    station = ground.crux + float(generator.uniform(24.0, 30.0))
    agents = [stand("breakdown", "automobile", ground.course, station, -side * 0.5, turn=0.15)]
    agents += cone_line("cone", ground.course, (station - 12.0, -side * 1.5), (station - 5.0, side * 0.6))
    until = ground.arrival(ground.crux - 20.0) + float(generator.uniform(1.5, 2.5))
    held = ((0.0, until),)
    ground = ground.directed(held)
    return Event(ground, (*agents, *officer(ground.course, ground.crux + 2.0, -side * 2.8, held)))


four = partial(ground_of, headings=FOUR)
skewed = partial(ground_of, headings=SKEWED)
three = partial(ground_of, headings=THREE)
wye = partial(ground_of, headings=WYE)
five = partial(ground_of, headings=FIVE_WAYS)
