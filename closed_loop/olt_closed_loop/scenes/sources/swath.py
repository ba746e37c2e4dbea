"""Where the recorded ego drove, as a drivable area: nobody doubts that, whatever the map says.

Without room about its box nobody but a replay can drive there, which the gate finds. Room is an assumption of whoever
gives it, so the scene says it.
"""

from dataclasses import replace

import numpy as np
import shapely

from olt_closed_loop.scenes.actors import footprints
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.scenes.sources.roads import edges, outlines
from olt_generator.errors import InputError
from olt_generator.poses import yaw_of
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig import VehicleDimensions

MOST_ROOM = 2.0
"""Metres; with more, the car's way is wider than any lane."""


def ego_swath(
    ego: Trajectory, vehicle: VehicleDimensions, areas: list[shapely.Polygon], room: float = 0.0
) -> tuple[list[shapely.Polygon], int]:
    """What the ego's box, with `room` metres about it, swept between successive poses where it leaves the areas.

    Returns:
        Polygons, and how many poses leave the areas.
    """
    yaw, ahead = yaw_of(ego.T_world_rig), vehicle.rear_axle_to_bbox_center
    x, y = ego.positions[:, 0] + ahead * np.cos(yaw), ego.positions[:, 1] + ahead * np.sin(yaw)
    poses = np.column_stack([x, y, np.zeros_like(x), yaw])
    boxes = footprints(poses, vehicle.length + 2.0 * room, vehicle.width + 2.0 * room)
    union = shapely.union_all([shapely.make_valid(area) for area in areas])
    shapely.prepare(union)
    beyond = ~shapely.covers(union, boxes)
    touched = beyond[:-1] | beyond[1:]
    pairs = shapely.union(boxes[:-1][touched], boxes[1:][touched])
    return list(shapely.convex_hull(pairs)), int(beyond.sum())


def add_room(scene: Scene, room: float) -> Scene:
    """The scene with `room` metres drivable about the recorded ego's box wherever it drove.

    Raises:
        InputError: the room is none or too much, or the scene has no drivable area.
    """
    if not 0.0 < room <= MOST_ROOM:
        raise InputError(f"room of {room:g} m: give more than 0 and at most {MOST_ROOM:g} m")
    if not scene.drivable:
        raise InputError(f"scene {scene.name}: has no drivable area, so that there is nothing to make room in")
    areas = [shapely.Polygon(outline[:, :2]) for outline in scene.drivable]
    swath, beyond = ego_swath(scene.ego, scene.vehicle, areas, room)
    if not swath:
        return scene
    told = f"{room:g} m about the recorded ego are drivable, of which {beyond} of its {len(scene.ego)} poses had less"
    return replace(
        scene,
        drivable=(*scene.drivable, *outlines(swath)),
        road_edges=edges([*areas, *swath]),
        assumptions=(*scene.assumptions, told),
    )
