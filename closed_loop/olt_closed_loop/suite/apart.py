"""Whether scenes share roads with others, such as those that a policy was trained on.

A lane is known by its shape: positions along its centre line in its own frame and its width, to the millimetre, so a
road that was moved, turned or put on hills is still the same one.
"""

import hashlib
from collections.abc import Iterable

import numpy as np

from olt_closed_loop.scenes.polylines import length_of, resample
from olt_closed_loop.scenes.scene import Lane, Scene

_STEP = 2.0
_FEWEST = 3


def lane_shape(lane: Lane) -> str:
    """The hash of a lane's shape, the same wherever it lies."""
    length = length_of(lane.center[:, :2])
    points = resample(lane.center[:, :2], max(_FEWEST, round(length / _STEP) + 1))
    ahead = points[1] - points[0]
    ahead = ahead / max(float(np.hypot(*ahead)), 1e-9)
    own = (points - points[0]) @ np.array([[ahead[0], -ahead[1]], [ahead[1], ahead[0]]])
    width = np.hypot(*(resample(lane.left[:, :2], 5) - resample(lane.right[:, :2], 5)).T)
    figures = np.round(1e3 * np.concatenate([own.ravel(), width, [length]])) + 0.0
    return hashlib.sha256(figures.astype(np.int64).tobytes()).hexdigest()


def shared_lanes(scenes: Iterable[Scene], others: Iterable[Scene]) -> list[tuple[str, str, str, str]]:
    """Lanes of equal shape: (scene, lane, other scene, its lane)."""
    known = {lane_shape(lane): (other.name, lane.id) for other in others for lane in other.lanes}
    return [
        (scene.name, lane.id, *known[shape])
        for scene in scenes
        for lane in scene.lanes
        if (shape := lane_shape(lane)) in known
    ]
