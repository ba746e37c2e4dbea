"""What the parts of a storyboard make road users do (OpenSCENARIO 1.1, section 7.4)."""

from collections.abc import Callable
from xml.etree.ElementTree import Element

import numpy as np

from olt_closed_loop.scenes.polylines import arc_lengths
from olt_closed_loop.scenes.sources.openscenario.motion import Mover, OnLane, OnPath
from olt_closed_loop.scenes.sources.openscenario.world import STEP, World, lane_number
from olt_closed_loop.scenes.sources.xml_files import child, number_of, text_of
from olt_generator.errors import InputError

Running = Callable[[World], bool]
"""Called once a step; True once it is done. It sets a speed or an offset; who moves, moves afterwards."""

_SHAPES: dict[str, Callable[[float], float]] = {
    "linear": lambda share: share,
    "cubic": lambda share: share * share * (3.0 - 2.0 * share),
    "sinusoidal": lambda share: 0.5 - 0.5 * float(np.cos(np.pi * share)),
    "step": lambda share: 1.0,
}
_PEAKS = {"linear": 1.0, "cubic": 1.5, "sinusoidal": np.pi / 2.0, "step": 1.0}
"""Steepest slope of each shape."""
_BENDS = {"cubic": 6.0, "sinusoidal": np.pi**2 / 2.0}
"""Largest second derivative of each shape that has one."""
_GAP_GAIN, _SPEED_GAIN = 0.4, 1.2
"""1/s^2 and 1/s of the follower that keeps a distance: critically damped within 5 %."""


def start_action(action: Element, mover: Mover, world: World) -> tuple[str, Running]:
    """Begin what a `PrivateAction` (resolved) says.

    Returns:
        What it governs ("speed", "place" or "nothing": a new action ends one that governs the same), and the action.

    Raises:
        InputError: the action is of a kind that is not read, or cannot be carried out.
    """
    if len(action) != 1:
        raise InputError(f"a PrivateAction of {len(action)} parts; one is expected")
    (kind,) = action
    if kind.tag in ("LongitudinalAction", "LateralAction", "RoutingAction"):
        if len(kind) != 1:
            raise InputError(f"<{kind.tag}> of {len(kind)} parts; one is expected")
        (kind,) = kind
    if kind.tag not in _STARTS:
        raise InputError(f"<{kind.tag:.60}> is not read as an action")
    governs, start = _STARTS[kind.tag]
    return governs, start(kind, mover, world)


def _done(_: World) -> bool:
    return True


def _teleport(kind: Element, mover: Mover, world: World) -> Running:
    place, turn = world.place(child(kind, "Position", kind.tag))
    mover.place, mover.turned = place, turn
    return _done


def _assign_route(kind: Element, mover: Mover, world: World) -> Running:
    reference = kind.find("CatalogReference")
    route = world.catalogues.entry(reference) if reference is not None else child(kind, "Route", kind.tag)
    mover.route = world.route(route)[1]
    return _done


def _ignore_controller(kind: Element, mover: Mover, world: World) -> Running:
    return _done


def _change_speed(kind: Element, mover: Mover, world: World) -> Running:
    dynamics, target = child(kind, "SpeedActionDynamics", kind.tag), child(kind, "SpeedActionTarget", kind.tag)
    wanted, continuous = _read_speed(target, world)
    shape, first, last = _read_shape(dynamics), mover.speed, wanted()
    seconds = _duration(dynamics, abs(last - first), 0.5 * (first + last))
    begun = world.step

    def run(world: World) -> bool:
        share = _share((world.step - begun + 1) * STEP, seconds)
        mover.speed = first + (wanted() - first) * (1.0 if share >= 1.0 else _SHAPES[shape](share))
        return share >= 1.0 and not continuous

    # A step is there at once, so that what begins with it sees it.
    if shape == "step" or seconds == 0.0:
        mover.speed = last
        return run if continuous else _done
    return run


def _read_speed(target: Element, world: World) -> tuple[Callable[[], float], bool]:
    """What the speed is to be, and whether it is to be kept so."""
    absolute, relative = target.find("AbsoluteTargetSpeed"), target.find("RelativeTargetSpeed")
    if absolute is not None:
        value = number_of(absolute, "value", absolute.tag)
        if value < 0.0:
            raise InputError(f"a speed of {value:g} m/s; driving backwards is not read")
        return lambda: value, False
    if relative is None:
        raise InputError("a SpeedActionTarget that is neither absolute nor relative")
    other, value = world.mover(text_of(relative, "entityRef", relative.tag)), number_of(relative, "value", relative.tag)
    if relative.get("speedTargetValueType", "delta") == "factor":
        return lambda: max(0.0, other.speed * value), relative.get("continuous") in ("true", "1")
    return lambda: max(0.0, other.speed + value), relative.get("continuous") in ("true", "1")


def _keep_distance(kind: Element, mover: Mover, world: World) -> Running:
    other = world.mover(text_of(kind, "entityRef", kind.tag))
    freespace = text_of(kind, "freespace", kind.tag) in ("true", "1")
    continuous = kind.get("continuous") in ("true", "1")
    limits = kind.find("DynamicConstraints")
    ahead = kind.get("displacement", "any") == "leadingReferencedEntity"
    time_gap, metres = number_of(kind, "timeGap", kind.tag, -1.0), number_of(kind, "distance", kind.tag, -1.0)
    if (time_gap < 0.0) == (metres < 0.0):
        raise InputError(f"<{kind.tag}> needs a distance or a timeGap that is not negative")
    if limits is None:
        if continuous:
            raise InputError(f"<{kind.tag}> without DynamicConstraints is not read as continuous")
        wanted = metres if metres >= 0.0 else time_gap * (other.speed if ahead else mover.speed)
        _put_at_distance(mover, other, wanted, ahead, freespace)
        return _done
    most, least, fastest = (
        number_of(limits, name, kind.tag, 1e3) for name in ("maxAcceleration", "maxDeceleration", "maxSpeed")
    )

    def run(world: World) -> bool:
        gap = mover.gap(other, freespace, along_road=True)
        side = 1.0 if gap >= 0.0 else -1.0
        wanted = metres if metres >= 0.0 else time_gap * (mover.speed if side > 0.0 else other.speed)
        error = gap - side * wanted
        change = float(np.clip(_GAP_GAIN * error + _SPEED_GAIN * (other.speed - mover.speed), -least, most))
        mover.speed = float(np.clip(mover.speed + change * STEP, 0.0, fastest))
        return not continuous and abs(error) < 0.1 and abs(other.speed - mover.speed) < 0.1

    return run


def _put_at_distance(mover: Mover, other: Mover, metres: float, ahead: bool, freespace: bool) -> None:
    if not (isinstance(mover.place, OnLane) and isinstance(other.place, OnLane)):
        raise InputError("a LongitudinalDistanceAction between entities that are not both in lanes is not read")
    front, rear = (mover, other) if ahead else (other, mover)
    between = metres + (front.entity.rear + rear.entity.front if freespace else 0.0)
    there = mover.roads.advance(other.place, between if ahead else -between, other.route)
    if there is None:
        raise InputError(f"{metres:g} m from entity {other.entity.name:.60} there is no road")
    same_road = there.road == mover.place.road
    lane = mover.place.lane if same_road else there.lane
    mover.place = OnLane(there.road, lane, there.s, mover.place.offset, there.way)


def _change_lane(kind: Element, mover: Mover, world: World) -> Running:
    place = mover.place
    if not isinstance(place, OnLane):
        raise InputError(f"entity {mover.entity.name:.60} changes its lane, and is in none")
    target = child(kind, "LaneChangeTarget", kind.tag)
    absolute, relative = target.find("AbsoluteTargetLane"), target.find("RelativeTargetLane")
    if absolute is not None:
        lane = lane_number(absolute, "value")
    elif relative is not None:
        other = world.mover(text_of(relative, "entityRef", relative.tag)).place
        if not isinstance(other, OnLane):
            raise InputError("a RelativeTargetLane beside an entity that is in no lane")
        lane = world.roads.beside(other, lane_number(relative, "value"))
    else:
        raise InputError("a LaneChangeTarget that is neither absolute nor relative")
    first = mover.change_lane(lane)
    last = number_of(kind, "targetLaneOffset", kind.tag, 0.0)
    dynamics = child(kind, "LaneChangeActionDynamics", kind.tag)
    return _move_sideways(mover, world, first, last, _read_shape(dynamics), dynamics)


def _change_offset(kind: Element, mover: Mover, world: World) -> Running:
    if not isinstance(mover.place, OnLane):
        raise InputError(f"entity {mover.entity.name:.60} changes its offset from a lane, and is in none")
    if kind.get("continuous") in ("true", "1"):
        raise InputError(f"<{kind.tag}> is not read as continuous")
    target, dynamics = child(kind, "LaneOffsetTarget", kind.tag), child(kind, "LaneOffsetActionDynamics", kind.tag)
    absolute, relative = target.find("AbsoluteTargetLaneOffset"), target.find("RelativeTargetLaneOffset")
    first = mover.place.offset
    if absolute is not None:
        last = number_of(absolute, "value", absolute.tag)
    elif relative is not None:
        other = world.mover(text_of(relative, "entityRef", relative.tag)).place
        if not isinstance(other, OnLane):
            raise InputError("a RelativeTargetLaneOffset beside an entity that is in no lane")
        last = other.offset + number_of(relative, "value", relative.tag)
    else:
        raise InputError("a LaneOffsetTarget that is neither absolute nor relative")
    shape = _read_shape(dynamics)
    most = number_of(dynamics, "maxLateralAcc", kind.tag, 0.0)
    seconds = float(np.sqrt(_BENDS[shape] * abs(last - first) / most)) if most > 0.0 and shape in _BENDS else 0.0
    return _move_sideways(mover, world, first, last, shape, None, seconds)


def _move_sideways(
    mover: Mover, world: World, first: float, last: float, shape: str, dynamics: Element | None, seconds: float = 0.0
) -> Running:
    """A change of the offset from the lane's centre; over metres where the dynamics count those."""
    if dynamics is not None:
        metres = dynamics.get("dynamicsDimension") == "distance"
        seconds = _duration(dynamics, _PEAKS[shape] * abs(last - first), 1.0 if metres else 0.0)
    else:
        metres = False
    begun, from_here = world.step, mover.travelled

    def run(world: World) -> bool:
        if not isinstance(mover.place, OnLane):
            return True
        passed = mover.travelled - from_here if metres else (world.step - begun + 1) * STEP
        share = _share(passed, seconds)
        mover.set_offset(last if share >= 1.0 else first + (last - first) * _SHAPES[shape](share), STEP)
        if share >= 1.0:
            mover.turned = 0.0
        return share >= 1.0

    return run


def _follow(kind: Element, mover: Mover, world: World) -> Running:
    trajectory = kind.find("Trajectory")
    trajectory = kind.find("TrajectoryRef/Trajectory") if trajectory is None else trajectory
    if trajectory is None:
        raise InputError("a FollowTrajectoryAction without its Trajectory (catalogues of them are not read)")
    path, times = world.path(trajectory)
    mover.place, mover.turned = path, 0.0
    arc = arc_lengths(path.path)
    timing = kind.find("TimeReference/Timing")
    if timing is None:
        return lambda _: not isinstance(mover.place, OnPath)
    relative = timing.get("domainAbsoluteRelative", "relative") == "relative"
    scale, offset = number_of(timing, "scale", "Timing", 1.0), number_of(timing, "offset", "Timing", 0.0)
    seconds = np.array(times) * scale + offset + (world.time if relative else 0.0)
    waits = np.diff(seconds)
    if np.any(waits < 0.0) or np.any((waits == 0.0) & (np.diff(arc) > 0.0)):
        raise InputError("a Trajectory whose times run back, or one time at two places")

    def run(world: World) -> bool:
        if not isinstance(mover.place, OnPath):
            mover.speed = 0.0
            return True
        along = float(np.interp(world.time + STEP, seconds, arc))
        mover.speed = max(0.0, along - mover.place.along) / STEP
        done = world.time + STEP >= seconds[-1]
        if done:
            mover.place, mover.speed = mover.roads.pose(OnPath(path.path, float(arc[-1]))), 0.0
        return bool(done)

    return run


def _synchronize(kind: Element, mover: Mover, world: World) -> Running:
    """Arrive at a place when another arrives at its own: a cubic in time, planned anew at every step."""
    master = world.mover(text_of(kind, "masterEntityRef", kind.tag))
    goals = [child(kind, name, kind.tag) for name in ("TargetPositionMaster", "TargetPosition")]
    theirs, ours = (world.place(goal)[0] for goal in goals)
    final = child(kind, "FinalSpeed", kind.tag).find("AbsoluteSpeed")
    if final is None or not (isinstance(theirs, OnLane) and isinstance(ours, OnLane)):
        raise InputError(f"<{kind.tag}> is read with an AbsoluteSpeed and with places in lanes")
    speed = number_of(final, "value", final.tag)

    def run(world: World) -> bool:
        if not (isinstance(mover.place, OnLane) and isinstance(master.place, OnLane)):
            return True
        rest = world.roads.distance(mover.place, ours, mover.route)
        left = world.roads.distance(master.place, theirs, master.route)
        if rest is None or left is None or rest <= 0.0 or left <= 0.0 or master.speed <= 0.0:
            mover.speed = speed
            return True
        seconds = max(left / master.speed, STEP)
        change = 6.0 * rest / seconds**2 - (4.0 * mover.speed + 2.0 * speed) / seconds
        mover.speed = max(0.0, mover.speed + change * STEP)
        return False

    return run


def _read_shape(dynamics: Element) -> str:
    shape = text_of(dynamics, "dynamicsShape", dynamics.tag)
    if shape not in _SHAPES:
        raise InputError(f"{dynamics.tag}: dynamicsShape {shape:.60} is not read")
    return shape


def _duration(dynamics: Element, change: float, mean_speed: float) -> float:
    """Seconds (or metres, where `mean_speed` is 1) that a change takes; infinite at a rate of zero."""
    value, dimension = number_of(dynamics, "value", dynamics.tag), text_of(dynamics, "dynamicsDimension", dynamics.tag)
    if dimension == "rate":
        return change / abs(value) if value else (np.inf if change else 0.0)
    if value < 0.0:
        raise InputError(f"{dynamics.tag}: a {dimension:.40} of {value:g}")
    if dimension == "time":
        return value
    if dimension == "distance":
        return value / mean_speed if mean_speed > 0.0 else 0.0
    raise InputError(f"{dynamics.tag}: dynamicsDimension {dimension:.60} is not read")


def _share(passed: float, whole: float) -> float:
    return min(1.0, passed / whole) if whole > 0.0 else 1.0


_STARTS: dict[str, tuple[str, Callable[[Element, Mover, World], Running]]] = {
    "TeleportAction": ("place", _teleport),
    "AssignRouteAction": ("nothing", _assign_route),
    "ControllerAction": ("nothing", _ignore_controller),
    "ActivateControllerAction": ("nothing", _ignore_controller),
    "SpeedAction": ("speed", _change_speed),
    "LongitudinalDistanceAction": ("speed", _keep_distance),
    "SynchronizeAction": ("speed", _synchronize),
    "LaneChangeAction": ("place", _change_lane),
    "LaneOffsetAction": ("place", _change_offset),
    "FollowTrajectoryAction": ("place", _follow),
}
