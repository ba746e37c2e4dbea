"""Scenes as OpenUSD stages.

    /World            name, category, factors, assumptions
    /World/Road       lanes, edges, drivable, route: polylines
    /World/Ego        recorded motion of the rig, size of the vehicle
    /World/Agents/*   label, size and recorded motion of each agent
    /World/Looks      payload: the file beside it that holds what only rendering needs

`read_scene` leaves the payload alone, so nothing of it is opened, parsed or kept unless a renderer asks.
"""

from collections.abc import Iterable
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np

from olt_closed_loop.scenes.looks import Looks, SceneryBox, generate_looks
from olt_closed_loop.scenes.scene import Agent, Lane, Scene
from olt_closed_loop.scenes.usd import (
    Prim,
    Reader,
    Stage,
    new_stage,
    save_stage,
    write_array,
    write_box,
    write_curve,
    write_group,
    write_payload,
    write_texts,
    write_trajectory,
    write_upright_motion,
    write_value,
)
from olt_generator.poses import Array
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig import VehicleDimensions

_COLORS = ("zenith", "horizon", "grass", "gravel", "asphalt", "paint")


def write_scene(scene: Scene, path: Path) -> Path:
    """Write a scene to `path` (.usda or .usdc) and its looks to `<stem>.looks` beside it; returns `path`."""
    looks = generate_looks(scene) if scene.looks is None else read_looks(Path(scene.looks))
    looks_path = path.with_name(f"{path.stem}.looks{path.suffix}")
    stage = new_stage("/World")
    world = stage.GetPrimAtPath("/World")
    write_value(world, "name", scene.name)
    write_value(world, "category", scene.category)
    write_texts(world, "factors", scene.factors)
    write_texts(world, "assumptions", scene.assumptions)
    _write_road(stage, scene)
    _write_ego(stage, scene)
    write_group(stage, "/World/Agents")
    for index, agent in enumerate(scene.agents):
        _write_agent(stage, f"/World/Agents/agent_{index:03d}", agent)
    write_payload(stage, "/World/Looks", looks_path.name)
    _write_looks(looks, looks_path)
    save_stage(stage, path)
    return path


def read_scene(path: Path) -> Scene:
    """Read a scene without its looks.

    Raises:
        InputError: the file is not a stage, or lacks a prim or attribute.
    """
    reader = Reader(path)
    world = reader.prim("/World")
    return Scene(
        name=reader.value(world, "name"),
        category=reader.value(world, "category"),
        factors=reader.texts(world, "factors"),
        vehicle=_read_vehicle(reader),
        ego=Trajectory(*reader.trajectory(reader.prim("/World/Ego"))),
        agents=tuple(_read_agent(reader, prim) for prim in reader.children("/World/Agents")),
        lanes=tuple(_read_lane(reader, prim) for prim in reader.children("/World/Road/Lanes")),
        road_edges=_read_lines(reader, "/World/Road/Edges"),
        drivable=_read_lines(reader, "/World/Road/Drivable"),
        route=reader.array(reader.prim("/World/Road/Route"), "points"),
        looks=str(path),
        assumptions=reader.texts(world, "assumptions"),
    )


def read_looks(path: Path) -> Looks:
    """Read the looks of the scene at `path` by loading the payload of its stage.

    Raises:
        InputError: the file is not a stage, or the payload is missing or lacks an attribute.
    """
    reader = Reader(path, with_payloads=True)
    prim = reader.prim("/World/Looks")
    sun_x, sun_y, sun_z = reader.array(prim, "sun_direction").tolist()
    agents = zip(reader.texts(prim, "agent_ids"), _read_triples(reader, prim, "agent_colors"), strict=True)
    return Looks(
        texture_seed=int(reader.value(prim, "texture_seed")),
        sun_direction=(sun_x, sun_y, sun_z),
        cloudiness=float(reader.value(prim, "cloudiness")),
        agent_colors=dict(agents),
        scenery=_read_scenery(reader, prim),
        **dict(zip(_COLORS, _read_triples(reader, prim, "colors"), strict=True)),
    )


def _write_road(stage: Stage, scene: Scene) -> None:
    for place in ("/World/Road", "/World/Road/Lanes", "/World/Road/Edges", "/World/Road/Drivable"):
        write_group(stage, place)
    for index, lane in enumerate(scene.lanes):
        prim = write_curve(stage, f"/World/Road/Lanes/lane_{index:03d}", lane.center)
        write_value(prim, "id", lane.id)
        for side in ("center", "left", "right"):
            write_array(prim, side, getattr(lane, side))
        write_texts(prim, "successors", lane.successors)
    lines = [(f"Edges/edge_{index:03d}", edge) for index, edge in enumerate(scene.road_edges)]
    lines += [(f"Drivable/outline_{index:03d}", outline) for index, outline in enumerate(scene.drivable)]
    for place, points in [*lines, ("Route", scene.route)]:
        write_array(write_curve(stage, f"/World/Road/{place}", points), "points", points)


def _write_ego(stage: Stage, scene: Scene) -> None:
    vehicle = scene.vehicle
    prim = write_trajectory(stage, "/World/Ego", scene.ego.timestamps_us, scene.ego.T_world_rig)
    for name, value in asdict(vehicle).items():
        write_value(prim, name, float(value))
    center = (vehicle.rear_axle_to_bbox_center, 0.0, vehicle.height / 2)
    write_box(stage, "/World/Ego/Box", (vehicle.length, vehicle.width, vehicle.height), center)


def _write_agent(stage: Stage, place: str, agent: Agent) -> None:
    """The prim's name is only a number, because ids of recorded data need not be valid prim names."""
    prim = write_upright_motion(stage, place, agent.timestamps_us, agent.poses)
    for name in ("id", "label"):
        write_value(prim, name, getattr(agent, name))
    for name in ("length", "width", "height"):
        write_value(prim, name, float(getattr(agent, name)))
    write_box(stage, f"{place}/Box", (agent.length, agent.width, agent.height), (0.0, 0.0, 0.0))


def _write_looks(looks: Looks, path: Path) -> None:
    stage = new_stage("/Looks")
    prim = stage.GetPrimAtPath("/Looks")
    write_value(prim, "texture_seed", looks.texture_seed)
    write_value(prim, "cloudiness", looks.cloudiness)
    write_array(prim, "sun_direction", np.array(looks.sun_direction))
    write_array(prim, "colors", np.array([getattr(looks, name) for name in _COLORS]))
    write_texts(prim, "agent_ids", tuple(looks.agent_colors))
    write_array(prim, "agent_colors", _rows(looks.agent_colors.values()))
    write_texts(prim, "scenery_kind", tuple(box.kind for box in looks.scenery))
    write_array(prim, "scenery_yaw", np.array([box.yaw for box in looks.scenery]))
    for name in ("center", "size", "color"):
        write_array(prim, f"scenery_{name}", _rows(getattr(box, name) for box in looks.scenery))
    save_stage(stage, path)


def _rows(triples: Iterable[tuple[float, float, float]]) -> Array:
    return np.array(list(triples), dtype=np.float64).reshape(-1, 3)


def _read_vehicle(reader: Reader) -> VehicleDimensions:
    ego = reader.prim("/World/Ego")
    sizes = {field.name: float(reader.value(ego, field.name)) for field in fields(VehicleDimensions)}
    return VehicleDimensions(**sizes)


def _read_agent(reader: Reader, prim: Prim) -> Agent:
    length, width, height = (float(reader.value(prim, name)) for name in ("length", "width", "height"))
    name, label = reader.value(prim, "id"), reader.value(prim, "label")
    return Agent(name, label, length, width, height, *reader.upright_motion(prim))


def _read_lane(reader: Reader, prim: Prim) -> Lane:
    center, left, right = (reader.array(prim, side) for side in ("center", "left", "right"))
    return Lane(reader.value(prim, "id"), center, left, right, reader.texts(prim, "successors"))


def _read_lines(reader: Reader, place: str) -> tuple[Array, ...]:
    return tuple(reader.array(prim, "points") for prim in reader.children(place))


def _read_scenery(reader: Reader, prim: Prim) -> tuple[SceneryBox, ...]:
    centers, sizes, colors = (_read_triples(reader, prim, f"scenery_{name}") for name in ("center", "size", "color"))
    kinds, yaws = reader.texts(prim, "scenery_kind"), reader.array(prim, "scenery_yaw").tolist()
    return tuple(SceneryBox(*box) for box in zip(kinds, centers, sizes, yaws, colors, strict=True))


def _read_triples(reader: Reader, prim: Prim, name: str) -> list[tuple[float, float, float]]:
    return [(x, y, z) for x, y, z in reader.array(prim, name).tolist()]
