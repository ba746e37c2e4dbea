"""Conditions and triggers (OpenSCENARIO 1.1, section 7.6)."""

from collections import deque
from collections.abc import Callable
from xml.etree.ElementTree import Element

import numpy as np
import shapely

from olt_closed_loop.scenes.actors import footprints
from olt_closed_loop.scenes.sources.openscenario.motion import Mover
from olt_closed_loop.scenes.sources.openscenario.world import STEP, World
from olt_closed_loop.scenes.sources.xml_files import child, number_of, text_of
from olt_generator.errors import InputError

Question = Callable[[World], bool]

_SAME = 1e-3
_RULES: dict[str, Callable[[float, float], bool]] = {
    "lessThan": lambda value, limit: value < limit,
    "lessOrEqual": lambda value, limit: value <= limit,
    "greaterThan": lambda value, limit: value > limit,
    "greaterOrEqual": lambda value, limit: value >= limit,
    "equalTo": lambda value, limit: abs(value - limit) < _SAME,
    "notEqualTo": lambda value, limit: not abs(value - limit) < _SAME,
}
_EDGES: dict[str, Callable[[bool, bool], bool]] = {
    "none": lambda _, now: now,
    "rising": lambda before, now: now and not before,
    "falling": lambda before, now: before and not now,
    "risingOrFalling": lambda before, now: before != now,
}
_LONGEST_DELAY = 3600.0


class Trigger:
    """A `StartTrigger` or `StopTrigger` (resolved): holds when all conditions of one of its groups do."""

    def __init__(self, element: Element) -> None:
        self._groups = [
            [Condition(condition) for condition in group.findall("Condition")]
            for group in element.findall("ConditionGroup")
        ]

    def holds(self, world: World) -> bool:
        """Whether it holds now; to be asked once a step."""
        answers = [[condition.holds(world) for condition in group] for group in self._groups]
        return any(bool(group) and all(group) for group in answers)


class Condition:
    """A `Condition` with its edge and its delay."""

    def __init__(self, element: Element) -> None:
        where = f"condition {element.get('name', ''):.60}"
        edge, delay = element.get("conditionEdge", "none"), number_of(element, "delay", where, 0.0)
        if edge not in _EDGES or not 0.0 <= delay <= _LONGEST_DELAY:
            raise InputError(f"{where}: conditionEdge {edge:.40} or delay {delay:g} s is not read")
        self._edge = _EDGES[edge]
        self._question = _read_question(element, where)
        self._before: bool | None = None
        self._late = deque([False] * round(delay / STEP))

    def holds(self, world: World) -> bool:
        """Whether it holds now; to be asked once a step."""
        now = self._question(world)
        # Before the first look nothing is known to have been otherwise.
        answer = self._edge(now if self._before is None else self._before, now)
        self._before = now
        self._late.append(answer)
        return self._late.popleft()


def _read_question(condition: Element, where: str) -> Question:
    by_value = condition.find("ByValueCondition/*")
    if by_value is not None:
        return _read_value_question(by_value, where)
    by_entity = condition.find("ByEntityCondition")
    if by_entity is None:
        raise InputError(f"{where}: neither ByValueCondition nor ByEntityCondition")
    triggering = child(by_entity, "TriggeringEntities", where)
    names = [text_of(one, "entityRef", where) for one in triggering.findall("EntityRef")]
    together = any if text_of(triggering, "triggeringEntitiesRule", where) == "any" else all
    kinds = list(child(by_entity, "EntityCondition", where))
    if len(kinds) != 1 or not names:
        raise InputError(f"{where}: one EntityCondition and one or more entities are needed")
    ask = _read_entity_question(kinds[0], where)

    def answer(world: World) -> bool:
        movers = [world.mover(name) for name in names]
        return together(mover.place is not None and ask(world, mover) for mover in movers)

    return answer


def _read_value_question(kind: Element, where: str) -> Question:
    if kind.tag == "SimulationTimeCondition":
        holds, limit = _read_rule(kind, where), number_of(kind, "value", where)
        return lambda world: holds(world.time, limit)
    if kind.tag == "StoryboardElementStateCondition":
        part = text_of(kind, "storyboardElementType", where)
        name = text_of(kind, "storyboardElementRef", where).rpartition("::")[2]
        state = text_of(kind, "state", where)
        if state not in _STATES:
            raise InputError(f"{where}: state {state:.60} is not read")
        return lambda world: any(_STATES[state](one, world.step) for one in world.states.get((part, name), []))
    raise InputError(f"{where}: <{kind.tag:.60}> is not read")


# A change of state is seen in the step in which it happens and in the next, as not all are asked after it.
_STATES = {
    "startTransition": lambda state, step: state.started is not None and step - state.started <= 1,
    "runningState": lambda state, step: state.started is not None and state.ended is None,
    "endTransition": lambda state, step: state.ended is not None and not state.stopped and step - state.ended <= 1,
    "stopTransition": lambda state, step: state.ended is not None and state.stopped and step - state.ended <= 1,
    "completeState": lambda state, step: state.ended is not None,
    "standbyState": lambda state, step: state.started is None,
}


def _read_entity_question(kind: Element, where: str) -> Callable[[World, Mover], bool]:
    if kind.tag == "TraveledDistanceCondition":
        metres = number_of(kind, "value", where)
        return lambda _, mover: mover.travelled >= metres
    if kind.tag == "CollisionCondition":
        hit = text_of(child(kind, "EntityRef", where), "entityRef", where)
        return lambda world, mover: _touch(mover, world.mover(hit))
    if kind.tag == "ReachPositionCondition":
        position, tolerance = child(kind, "Position", where), number_of(kind, "tolerance", where)
        return lambda world, mover: _apart(world, mover, position) <= tolerance
    if kind.tag not in _MEASURES:
        raise InputError(f"{where}: <{kind.tag:.60}> is not read")
    measure, holds, limit = _MEASURES[kind.tag], _read_rule(kind, where), number_of(kind, "value", where)
    if kind.tag == "RelativeDistanceCondition" and kind.get("relativeDistanceType") != "longitudinal":
        raise InputError(f"{where}: relativeDistanceType {kind.get('relativeDistanceType')!r:.60} is not read")
    freespace = kind.get("freespace", "false") in ("true", "1")
    along_road = kind.get("alongRoute") in ("true", "1") or kind.get("coordinateSystem", "entity") != "entity"
    target = kind.find("TimeToCollisionConditionTarget/EntityRef")
    name = kind.get("entityRef") if target is None else target.get("entityRef")
    if kind.tag != "SpeedCondition" and name is None:
        raise InputError(f"{where}: <{kind.tag}> without an entity as its target is not read")

    def ask(world: World, mover: Mover) -> bool:
        other = world.mover(name) if name is not None else mover
        return other.place is not None and holds(measure(mover, other, freespace, along_road), limit)

    return ask


def _read_rule(kind: Element, where: str) -> Callable[[float, float], bool]:
    rule = text_of(kind, "rule", where)
    if rule not in _RULES:
        raise InputError(f"{where}: rule {rule:.60} is not read")
    return _RULES[rule]


def _headway(mover: Mover, other: Mover, freespace: bool, along_road: bool) -> float:
    """Seconds until it is where another now is; NaN, for which no rule holds, where that is behind or it stands."""
    gap = mover.gap(other, freespace, along_road)
    return gap / mover.speed if gap >= 0.0 and mover.speed > 0.0 else np.nan


def _time_to_collision(mover: Mover, other: Mover, freespace: bool, along_road: bool) -> float:
    """Seconds until it reaches another ahead at the speeds of now; NaN where it does not come nearer."""
    gap = mover.gap(other, freespace, along_road)
    facing = float(np.cos(other.pose.heading - mover.pose.heading))
    closing = mover.speed - other.speed * facing
    return gap / closing if gap >= 0.0 and closing > 0.0 else np.nan


_MEASURES: dict[str, Callable[[Mover, Mover, bool, bool], float]] = {
    "RelativeDistanceCondition": lambda mover, other, freespace, along: abs(mover.gap(other, freespace, along)),
    "TimeHeadwayCondition": _headway,
    "TimeToCollisionCondition": _time_to_collision,
    "SpeedCondition": lambda mover, *_: mover.speed,
    "RelativeSpeedCondition": lambda mover, other, *_: mover.speed - other.speed,
}


def _apart(world: World, mover: Mover, position: Element) -> float:
    there, pose = world.roads.pose(world.place(position)[0]), mover.pose
    return float(np.hypot(there.x - pose.x, there.y - pose.y))


def _touch(first: Mover, second: Mover) -> bool:
    if second.place is None:
        return False
    boxes = [
        footprints(np.array([[*mover.box_center, 0.0, mover.pose.heading]]), mover.entity.length, mover.entity.width)[0]
        for mover in (first, second)
    ]
    return bool(shapely.intersects(*boxes))
