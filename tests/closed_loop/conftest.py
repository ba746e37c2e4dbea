"""Small hand-made scenes for the tests of the closed loop."""

from collections.abc import Callable

import numpy as np
import pytest

from olt_closed_loop.scenes.scene import Agent, Scene
from olt_generator.poses import planar_pose, transform
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE


def _straight_scene(
    agents: tuple[Agent, ...] = (),
    *,
    speed: float = 10.0,
    duration: float = 8.0,
    category: str = "nominal",
    with_road: bool = True,
) -> Scene:
    """An ego that drives along x at constant speed on a 13 m wide road, sampled at 10 Hz."""
    times = np.arange(round(duration * 10) + 1, dtype=np.int64) * 100_000
    x = speed * times * 1e-6
    end = speed * duration + 130.0
    road = np.array([[-40.0, -5.0, 0.0], [end, -5.0, 0.0], [end, 8.0, 0.0], [-40.0, 8.0, 0.0]])
    along = np.linspace(-10.0, end, 200)
    return Scene(
        name="straight",
        category=category,
        factors=(),
        vehicle=DEFAULT_VEHICLE,
        ego=Trajectory(times, planar_pose(x, 0.0, 0.0)),
        agents=agents,
        lanes=(),
        road_edges=(),
        drivable=(road,) if with_road else (),
        route=np.stack([along, np.zeros_like(along), np.zeros_like(along)], axis=-1),
    )


def _moving_agent(
    name: str,
    position: tuple[float, float],
    velocity: tuple[float, float] = (0.0, 0.0),
    yaw: float = 0.0,
    size: tuple[float, float, float] = (4.5, 1.9, 1.6),
    bottom: float = 0.0,
    duration: float = 8.0,
) -> Agent:
    """An agent that is at `position` at time 0 and moves at constant velocity."""
    times = np.arange(round(duration * 10) + 1, dtype=np.int64) * 100_000
    seconds = times * 1e-6
    columns = [position[0] + velocity[0] * seconds, position[1] + velocity[1] * seconds]
    height = np.full_like(seconds, bottom + 0.5 * size[2])
    return Agent(name, "automobile", *size, times, np.stack([*columns, height, np.full_like(seconds, yaw)], axis=-1))


def _moved_scene(scene: Scene, x: float, y: float, yaw: float) -> Scene:
    """The whole scene turned by `yaw` about the origin and then shifted."""
    motion = planar_pose(x, y, yaw)
    agents = tuple(
        Agent(
            agent.id,
            agent.label,
            agent.length,
            agent.width,
            agent.height,
            agent.timestamps_us,
            np.column_stack([transform(motion, agent.poses[:, :3]), agent.poses[:, 3] + yaw]),
        )
        for agent in scene.agents
    )
    return Scene(
        name=scene.name,
        category=scene.category,
        factors=scene.factors,
        vehicle=scene.vehicle,
        ego=Trajectory(scene.ego.timestamps_us, motion @ scene.ego.T_world_rig),
        agents=agents,
        lanes=(),
        road_edges=(),
        drivable=tuple(transform(motion, outline) for outline in scene.drivable),
        route=transform(motion, scene.route),
    )


@pytest.fixture(scope="session")
def straight_scene() -> Callable[..., Scene]:
    """Builder of a straight scene."""
    return _straight_scene


@pytest.fixture(scope="session")
def moving_agent() -> Callable[..., Agent]:
    """Builder of an agent at constant velocity."""
    return _moving_agent


@pytest.fixture(scope="session")
def moved_scene() -> Callable[..., Scene]:
    """Rigid motion of a scene."""
    return _moved_scene
