"""What a road map consists of: lanes and their markings, stop lines, crossings and lights.

A lane runs in the direction of its points, and traffic on it drives that way. What a source does not say is None:
no field that describes the world has a default that could be taken for knowledge.
"""

from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from olt_generator.poses import Array

LaneType = Literal["driving", "shoulder", "cycle", "sidewalk"]
Pattern = Literal["solid", "dashed", "double", "kerb", "none"]
Control = Literal["priority", "yield", "stop", "light"]
LightState = Literal["red", "amber", "green", "off", "unknown"]

HUMAN = "human"
"""How the ids of lights begin whose states are the signals of a person; they outrank the other lights of a lane."""

LANE_TYPES: tuple[LaneType, ...] = get_args(LaneType)
PATTERNS: tuple[Pattern, ...] = get_args(Pattern)
CONTROLS: tuple[Control, ...] = get_args(Control)
LIGHT_STATES: tuple[LightState, ...] = get_args(LightState)


@dataclass(frozen=True)
class Marking:
    """What lies along one side of a lane, as seen from that lane.

    Attributes:
        pattern: solid, dashed or double line, a kerb, or none (nothing is painted).
        crossable: whether traffic of this lane may cross it; None where that is not known.
        wear: share of the paint that is gone, 0 (fresh) to 1 (nothing left).
    """

    pattern: Pattern
    crossable: bool | None = None
    wear: float = 0.0


@dataclass(frozen=True)
class Lane:
    """One lane: centre line and borders, each (n, 3) metres, in driving direction.

    Attributes:
        id: unique in the map.
        center, left, right: lines of equally many points.
        successors: ids of the lanes that follow; those that lead here follow from them (`RoadMap.predecessors`).
        type: driving, shoulder, cycle or sidewalk; None where not known (then it counts as a driving lane).
        left_neighbours, right_neighbours: ids of the lanes beside it, whichever way they run; () for none, which all
            ways through junctions of ours have; None where not known.
        left_marking, right_marking: what lies on its borders; None where not known.
        junction: id of the junction that it leads through; None outside of junctions, or where not known.
        yields_to: ids of the lanes whose traffic goes first; () when it has right of way over all that it conflicts
            with, None where not known.
        speed_limit: m/s, None where not known.
    """

    id: str
    center: Array
    left: Array
    right: Array
    successors: tuple[str, ...] = ()
    type: LaneType | None = None
    left_neighbours: tuple[str, ...] | None = None
    right_neighbours: tuple[str, ...] | None = None
    left_marking: Marking | None = None
    right_marking: Marking | None = None
    junction: str | None = None
    yields_to: tuple[str, ...] | None = None
    speed_limit: float | None = None

    @property
    def for_cars(self) -> bool:
        """Whether cars drive on it; a lane of unknown type is taken for one."""
        return self.type in (None, "driving")


@dataclass(frozen=True)
class StopLine:
    """Where traffic waits.

    Attributes:
        id: unique among stop lines.
        points: (2, 3) its ends, the left one first in driving direction, metres.
        lanes: ids of the lanes that end at it.
        control: why: yield, stop or light; None where not known.
    """

    id: str
    points: Array
    lanes: tuple[str, ...] = ()
    control: Control | None = None


@dataclass(frozen=True)
class Crossing:
    """A place where people on foot cross.

    Attributes:
        id: unique among crossings.
        outline: (n, 3) counter-clockwise, metres; the last point does not repeat the first.
        lanes: ids of the lanes that it crosses.
        zebra: whether it is painted with bars; None where not known.
    """

    id: str
    outline: Array
    lanes: tuple[str, ...] = ()
    zebra: bool | None = None


@dataclass(frozen=True)
class Light:
    """A traffic light and its states over time.

    Attributes:
        id: unique among lights.
        lanes: ids of the lanes (the ways through the junction) that it rules, at whose start one waits.
        timestamps_us: (n,) int64, strictly increasing: when each state begins. Before the first one it is unknown.
        states: (n,) red, amber, green, off or unknown.
        position: (3,) of the lamp, metres; None where not known.
    """

    id: str
    lanes: tuple[str, ...]
    timestamps_us: NDArray[np.int64]
    states: tuple[LightState, ...]
    position: Array | None = field(default=None)

    @property
    def by_hand(self) -> bool:
        """Whether its states are the signals of a person."""
        return self.id.startswith(HUMAN)

    def state_at(self, time_us: int) -> LightState:
        """Its state at a time."""
        index = int(np.searchsorted(self.timestamps_us, time_us, side="right")) - 1
        return self.states[index] if index >= 0 else "unknown"

    def spans(self, state: LightState, end_us: int) -> NDArray[np.int64]:
        """From when until when (k, 2) it is in a state; what still holds at the last change ends at `end_us`."""
        ends = np.append(self.timestamps_us[1:], max(end_us, int(self.timestamps_us[-1]) + 1))
        chosen = np.array([one == state for one in self.states], dtype=bool)
        return np.stack([self.timestamps_us, ends], axis=1)[chosen]
