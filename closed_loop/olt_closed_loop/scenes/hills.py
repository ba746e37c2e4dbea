"""Hills: ground that rises and falls along one direction, and what stands and drives on it.

Along the direction `u` the height is a chain of short straight pieces; across it the ground is level. So a road that
runs along climbs and dips, one that runs across lies level, and one between them leans as well.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.integrate import cumulative_trapezoid

from olt_closed_loop.scenes.maps.frames import with_points
from olt_closed_loop.scenes.scene import Agent, Hills, Scene
from olt_closed_loop.scenes.scene_map import map_of, with_map
from olt_generator.errors import InputError
from olt_generator.poses import Array, make_pose
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig import VehicleDimensions

STEP = 1.0
_REACH = 1500.0
_UPRIGHT = frozenset(("person",))


@dataclass(frozen=True)
class Wave:
    """One wave of the ground: height in metres (crest to mean), length in metres, and phase in radians."""

    height: float
    length: float
    phase: float


def lay_hills(direction: float, waves: tuple[Wave, ...]) -> Hills:
    """Hills of waves along a direction (radians), within 1.5 km of the origin."""

    def height(along: Array) -> Array:
        phases = (2.0 * np.pi / wave.length * along + wave.phase for wave in waves)
        return sum(
            (wave.height * np.sin(phase) for wave, phase in zip(waves, phases, strict=True)), np.zeros_like(along)
        )

    return _lay(direction, height)


def lay_crest(direction: float, place: float, height: float, length: float) -> Hills:
    """A crest (a dip for a negative height) of `length` metres around a place along a direction; level elsewhere."""
    return _lay(
        direction,
        lambda along: (
            height
            * np.where(
                np.abs(along - place) < length / 2.0, 0.5 + 0.5 * np.cos(2.0 * np.pi * (along - place) / length), 0.0
            )
        ),
    )


def lay_grade(direction: float, start: float, length: float, slope: float, rounding: float = 20.0) -> Hills:
    """A slope (rise over run) along a direction from `start` for `length` metres, rounded over `rounding` at both ends.

    The slope runs linearly from 0 to its value and back within the rounding, half of which lies inside the length.
    """
    knots = [start - rounding / 2.0, start + rounding / 2.0, start + length - rounding / 2.0]
    knots.append(start + length + rounding / 2.0)
    if not 0.0 < rounding <= length:
        raise InputError(
            f"a grade of {length:g} m cannot be rounded over {rounding:g} m; give more than 0, at most that"
        )

    def rise(along: Array) -> Array:
        return cumulative_trapezoid(np.interp(along, knots, (0.0, slope, slope, 0.0)), along, initial=0.0)

    return _lay(direction, rise)


def _lay(direction: float, height: Callable[[Array], Array]) -> Hills:
    along = np.arange(-_REACH, _REACH + STEP, STEP)
    return Hills(direction, float(along[0]), STEP, height(along))


def put_on_hills(scene: Scene, hills: Hills) -> Scene:
    """A scene on level ground, lifted onto hills: the ego leans with the road; agents do where filmed (`stand_up`)."""
    lift = partial(_lift, hills)
    poses = pose_on_hills(hills, scene.ego.T_world_rig, scene.vehicle)
    agents = tuple(
        replace(agent, poses=np.column_stack([_lift(hills, agent.poses[:, :3]), agent.poses[:, 3]]))
        for agent in scene.agents
    )
    lifted = with_map(scene, with_points(map_of(scene), lift))
    ego = Trajectory(scene.ego.timestamps_us, poses)
    return replace(lifted, ego=ego, agents=agents, route=lift(scene.route), hills=hills)


def pose_on_hills(hills: Hills, T_world_rig: Array, vehicle: VehicleDimensions) -> Array:
    """Poses (..., 4, 4) of a vehicle that stands on hills with its axles, from its places and headings in the plane.

    The rig origin lies on the ground under the rear axle; the rig's x axis points to the ground under the front axle.
    """
    rear, ahead, left = (T_world_rig[..., :3, column] * [1.0, 1.0, 0.0] for column in (3, 0, 1))
    base = _lift(hills, rear)
    forward = _lift(hills, rear + vehicle.wheelbase * ahead) - base
    half_track = 0.5 * vehicle.track_width * left
    across = _lift(hills, rear + half_track) - _lift(hills, rear - half_track)
    x = forward / np.linalg.norm(forward, axis=-1, keepdims=True)
    z = np.cross(x, across)
    z /= np.linalg.norm(z, axis=-1, keepdims=True)
    return make_pose(np.stack([x, np.cross(z, x), z], axis=-1), base)


def stand_up(agent: Agent, pose: Array, hills: Hills | None) -> Array:
    """The pose (4, 4) of an agent's box, from x, y, z of its centre and yaw (4,).

    On hills it leans with the ground under its ends and sides, about the ground below its centre; people stay upright.
    """
    x, y, z, yaw = pose.tolist()
    cos, sin = np.cos(yaw), np.sin(yaw)
    flat = np.array([[cos, -sin, 0.0, x], [sin, cos, 0.0, y], [0.0, 0.0, 1.0, z], [0.0, 0.0, 0.0, 1.0]])
    if hills is None or agent.label in _UPRIGHT:
        return flat
    ahead, left = flat[:3, 0], flat[:3, 1]
    rises = [
        (hills.height(pose[:2] + reach * side[:2]) - hills.height(pose[:2] - reach * side[:2])) / (2.0 * reach)
        for side, reach in ((ahead, agent.length / 2), (left, agent.width / 2))
    ]
    forward, across = (side + rise * flat[:3, 2] for side, rise in zip((ahead, left), rises, strict=True))
    forward /= np.linalg.norm(forward)
    up = np.cross(forward, across)
    up /= np.linalg.norm(up)
    ground = np.array([x, y, hills.height(pose[:2])])
    return make_pose(np.stack([forward, np.cross(up, forward), up], axis=-1), ground + (z - ground[2]) * up)


def _lift(hills: Hills, points: Array) -> Array:
    """Points (..., 3), raised by the height of the ground at their place."""
    raised = points.copy()
    raised[..., 2] += hills.height(points)
    return raised
