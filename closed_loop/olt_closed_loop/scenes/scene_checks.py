"""What a scene must hold to be driven and scored; every complaint is an `InputError` that names the part."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict

import numpy as np

from olt_closed_loop.scenes.polylines import length_of
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.scenes.sources.fields import FARTHEST
from olt_closed_loop.scenes.sources.tracks import LARGEST_BOX, check_box, check_motion, check_samples
from olt_generator.errors import InputError
from olt_generator.poses import Array
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig import VehicleDimensions

LONGEST_DRIVE = 3600.0
"""Seconds."""
ROTATION_TOLERANCE = 1e-3
"""How far products of a rotation's columns may be from those of a rotation: digits that somebody left out."""


def check_scene(scene: Scene) -> None:
    """Check the parts of a scene that comes from a file.

    Raises:
        InputError: a text is none, the ego does not move as a car does, a vehicle or an agent has no usual size or is
            too far away, two agents have one name, or a line is too short or no place in metres.
    """
    _check_texts(scene)
    _check_rotations(scene.ego)
    if not scene.ego.times[-1] <= LONGEST_DRIVE:
        raise InputError(f"the ego: a drive of {scene.ego.times[-1]:g} s; at most {LONGEST_DRIVE:g} s are expected")
    _check_line("the ego's way", scene.ego.positions, 1)
    check_motion(scene.ego, "the drive")
    _check_vehicle(scene.vehicle)
    _check_agents(scene)
    for what, line, fewest in _lines(scene):
        _check_line(what, line, fewest)
    for lane in scene.lanes:
        if length_of(lane.center) == 0.0:
            raise InputError(f"lane {lane.id:.80}: its centre line has no length")
    if scene.hills is not None and (len(scene.hills.heights) == 0 or not scene.hills.step > 0.0):
        raise InputError("hills: one height or more and a step above 0 m are needed")


def _check_texts(scene: Scene) -> None:
    texts = [scene.name, scene.category, *scene.factors, *scene.assumptions]
    texts += [text for agent in scene.agents for text in (agent.id, agent.label)]
    texts += [part.id for part in (*scene.lanes, *scene.stop_lines, *scene.crossings, *scene.lights)]
    wrong = next((text for text in texts if not isinstance(text, str)), None)
    if wrong is not None:
        raise InputError(f"{wrong!s:.40} stands where a text is expected (a name, class or sentence)")


def _check_rotations(ego: Trajectory) -> None:
    rotation = ego.T_world_rig[:, :3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        products = np.einsum("nji,njk->nik", rotation, rotation) - np.eye(3)
        wrong = ~(np.abs(products).max(axis=(1, 2)) <= ROTATION_TOLERANCE) | ~(np.linalg.det(rotation) > 0.0)
    wrong |= ~(ego.T_world_rig[:, 3] == [0.0, 0.0, 0.0, 1.0]).all(axis=1)
    if wrong.any():
        seconds = ego.timestamps_us[np.argmax(wrong)] * 1e-6
        raise InputError(
            f"the ego at {seconds:.2f} s: its pose is more than a rotation and a translation; take scale out"
        )


def _check_vehicle(vehicle: VehicleDimensions) -> None:
    sizes = asdict(vehicle)
    ahead = sizes.pop("rear_axle_to_bbox_center")
    for name, metres in sizes.items():
        if not 0.0 < metres <= LARGEST_BOX:
            raise InputError(f"the ego: {name} of {metres:g} m; above 0 and at most {LARGEST_BOX:g} m is expected")
    if not abs(ahead) <= 0.5 * vehicle.length:
        raise InputError(f"the ego: rear_axle_to_bbox_center of {ahead:g} m puts the axle outside of its box")


def _check_agents(scene: Scene) -> None:
    count = Counter(agent.id for agent in scene.agents)
    if count and count.most_common(1)[0][1] > 1:
        raise InputError(f"two agents are called {count.most_common(1)[0][0]:.80}; give each its own name")
    start = np.append(scene.ego.positions[0], 0.0)
    for agent in scene.agents:
        where = f"agent {agent.id:.80}"
        check_box((agent.length, agent.width, agent.height), where)
        check_samples(agent.timestamps_us, agent.poses - start, where)


def _lines(scene: Scene) -> Iterator[tuple[str, Array, int]]:
    """Lines (n, 3) by what they are, and how many points each needs."""
    for lane in scene.lanes:
        yield from ((f"lane {lane.id:.80}", line, 2) for line in (lane.center, lane.left, lane.right))
    yield from ((f"road edge {index}", line, 2) for index, line in enumerate(scene.road_edges))
    yield from ((f"drivable outline {index}", line, 3) for index, line in enumerate(scene.drivable))
    yield "the route", scene.route, 2 if len(scene.route) else 0
    yield from ((f"stop line {line.id:.80}", line.points, 2) for line in scene.stop_lines)
    yield from ((f"crossing {place.id:.80}", place.outline, 3) for place in scene.crossings)


def _check_line(what: str, line: Array, fewest: int) -> None:
    if line.ndim != 2 or line.shape[1] != 3 or len(line) < fewest:
        raise InputError(f"{what}: {fewest} or more points of 3 numbers are needed; it has the shape {line.shape}")
    if not (np.abs(line) <= FARTHEST).all():
        raise InputError(f"{what}: a point is farther than {FARTHEST:g} m from the origin; coordinates are metres")
