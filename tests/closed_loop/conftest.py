"""Small hand-made scenes, and rollouts in the JSON format made by hand or at random."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from olt_closed_loop.scenes.scene import Agent, Scene
from olt_generator.poses import planar_pose, transform
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

STEP_US = 100_000
LENGTH, WIDTH, AHEAD = 5.393, 2.109, 1.3965


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


def straight_road(y: float = 0.0, start: float = -60.0, end: float = 300.0) -> dict[str, Any]:
    """Two lanes of 3.7 m, the right one along x and the left one against it, between two edges."""
    x = np.arange(start, end, 2.0)

    def line(offset: float, backwards: bool = False) -> list[list[float]]:
        points = [[float(value), y + offset] for value in x]
        return points[::-1] if backwards else points

    return {
        "lanes": [
            {"id": "with", "center": line(0.0), "left": line(1.85), "right": line(-1.85)},
            {"id": "against", "center": line(3.7, True), "left": line(1.85, True), "right": line(5.55, True)},
        ],
        "road_edges": [line(-2.45), line(6.15)],
    }


def rollout_text(poses: np.ndarray, recorded: np.ndarray | None = None, **changes: Any) -> dict[str, Any]:
    """A drive along rig poses (n, 3) every 0.1 s, handed over at 1.7 s, on the straight road."""
    recorded = poses if recorded is None else recorded
    return {
        "timestamps_us": [STEP_US * index for index in range(len(poses))],
        "render_start_us": 0,
        "force_gt_duration_us": 1_700_000,
        "ego": {
            "length": LENGTH,
            "width": WIDTH,
            "height": 1.503,
            "rear_axle_to_center": AHEAD,
            "poses": poses.tolist(),
        },
        "agents": {},
        "gt": {
            "timestamps_us": [STEP_US * index for index in range(len(recorded))],
            "poses": recorded.tolist(),
        },
        "map": straight_road(),
        "plans": [],
    } | changes


def along_x(speed: float = 10.0, count: int = 81, y: float = 0.0) -> np.ndarray:
    """Poses (count, 3) at constant speed."""
    poses = np.zeros((count, 3))
    poses[:, 0], poses[:, 1] = 0.1 * speed * np.arange(count), y
    return poses


def agent_text(poses: np.ndarray, start: int = 0, size: tuple[float, float, float] = (4.6, 1.9, 1.5)) -> dict[str, Any]:
    """An agent at box poses (n, 3 or 4) from sample `start` on."""
    return {
        "length": size[0],
        "width": size[1],
        "height": size[2],
        "timestamps_us": [STEP_US * (start + index) for index in range(len(poses))],
        "poses": poses.tolist(),
    }


def turned(values: dict[str, Any], yaw: float, x: float = 0.0, y: float = 0.0) -> dict[str, Any]:
    """The same rollout, turned about the origin and then shifted as a whole."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    rotation = np.array([[cos, sin], [-sin, cos]])

    def move(rows: list[list[float]], has_yaw: bool) -> list[list[float]]:
        moved = np.array(rows, dtype=np.float64).reshape(len(rows), -1 if rows else 3)
        moved[:, :2] = moved[:, :2] @ rotation + [x, y]
        if has_yaw:
            moved[:, 2] = np.angle(np.exp(1j * (moved[:, 2] + yaw)))
        return moved.tolist()

    def move_poses(track: dict[str, Any]) -> dict[str, Any]:
        return track | {"poses": move(track["poses"], True)}

    road = values["map"] and {
        "lanes": [
            {key: line if key == "id" else move(line, False) for key, line in lane.items()}
            for lane in values["map"]["lanes"]
        ],
        "road_edges": [move(edge, False) for edge in values["map"]["road_edges"]],
    }
    return with_tracks(values, move_poses, road)


def with_tracks(values: dict[str, Any], move: Callable[[dict[str, Any]], dict[str, Any]], road: Any) -> dict[str, Any]:
    """A rollout whose ego, recording, agents and plans are moved, on a road."""
    return values | {
        "ego": move(values["ego"]),
        "gt": move(values["gt"]),
        "agents": {name: move(agent) for name, agent in values["agents"].items()},
        "map": road,
        "plans": [move(plan) for plan in values["plans"]],
    }


def mirrored(values: dict[str, Any]) -> dict[str, Any]:
    """The same rollout in a mirror along the x axis: left is right, and traffic keeps to the other side."""

    def mirror(rows: list[list[float]]) -> list[list[float]]:
        """Points x, y, z or poses x, y, yaw, z: what is no pose has z = 0 here."""
        return (np.array(rows, dtype=np.float64) * [1.0, -1.0, -1.0, 1.0][: len(rows[0])]).tolist() if rows else []

    def mirror_poses(track: dict[str, Any]) -> dict[str, Any]:
        samples = {"samples": [mirror(rows) for rows in track["samples"]]} if "samples" in track else {}
        return track | {"poses": mirror(track["poses"])} | samples

    sides = {"left": "right", "right": "left", "center": "center"}
    road = values["map"] and values["map"] | {
        "lanes": [
            {key: value for key, value in lane.items() if key not in sides}
            | {sides[key]: mirror(lane[key]) for key in sides if lane.get(key)}
            for lane in values["map"]["lanes"]
        ],
        "road_edges": [mirror(edge) for edge in values["map"]["road_edges"]],
    }
    return with_tracks(values, mirror_poses, road)


def halved(values: dict[str, Any]) -> dict[str, Any]:
    """The same rollout, sampled twice as often: its boxes are in the same places at all times."""

    def halve(times: list[int], poses: list[list[float]]) -> dict[str, Any]:
        if len(times) < 2:
            return {"timestamps_us": times, "poses": poses}
        rows = np.array(poses, dtype=np.float64)
        rows[:, 2] = np.unwrap(rows[:, 2])
        finer = np.union1d(times, np.array(times[:-1]) + STEP_US // 2)
        at_finer = np.stack([np.interp(finer, times, column) for column in rows.T], axis=-1)
        return {"timestamps_us": finer.tolist(), "poses": at_finer.tolist()}

    ego = halve(values["timestamps_us"], values["ego"]["poses"])
    agents = {name: agent | halve(agent["timestamps_us"], agent["poses"]) for name, agent in values["agents"].items()}
    return values | {
        "timestamps_us": ego["timestamps_us"],
        "ego": values["ego"] | {"poses": ego["poses"]},
        "agents": agents,
    }


def random_rollout(seed: int) -> dict[str, Any]:
    """A drive with a wandering ego, agents that come late and go early, and perhaps a map and plans."""
    generator = np.random.default_rng(seed)
    count = int(generator.integers(25, 60))
    ego = _wander(generator, count, np.zeros(3), 10.0)
    agents = {}
    for index in range(int(generator.integers(0, 8))):
        first = int(generator.integers(0, count))
        samples = int(generator.integers(0, count - first + 1))
        place = np.array([generator.uniform(-10, 60), generator.uniform(-8, 8), generator.uniform(-np.pi, np.pi)])
        poses = _wander(generator, samples, place, generator.uniform(0, 15))
        if generator.random() < 0.3:
            poses = np.column_stack([poses, np.full(len(poses), generator.uniform(0.5, 6.0))])
        agents[f"agent {index}"] = agent_text(poses, first)
    recorded = _wander(generator, count + int(generator.integers(0, 20)), np.zeros(3), 10.0)
    plans = [_plan(generator, 4 * index, ego[4 * index]) for index in range(int(generator.integers(0, 4)))]
    road = straight_road() | {"resample_m": float(generator.choice([0.0, 0.7, 2.0]))}
    return rollout_text(
        ego,
        recorded,
        agents=agents,
        plans=plans,
        map=None if generator.random() < 0.3 else road,
        force_gt_duration_us=500_000,
    )


def _wander(generator: np.random.Generator, count: int, start: np.ndarray, speed: float) -> np.ndarray:
    yaw = start[2] + np.cumsum(generator.uniform(-0.05, 0.05, count))
    steps = 0.1 * speed * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    return np.column_stack([start[:2] + np.cumsum(steps, axis=0), np.angle(np.exp(1j * yaw))]).reshape(count, 3)


def _plan(generator: np.random.Generator, index: int, pose: np.ndarray) -> dict[str, Any]:
    poses = np.vstack([pose, _wander(generator, int(generator.integers(20, 64)), pose, 10.0)])
    times = [STEP_US * (index + step) for step in range(len(poses))]
    samples = [
        np.add(poses, [0.0, offset, 0.0]).tolist() for offset in generator.uniform(-1, 1, int(generator.integers(0, 3)))
    ]
    return {"now_us": times[0], "timestamps_us": times, "poses": poses.tolist(), "samples": samples}


@pytest.fixture(scope="session")
def texts() -> SimpleNamespace:
    """Builders of rollouts in the JSON format."""
    return SimpleNamespace(
        road=straight_road,
        rollout=rollout_text,
        along_x=along_x,
        agent=agent_text,
        turned=turned,
        mirrored=mirrored,
        halved=halved,
        random=random_rollout,
    )
