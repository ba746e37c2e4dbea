"""Parts of a road map as named values (texts, numbers, lists of texts, arrays), and back.

What is not known has no value at all, so files of scenes without it are as they were before there were such parts.
"""

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np

from olt_closed_loop.scenes.maps.lanes import (
    CONTROLS,
    LANE_TYPES,
    LIGHT_STATES,
    PATTERNS,
    Crossing,
    Lane,
    Light,
    Marking,
    StopLine,
)
from olt_generator.errors import InputError
from olt_generator.poses import Array

Value: TypeAlias = str | int | float | tuple[str, ...] | Array
Values = dict[str, Value]

_MARKING = ("marking", "wear", "crossable")
LANE_OPTIONS = (
    *("type", "left_neighbours", "right_neighbours", "junction", "yields_to", "speed_limit"),
    *(f"{side}_{part}" for side in ("left", "right") for part in _MARKING),
)
"""Names of values that a lane need not have."""

_YES_NO = {True: "yes", False: "no"}


def lane_values(lane: Lane) -> Values:
    """A lane as named values."""
    values: dict[str, Value | None] = {name: value for name, value in vars(lane).items() if "marking" not in name}
    for side in ("left", "right"):
        marking: Marking | None = getattr(lane, f"{side}_marking")
        if marking is not None:
            values[f"{side}_marking"] = marking.pattern
            values[f"{side}_wear"] = float(marking.wear)
            values[f"{side}_crossable"] = None if marking.crossable is None else _YES_NO[marking.crossable]
    if lane.speed_limit is not None:
        values["speed_limit"] = float(lane.speed_limit)
    return _known(values)


def lane_of(values: Mapping[str, Any]) -> Lane:
    """The lane of named values.

    Raises:
        InputError: a value is none that it may have.
    """
    values = dict(values)
    for side in ("left", "right"):
        pattern = _choice(values, f"{side}_marking", PATTERNS)
        crossable, wear = _yes_no(values, f"{side}_crossable"), values.pop(f"{side}_wear", 0.0)
        if not 0.0 <= wear <= 1.0:
            raise InputError(f"{side}_wear is {wear:g}; it is 0 to 1")
        values[f"{side}_marking"] = None if pattern is None else Marking(pattern, crossable, wear)
    values["type"] = _choice(values, "type", LANE_TYPES)
    lane = Lane(**values)
    shapes = {line.shape for line in (lane.center, lane.left, lane.right)}
    if len(shapes) > 1 or lane.center.ndim != 2 or lane.center.shape[1] != 3:
        raise InputError(f"lane {lane.id:.80}: centre and borders are (n, 3) with one n")
    return lane


def stop_line_values(line: StopLine) -> Values:
    """A stop line as named values."""
    return _known(vars(line))


def stop_line_of(values: Mapping[str, Any]) -> StopLine:
    """The stop line of named values.

    Raises:
        InputError: a value is none that it may have.
    """
    values = dict(values)
    control = _choice(values, "control", CONTROLS)
    return StopLine(**values, control=control)


def crossing_values(place: Crossing) -> Values:
    """A crossing as named values."""
    return _known(vars(place) | {"zebra": None if place.zebra is None else _YES_NO[place.zebra]})


def crossing_of(values: Mapping[str, Any]) -> Crossing:
    """The crossing of named values.

    Raises:
        InputError: a value is none that it may have.
    """
    values = dict(values)
    zebra = _yes_no(values, "zebra")
    return Crossing(**values, zebra=zebra)


def light_values(light: Light) -> Values:
    """A light as named values; its times as doubles, which hold microseconds of 285 years exactly."""
    return _known(vars(light) | {"timestamps_us": light.timestamps_us.astype(np.float64)})


def light_of(values: Mapping[str, Any]) -> Light:
    """The light of named values.

    Raises:
        InputError: its times do not increase, or states and times differ in number, or a state is not known.
    """
    times, states = values["timestamps_us"], values["states"]
    if len(times) != len(states) or np.any(np.diff(times) <= 0.0) or np.any(np.abs(times) > 2.0**53):
        raise InputError(f"light {values['id']:.80}: one time for each state, increasing microseconds, is expected")
    if unknown := set(states) - set(LIGHT_STATES):
        raise InputError(f"light {values['id']:.80}: state {min(unknown):.40} is none of {', '.join(LIGHT_STATES)}")
    return Light(**(dict(values) | {"timestamps_us": times.astype(np.int64)}))


def _known(values: Mapping[str, Value | None]) -> Values:
    return {name: value for name, value in values.items() if value is not None}


def _choice(values: dict[str, Any], name: str, allowed: tuple[Any, ...]) -> Any:
    value = values.pop(name, None)
    if value is not None and value not in allowed:
        raise InputError(f"{name} is {value!s:.40}; one of {', '.join(allowed)} is expected")
    return value


def _yes_no(values: dict[str, Any], name: str) -> bool | None:
    known = {"yes": True, "no": False, None: None}
    value = values.pop(name, None)
    if value not in known:
        raise InputError(f"{name} is {value!s:.40}; yes or no is expected")
    return known[value]
