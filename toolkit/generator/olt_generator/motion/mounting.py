"""How a sensor is turned against the vehicle, from the way the vehicle moves.

The rear axle does not slip sideways, so the rig origin moves along rig x. A sensor elsewhere does not: l metres ahead
of the axle it moves sideways by l times the turn, which in a bend of radius r looks like a mounting yaw of l / r. So it
is the origin's motion that has to point along rig x, and where the origin lies in the sensor depends on the mounting:
both are found together, by iteration.

A chord between two poses points half a turn away from the heading at either; it is seen in the axes halfway between,
along which the chord of an arc lies exactly.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from olt_generator.poses import Array, invert, make_pose

# Chords over which the direction of travel is told: with places that err by a centimetre, one gives it to 0.4 degrees.
CHORD_METRES = 2.0
# Chords begin at least this far from each other; nearer ones say the same, most of all where the vehicle stands.
SPACING_METRES = 0.5
_ITERATIONS = 50
_CONVERGED = 1e-10


def align_mounting(T_world_sensor: Array, T_rig_sensor: Array) -> Array | None:
    """The mounting (4, 4) with the pitch and yaw for which the rig origin moves along rig x.

    Median over all chords, each of `CHORD_METRES`, so that a few wrong poses do not count.

    Args:
        T_world_sensor: (n, 4, 4) metric poses of the sensor in a fixed frame, in the order of time.
        T_rig_sensor: (4, 4) rough mounting. The position is taken as it is, and so is the turn about rig x, which
            motion does not show; the rest tells which way is ahead, so it must be less than 90 degrees off.

    Returns:
        None where the vehicle gets nowhere, so that its motion says nothing about the mounting.
    """
    chords = _find_chords(T_world_sensor[:, :3, 3])
    if not chords:
        return None
    first, last = np.array(chords).T
    step = invert(T_world_sensor[first]) @ T_world_sensor[last]
    R_halfway = Rotation.from_rotvec(-0.5 * Rotation.from_matrix(step[:, :3, :3]).as_rotvec())
    position, R_rig_sensor = T_rig_sensor[:3, 3], T_rig_sensor[:3, :3]
    for _ in range(_ITERATIONS):
        origin = -R_rig_sensor.T @ position
        moved = step[:, :3, 3] + (step[:, :3, :3] - np.eye(3)) @ origin
        x, y, z = R_rig_sensor @ R_halfway.apply(moved).T
        ahead = np.where(x < 0.0, -1.0, 1.0)
        # Rz(yaw) Ry(pitch) turns the usual direction of travel to rig x, and leaves a level sensor level.
        pitch = float(np.median(np.arctan2(ahead * z, np.abs(x))))
        yaw = -float(np.median(np.arctan2(ahead * y, np.hypot(x, z))))
        R_rig_sensor = Rotation.from_euler("ZY", [yaw, pitch]).as_matrix() @ R_rig_sensor
        if max(abs(yaw), abs(pitch)) < _CONVERGED:
            break
    return make_pose(R_rig_sensor, position)


def _find_chords(positions: Array) -> list[tuple[int, int]]:
    """First and last index of every chord of positions (n, 3)."""
    chords: list[tuple[int, int]] = []
    for first, position in enumerate(positions):
        if chords and np.linalg.norm(position - positions[chords[-1][0]]) < SPACING_METRES:
            continue
        away = np.flatnonzero(np.linalg.norm(positions[first:] - position, axis=1) >= CHORD_METRES)
        if len(away):
            chords.append((first, first + int(away[0])))
    return chords
