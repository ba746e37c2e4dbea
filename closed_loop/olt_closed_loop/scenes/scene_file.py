"""Scene files: a scene as an OpenUSD stage.

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
    Reader,
    Stage,
    new_stage,
    save_stage,
    write_box,
    write_curve,
    write_group,
    write_payload,
    write_trajectory,
    write_upright_motion,
    write_values,
)
from olt_generator.poses import Array
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig import VehicleDimensions

_COLORS = ("zenith", "horizon", "grass", "gravel", "asphalt", "paint")


def write_scene(scene: Scene, path: Path) -> Path:
    """Write a scene to `path` (.usda or .usdc) and its looks to `<stem>.looks` beside it; returns `path`."""
    looks = generate_looks(scene) if scene.looks is None else read_looks(Path(scene.looks))
    looks_path = path.with_name(f"{path.stem}.looks{path.suffix}")
    stage, vehicle = new_stage("/World"), scene.vehicle
    write_values(
        stage.GetPrimAtPath("/World"),
        name=scene.name,
        category=scene.category,
        factors=scene.factors,
        assumptions=scene.assumptions,
    )
    _write_road(stage, scene)
    ego = write_trajectory(stage, "/World/Ego", scene.ego.timestamps_us, scene.ego.T_world_rig)
    write_values(ego, **{name: float(value) for name, value in asdict(vehicle).items()})
    center = (vehicle.rear_axle_to_bbox_center, 0.0, vehicle.height / 2)
    write_box(stage, "/World/Ego/Box", (vehicle.length, vehicle.width, vehicle.height), center)
    write_group(stage, "/World/Agents")
    for index, agent in enumerate(scene.agents):
        # The prim's name is only a number, because ids of recorded data need not be valid prim names.
        place = f"/World/Agents/agent_{index:03d}"
        prim = write_upright_motion(stage, place, agent.timestamps_us, agent.poses)
        size = (float(agent.length), float(agent.width), float(agent.height))
        write_values(prim, id=agent.id, label=agent.label, length=size[0], width=size[1], height=size[2])
        write_box(stage, f"{place}/Box", size, (0.0, 0.0, 0.0))
    write_payload(stage, "/World/Looks", looks_path.name)
    _write_looks(looks, looks_path)
    save_stage(stage, path)
    return path


def _write_road(stage: Stage, scene: Scene) -> None:
    for place in ("/World/Road", "/World/Road/Lanes", "/World/Road/Edges", "/World/Road/Drivable"):
        write_group(stage, place)
    for index, lane in enumerate(scene.lanes):
        prim = write_curve(stage, f"/World/Road/Lanes/lane_{index:03d}", lane.center)
        write_values(prim, id=lane.id, center=lane.center, left=lane.left, right=lane.right, successors=lane.successors)
    lines = [(f"Edges/edge_{index:03d}", edge) for index, edge in enumerate(scene.road_edges)]
    lines += [(f"Drivable/outline_{index:03d}", outline) for index, outline in enumerate(scene.drivable)]
    for place, points in [*lines, ("Route", scene.route)]:
        write_values(write_curve(stage, f"/World/Road/{place}", points), points=points)


def _write_looks(looks: Looks, path: Path) -> None:
    def rows(triples: Iterable[tuple[float, float, float]]) -> Array:
        return np.array(list(triples), dtype=np.float64).reshape(-1, 3)

    stage = new_stage("/Looks")
    write_values(
        stage.GetPrimAtPath("/Looks"),
        texture_seed=looks.texture_seed,
        cloudiness=looks.cloudiness,
        sun_direction=np.array(looks.sun_direction),
        colors=rows(getattr(looks, name) for name in _COLORS),
        agent_ids=tuple(looks.agent_colors),
        agent_colors=rows(looks.agent_colors.values()),
        scenery_kind=tuple(box.kind for box in looks.scenery),
        scenery_yaw=np.array([box.yaw for box in looks.scenery]),
        scenery_center=rows(box.center for box in looks.scenery),
        scenery_size=rows(box.size for box in looks.scenery),
        scenery_color=rows(box.color for box in looks.scenery),
    )
    save_stage(stage, path)


def read_scene(path: Path) -> Scene:
    """Read a scene without its looks.

    Raises:
        InputError: the file is not a scene file, or lacks a prim or attribute.
    """
    reader = Reader(path)
    world, ego = reader.prim("/World"), reader.prim("/World/Ego")
    name, category = reader.values(world, "name", "category")
    sizes = [field.name for field in fields(VehicleDimensions)]
    agents = []
    for prim in reader.children("/World/Agents"):
        times_us, poses = reader.upright_motion(prim)
        described = reader.values(prim, "id", "label", "length", "width", "height")
        agents.append(Agent(*described, timestamps_us=times_us, poses=poses))
    lanes = [
        Lane(
            *reader.values(prim, "id"),
            *reader.arrays(prim, "center", "left", "right"),
            successors=reader.texts(prim, "successors"),
        )
        for prim in reader.children("/World/Road/Lanes")
    ]
    edges, outlines = (
        tuple(reader.arrays(prim, "points")[0] for prim in reader.children(f"/World/Road/{place}"))
        for place in ("Edges", "Drivable")
    )
    return Scene(
        name=name,
        category=category,
        factors=reader.texts(world, "factors"),
        vehicle=VehicleDimensions(**dict(zip(sizes, reader.values(ego, *sizes), strict=True))),
        ego=Trajectory(*reader.trajectory(ego)),
        agents=tuple(agents),
        lanes=tuple(lanes),
        road_edges=edges,
        drivable=outlines,
        route=reader.arrays(reader.prim("/World/Road/Route"), "points")[0],
        looks=str(path),
        assumptions=reader.texts(world, "assumptions"),
    )


def read_looks(path: Path) -> Looks:
    """Read the looks of the scene at `path` by loading the payload of its scene file.

    Raises:
        InputError: the file is not a scene file, or the payload is missing or lacks an attribute.
    """
    reader = Reader(path, with_payloads=True)
    prim = reader.prim("/World/Looks")

    def triples(*names: str) -> list[list[tuple[float, float, float]]]:
        return [[(x, y, z) for x, y, z in rows.tolist()] for rows in reader.arrays(prim, *names)]

    ((sun_x, sun_y, sun_z),) = (rows.tolist() for rows in reader.arrays(prim, "sun_direction"))
    texture_seed, cloudiness = reader.values(prim, "texture_seed", "cloudiness")
    colors, agent_colors = triples("colors", "agent_colors")
    kinds, (yaws,) = reader.texts(prim, "scenery_kind"), reader.arrays(prim, "scenery_yaw")
    centers, sizes, box_colors = triples("scenery_center", "scenery_size", "scenery_color")
    boxes = zip(kinds, centers, sizes, yaws.tolist(), box_colors, strict=True)
    return Looks(
        texture_seed=int(texture_seed),
        sun_direction=(sun_x, sun_y, sun_z),
        cloudiness=float(cloudiness),
        agent_colors=dict(zip(reader.texts(prim, "agent_ids"), agent_colors, strict=True)),
        scenery=tuple(SceneryBox(*box) for box in boxes),
        **dict(zip(_COLORS, colors, strict=True)),
    )
