"""Roads of the situations: lanes and edges about the ego, which starts at the origin and drives along x."""

from itertools import pairwise

import numpy as np

from olt_closed_loop.rollouts.rollout_record import LaneLines
from olt_generator.poses import Array

WIDTH = 3.7
CROSSING = 60.0
"""x in metres where roads cross."""
RING = 16.0
"""Radius in metres of the middle of the roundabout's lane, about (CROSSING, RING + 1)."""

Red = tuple[tuple[float, float], ...] | None


def _lane(center: Array, red: Red = None) -> LaneLines:
    """A lane of the usual width about a line (n, 2); red in seconds."""
    ahead = np.gradient(center, axis=0)
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1) / np.linalg.norm(ahead, axis=1, keepdims=True)
    lines = (np.column_stack([center + side * left, np.zeros(len(center))]) for side in (0.0, WIDTH / 2, -WIDTH / 2))
    phases = None if red is None else np.array([[round(t * 1e6) for t in phase] for phase in red], np.int64)
    return LaneLines(*lines, red_us=None if phases is None else phases.reshape(-1, 2))


def _line(start: tuple[float, float], end: tuple[float, float]) -> Array:
    count = max(round(float(np.hypot(end[0] - start[0], end[1] - start[1])) / 2.0), 1) + 1
    return np.linspace(start, end, count)


def two_way(lanes: int = 1) -> tuple[LaneLines, ...]:
    """A road with `lanes` lanes each way; the ego's is the leftmost of its way, in sections of 60 m."""
    cuts = np.arange(-120.0, 241.0, 60.0)
    along = [_lane(_line((a, -WIDTH * lane), (b, -WIDTH * lane))) for lane in range(lanes) for a, b in pairwise(cuts)]
    against = [
        _lane(_line((b, WIDTH * (1 + lane)), (a, WIDTH * (1 + lane))))
        for lane in range(lanes)
        for a, b in pairwise(cuts)
    ]
    return (*along, *against)


def left_hand() -> tuple[LaneLines, ...]:
    """A road on which traffic keeps to the left: those who come towards the ego are on its right."""
    return _lane(_line((-120.0, 0.0), (240.0, 0.0))), _lane(_line((240.0, -WIDTH), (-120.0, -WIDTH)))


def junction(ego_red: Red = None, other_red: Red = None) -> tuple[LaneLines, ...]:
    """A two-way road crossed by a road from south to north at x = 60, each lane in a part before and one across.

    Lights stand 6 m before the middle of the crossing road, for the ego and for those who come from the south.
    """
    before, after = CROSSING - 6.0, CROSSING + 6.0
    return (
        _lane(_line((-120.0, 0.0), (before, 0.0))),
        _lane(_line((before, 0.0), (after, 0.0)), ego_red),
        _lane(_line((after, 0.0), (240.0, 0.0))),
        _lane(_line((240.0, WIDTH), (-120.0, WIDTH))),
        _lane(_line((CROSSING, -120.0), (CROSSING, -6.0))),
        _lane(_line((CROSSING, -6.0), (CROSSING, 10.0)), other_red),
        _lane(_line((CROSSING, 10.0), (CROSSING, 120.0))),
        _lane(_line((CROSSING - WIDTH, 120.0), (CROSSING - WIDTH, -120.0))),
    )


def roundabout() -> tuple[LaneLines, ...]:
    """A ring that is driven counter-clockwise and touches y = 1 at x = 60, and a road to it along y = 0."""
    turn = np.linspace(-np.pi, np.pi, 73) - np.pi / 2.0
    ring = np.array([CROSSING, RING + 1.0]) + RING * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    return (
        _lane(ring[:37]),
        _lane(ring[36:]),
        _lane(_line((-60.0, -6.0), (38.0, -6.0))),
        _lane(_line((CROSSING + 30.0, -30.0), (CROSSING + 14.0, 0.0))),
    )


def merge() -> tuple[LaneLines, ...]:
    """A road along x, and a lane from the right that leads into it between x = 60 and x = 120."""
    x = np.arange(-120.0, 181.0, 2.0)
    share = np.clip((x - CROSSING) / 60.0, 0.0, 1.0)
    ramp = -WIDTH * (1.0 - share**2 * (3.0 - 2.0 * share))
    return _lane(_line((-120.0, 0.0), (240.0, 0.0))), _lane(np.stack([x, ramp], axis=-1))
