"""In which gear a plan is driven, and how far: plans may turn back, as three-point turns do.

What counts is the plan's own motion along its headings, not where the vehicle is: one that has overshot a plan to stand
does not back up. Ways shorter than `TURN_DISTANCE` are noise.
"""

import numpy as np

from olt_generator.poses import Array

TURN_DISTANCE = 0.1
"""Metres against the gear from which a plan turns back."""
FIRST_WAY = 1.0
"""Metres from which a plan is sure enough to steer by before the vehicle moves."""


def travelled(poses: Array) -> Array:
    """Metres (n,) that poses x, y, yaw (n, 3) have come along their headings since the first; backwards is negative."""
    moved = np.diff(poses, axis=0)
    heading = poses[:-1, 2] + 0.5 * moved[:, 2]
    return np.concatenate([[0.0], np.cumsum(moved[:, 0] * np.cos(heading) + moved[:, 1] * np.sin(heading))])


def asks_for_reverse(poses: Array, reverse: bool) -> bool:
    """The gear in which a standing vehicle begins to follow poses (n, 3): the present one where they stand, too."""
    way = travelled(poses)
    far = np.flatnonzero(np.abs(way) > TURN_DISTANCE)
    return bool(way[far[0]] < 0.0) if len(far) else reverse


def first_curvature(poses: Array) -> float | None:
    """Curvature (1/m) of the first `FIRST_WAY` metres of poses (n, 3), either way; None where they go less far."""
    way = travelled(poses)
    far = np.flatnonzero(np.abs(way) > FIRST_WAY)
    return float((poses[far[0], 2] - poses[0, 2]) / way[far[0]]) if len(far) else None


def until_turn(poses: Array, reverse: bool) -> Array:
    """Poses (n, 3) as far as they go in this gear; from where they turn back they stand."""
    way = travelled(poses) * (-1.0 if reverse else 1.0)
    back = np.flatnonzero(np.maximum.accumulate(way) - way > TURN_DISTANCE)
    if not len(back):
        return poses
    turn = int(np.argmax(way[: back[0]]))
    return poses[np.minimum(np.arange(len(poses)), turn)]
