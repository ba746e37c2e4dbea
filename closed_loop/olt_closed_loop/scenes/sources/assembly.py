"""A scene of what a reader found: moved to the ego's start, cut to its drive, with a road as far as one is known."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely

from olt_closed_loop.scenes.maps.lanes import Crossing, Lane, Light, StopLine
from olt_closed_loop.scenes.polylines import arc_lengths, length_of
from olt_closed_loop.scenes.scene import Agent, Scene
from olt_closed_loop.scenes.sources.roads import NO_ROAD, edges, outlines, route_along
from olt_closed_loop.scenes.sources.swath import ego_swath
from olt_closed_loop.scenes.sources.tracks import (
    FARTHEST_FROM_EGO,
    Track,
    agents_of,
    check_motion,
    check_times,
    listed,
    word_away,
)
from olt_generator.errors import InputError
from olt_generator.omissions import Omission, word_omission
from olt_generator.poses import Array, yaw_of
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig import VehicleDimensions

JAGUAR_I_PACE = VehicleDimensions(
    length=4.682, width=1.895, height=1.566, rear_axle_to_bbox_center=1.50, wheelbase=2.990, track_width=1.65
)
"""What most of Waymo's cars are, from its data sheet, without mirrors; the place of the box over the axle is an
estimate."""


@dataclass(frozen=True)
class RecordedDrive:
    """What a recording holds, in its own frame (metres, z up) and with time 0 at the ego's first pose.

    Attributes:
        name: of the scene.
        vehicle: the ego's size.
        ego: its motion T_world_rig.
        agents: all others, each with all its samples; gaps are allowed (`tracks.agents_of`).
        lanes: all lanes.
        areas: what is known to be drivable; () if nothing is.
        assumptions: what was assumed, a sentence each.
        category: of the scene.
        stop_lines, crossings, lights: what regulates traffic; times of lights are those of the ego.
    """

    name: str
    vehicle: VehicleDimensions
    ego: Trajectory
    agents: Sequence[Track]
    lanes: Sequence[Lane]
    areas: Sequence[shapely.Polygon]
    assumptions: tuple[str, ...]
    category: str = "recorded"
    stop_lines: tuple[StopLine, ...] = ()
    crossings: tuple[Crossing, ...] = ()
    lights: tuple[Light, ...] = ()


def assemble_scene(drive: RecordedDrive) -> Scene:
    """The scene of a drive, which begins at the origin.

    Where the ego left the drivable area, the way of its box is drivable too, and the scene says so.

    Raises:
        InputError: the ego does not move as a car does, an agent is not finite, or the map is far from the drive.
    """
    check_times(drive.ego.timestamps_us, "the ego")
    origin = drive.ego.positions[0].copy()
    T_world_rig = drive.ego.T_world_rig.copy()
    T_world_rig[:, :3, 3] -= origin
    ego = Trajectory(drive.ego.timestamps_us, T_world_rig)
    check_motion(ego, "the ego")
    names = {lane.id for lane in drive.lanes}
    lanes = [_within(_moved(lane, origin), names) for lane in drive.lanes]
    areas = [shapely.transform(area, lambda points: points - origin[:2]) for area in drive.areas]
    agents, notes = _agents(drive.agents, origin, int(ego.timestamps_us[-1]))
    swath, beyond = ego_swath(ego, drive.vehicle, areas) if areas else ([], 0)
    if beyond:
        notes.append(
            f"where the recorded ego drove is drivable: {beyond} of its {len(ego)} poses reach beyond the map's area"
        )
    return Scene(
        name=drive.name[:240],
        category=drive.category,
        factors=(),
        vehicle=drive.vehicle,
        ego=ego,
        agents=tuple(agents),
        lanes=tuple(lanes),
        road_edges=edges([*areas, *swath]),
        drivable=outlines([*areas, *swath]),
        route=route_along(ego.positions, float(yaw_of(ego.T_world_rig[-1])), [lane for lane in lanes if lane.for_cars]),
        assumptions=(*drive.assumptions, *notes, *([] if areas else [NO_ROAD])),
        stop_lines=tuple(replace(line, points=line.points - origin) for line in drive.stop_lines),
        crossings=tuple(replace(one, outline=one.outline - origin) for one in drive.crossings),
        lights=tuple(
            replace(light, position=light.position - origin) if light.position is not None else light
            for light in drive.lights
        ),
    )


def lane_area(left: Array, right: Array) -> shapely.Polygon:
    """The area (of valid shape) between the borders (n, 2 or 3) and (m, 2 or 3) of a lane."""
    return shapely.Polygon(np.concatenate([left[:, :2], right[::-1, :2]]))


def scaled_car(length: float, width: float) -> tuple[VehicleDimensions, str]:
    """A car of which only length and width are known, in a car's usual proportions; and a sentence that says so."""
    car = VehicleDimensions(
        length=length,
        width=width,
        height=1.5,
        rear_axle_to_bbox_center=0.29 * length,
        wheelbase=0.6 * length,
        track_width=0.85 * width,
    )
    return car, (
        f"ego box: {length:g} x {width:g} m as recorded; height 1.5 m, wheelbase ({car.wheelbase:.2f} m) and the "
        f"axle {car.rear_axle_to_bbox_center:.2f} m behind its middle are a car's usual proportions"
    )


def behind(positions: Array, yaw: Array, distance: float) -> Array:
    """Positions (n, 2) `distance` metres behind others (n, 2) with headings (n,)."""
    return positions - distance * np.column_stack([np.cos(yaw), np.sin(yaw)])


def heading_along(path: Array) -> Array:
    """Headings (n,) of a path (n, 2) in radians; where it stands still, that of the way before, else after."""
    ways = np.diff(path, axis=0)
    moving = np.linalg.norm(ways, axis=1) > 1e-6
    if not moving.any():
        return np.zeros(len(path))
    known = np.flatnonzero(moving)
    nearest = known[np.clip(np.searchsorted(known, np.arange(len(path)), side="right") - 1, 0, None)]
    return np.arctan2(ways[nearest, 1], ways[nearest, 0])


def usable_line(line: Array) -> bool:
    """Whether a polyline (n, 2 or 3) has a length."""
    return len(line) >= 2 and length_of(line) > 0.1 and bool(np.isfinite(arc_lengths(line)[-1]))


def _within(lane: Lane, names: set[str]) -> Lane:
    """The lane without links to lanes that the map does not hold, as where it was cut."""

    def known(links: tuple[str, ...] | None) -> tuple[str, ...] | None:
        return None if links is None else tuple(name for name in links if name in names)

    return replace(
        lane,
        successors=known(lane.successors) or (),
        left_neighbours=known(lane.left_neighbours),
        right_neighbours=known(lane.right_neighbours),
    )


def _moved(lane: Lane, origin: Array) -> Lane:
    center, left, right = (line - origin for line in (lane.center, lane.left, lane.right))
    if np.abs(center[:, :2]).max() > FARTHEST_FROM_EGO:
        raise InputError(
            f"lane {lane.id:.80} is more than {FARTHEST_FROM_EGO * 1e-3:g} km from the ego; not the map of this drive"
        )
    return replace(lane, center=center, left=left, right=right)


def _agents(tracks: Sequence[Track], origin: Array, end_us: int) -> tuple[list[Agent], list[str]]:
    """The agents without gaps while the ego drives, from the origin, and what is to be said of them."""
    agents: list[Agent] = []
    apart, away = [], []
    for track in tracks:
        poses = track.poses - np.array([*origin, 0.0])
        parts = list(agents_of(replace(track, poses=poses), end_us, f"agent {track.id:.80}"))
        if len(parts) > 1:
            apart.append(track.id)
        if not parts:
            away.append(track.id)
        agents += parts
    notes = [word_away(apart)] if apart else []
    if away:
        left_out = Omission(f"agents ({listed(away)})", "there at no time of the drive", len(away), len(tracks))
        notes.append(word_omission(left_out))
    return agents, notes
