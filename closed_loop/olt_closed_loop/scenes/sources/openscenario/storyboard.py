"""The storyboard: acts, events and their actions in the order in which their triggers let them run."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element

from olt_closed_loop.scenes.sources.openscenario.actions import Running, start_action
from olt_closed_loop.scenes.sources.openscenario.conditions import Trigger
from olt_closed_loop.scenes.sources.openscenario.world import State, World
from olt_closed_loop.scenes.sources.xml_files import child, number_of, text_of
from olt_generator.errors import InputError

_PRIORITIES = ("overwrite", "override", "skip", "parallel")


@dataclass
class Started:
    """An action that runs: on whom, what it governs, and its state."""

    entity: str
    governs: str
    run: Running
    state: State


@dataclass
class Event:
    """An event of a maneuver: its actions start together when its trigger holds."""

    name: str
    priority: str
    most: int
    actors: list[str]
    trigger: Trigger | None
    actions: list[tuple[str, Element]]
    state: State
    times: int = 0
    running: list[Started] = field(default_factory=list)

    @property
    def active(self) -> bool:
        """Whether it runs."""
        return self.state.started is not None and self.state.ended is None

    def can_start(self) -> bool:
        """Whether it may run (again)."""
        return self.times < self.most and not self.active


@dataclass
class Act:
    """An act: the events of its maneuvers, by maneuver."""

    state: State
    start: Trigger | None
    stop: Trigger | None
    maneuvers: list[tuple[State, list[Event]]]
    groups: list[tuple[State, list[tuple[State, list[Event]]]]]


class Storyboard:
    """A `Storyboard` (resolved) that is carried out step by step."""

    def __init__(self, element: Element, world: World) -> None:
        """Reads it and puts everybody where `Init` says.

        Raises:
            InputError: it uses what is not read.
        """
        self._world = world
        self._running: list[Started] = []
        self._init(child(element, "Init", "Storyboard"))
        self._stories = [
            (world.state("story", story.get("name", "")), list(_read_acts(story, world)))
            for story in element.findall("Story")
        ]
        stop = element.find("StopTrigger")
        self._stop = Trigger(stop) if stop is not None and len(stop) else None

    def _init(self, init: Element) -> None:
        privates = []
        for action in child(init, "Actions", "Init"):
            if action.tag != "Private":
                raise InputError(f"<{action.tag:.60}> is not read as an action at the start")
            name = text_of(action, "entityRef", "Private")
            privates += [(name, one) for one in action.findall("PrivateAction")]
        # Places first, in their order, as others refer to them; then speeds, then distances that need both.
        for _, name, one in sorted(
            ((_INIT_ORDER.get(_kind(one), 0), name, one) for name, one in privates), key=lambda three: three[0]
        ):
            governs, run = start_action(one, self._world.mover(name), self._world)
            self._keep(Started(name, governs, run, State("action")))

    def advance(self) -> bool:
        """Carry out one step; False when the scenario is over."""
        world = self._world
        for story, acts in self._stories:
            for act in acts:
                self._advance_act(act)
            if any(act.state.started is not None for act in acts) and story.started is None:
                story.started = world.step
            if all(act.state.ended is not None for act in acts) and story.ended is None:
                story.ended = world.step
        still = [one for one in self._running if one.state.ended is None]
        for one in still:
            if one.run(world):
                one.state.ended = world.step
        self._running = [one for one in still if one.state.ended is None]
        return not (self._stop is not None and self._stop.holds(world))

    def _advance_act(self, act: Act) -> None:
        step = self._world.step
        if act.state.started is None and (act.start is None or act.start.holds(self._world)):
            act.state.started = step
            for group, maneuvers in act.groups:
                group.started = step
                for maneuver, _ in maneuvers:
                    maneuver.started = step
        if act.state.started is None or act.state.ended is not None:
            return
        if act.stop is not None and act.stop.holds(self._world):
            for _, events in act.maneuvers:
                for event in events:
                    self._end(event, stopped=True)
            act.state.ended, act.state.stopped = step, True
            return
        for _, events in act.maneuvers:
            for event in events:
                self._advance_event(event, events)
        self._end_what_is_over(act, step)

    def _end_what_is_over(self, act: Act, step: int) -> None:
        for group, maneuvers in act.groups:
            for maneuver, events in maneuvers:
                if maneuver.ended is None and all(event.times >= event.most and not event.active for event in events):
                    maneuver.ended = step
            if group.ended is None and all(maneuver.ended is not None for maneuver, _ in maneuvers):
                group.ended = step
        if all(group.ended is not None for group, _ in act.groups):
            act.state.ended = step

    def _advance_event(self, event: Event, beside: list[Event]) -> None:
        if event.active and all(one.state.ended is not None for one in event.running):
            event.state.ended = self._world.step
        # A trigger is asked at every step, as it remembers what was before.
        asked = event.trigger is None or event.trigger.holds(self._world)
        if not (asked and event.can_start()):
            return
        others = [one for one in beside if one is not event and one.active]
        if others and event.priority == "skip":
            event.times += 1
            return
        if event.priority in ("overwrite", "override"):
            for one in others:
                self._end(one, stopped=True)
        event.times += 1
        event.state.started, event.state.ended, event.state.stopped = self._world.step, None, False
        event.running = []
        for actor in event.actors:
            mover = self._world.mover(actor)
            for name, action in event.actions:
                state = self._world.state("action", name)
                state.started = self._world.step
                governs, run = start_action(action, mover, self._world)
                started = Started(actor, governs, run, state)
                event.running.append(started)
                self._keep(started)

    def _keep(self, new: Started) -> None:
        """Let an action run, and end those that govern the same of the same road user."""
        for one in self._running:
            if one.entity == new.entity and one.governs == new.governs != "nothing" and one.state.ended is None:
                one.state.ended, one.state.stopped = self._world.step, True
        self._running.append(new)

    def _end(self, event: Event, stopped: bool) -> None:
        if event.active:
            event.state.ended, event.state.stopped = self._world.step, stopped
            for one in event.running:
                if one.state.ended is None:
                    one.state.ended, one.state.stopped = self._world.step, stopped


_INIT_ORDER = {"TeleportAction": 1, "SpeedAction": 2, "LongitudinalDistanceAction": 3}


def _kind(action: Element) -> str:
    inner = next(iter(action), None)
    if inner is not None and inner.tag in ("LongitudinalAction", "LateralAction", "RoutingAction"):
        inner = next(iter(inner), None)
    return "" if inner is None else inner.tag


def _read_acts(story: Element, world: World) -> Iterator[Act]:
    for element in story.findall("Act"):
        start, stop = element.find("StartTrigger"), element.find("StopTrigger")
        groups = [_read_group(group, world) for group in element.findall("ManeuverGroup")]
        yield Act(
            world.state("act", element.get("name", "")),
            Trigger(start) if start is not None and len(start) else None,
            Trigger(stop) if stop is not None and len(stop) else None,
            [maneuver for _, maneuvers in groups for maneuver in maneuvers],
            groups,
        )


def _read_group(group: Element, world: World) -> tuple[State, list[tuple[State, list[Event]]]]:
    actors = child(group, "Actors", "ManeuverGroup")
    if actors.get("selectTriggeringEntities", "false") not in ("false", "0"):
        raise InputError("Actors by selectTriggeringEntities are not read; name them")
    names = [text_of(one, "entityRef", "Actors") for one in actors.findall("EntityRef")]
    unread = group.find("CatalogReference")
    if unread is not None:
        raise InputError("a ManeuverGroup with maneuvers of a catalogue is not read")
    maneuvers = [
        (
            world.state("maneuver", maneuver.get("name", "")),
            [_read_event(event, names, world) for event in maneuver.findall("Event")],
        )
        for maneuver in group.findall("Maneuver")
    ]
    return world.state("maneuverGroup", group.get("name", "")), maneuvers


def _read_event(element: Element, actors: list[str], world: World) -> Event:
    name = element.get("name", "")
    where = f"event {name:.60}"
    priority = text_of(element, "priority", where)
    if priority not in _PRIORITIES:
        raise InputError(f"{where}: priority {priority:.60} is not read")
    most = number_of(element, "maximumExecutionCount", where, 1.0)
    actions = []
    for action in element.findall("Action"):
        kinds = list(action)
        if len(kinds) != 1 or kinds[0].tag != "PrivateAction":
            tag = kinds[0].tag if kinds else "nothing"
            raise InputError(f"{where}: <{tag:.60}> is not read as an action")
        actions.append((action.get("name", ""), kinds[0]))
    trigger = element.find("StartTrigger")
    return Event(
        name,
        priority,
        int(min(most, 1000.0)),
        actors,
        Trigger(trigger) if trigger is not None else None,
        actions,
        world.state("event", name),
    )
