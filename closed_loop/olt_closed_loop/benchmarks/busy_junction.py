"""A busy junction that benchmarks film and drive through: two roads of four lanes, and road users of all kinds."""

import numpy as np
import shapely

from olt_closed_loop.scenes.actors import SIZES
from olt_closed_loop.scenes.scene import Agent, Lane, Scene
from olt_generator.poses import Array, planar_pose
from olt_generator.seeds import make_generator
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig_files import pav_rig

ARM, LANE_WIDTH = 120.0, 3.5
_HALF_ROAD = 2.0 * LANE_WIDTH
_EGO_SPEED, _EGO_OFFSET = 9.0, -0.5 * LANE_WIDTH
_KINDS = (*["automobile"] * 11, "heavy_truck", "other_vehicle", *["person"] * 4, *["rider"] * 2, "cone")
_SAMPLE_US = 100_000


def busy_junction(agents: int = 60, duration_us: int = 20_000_000, seed: int = 0) -> Scene:
    """Roads along x and y that cross at the origin, with `agents` road users; the ego drives along x, through it.

    Vehicles queue and pass in the lanes of the other arms, and people and cyclists move along the kerbs.
    """
    ego = _drive_straight(-0.7 * ARM, _EGO_OFFSET, duration_us)
    arms = [shapely.box(-ARM, -_HALF_ROAD, ARM, _HALF_ROAD), shapely.box(-_HALF_ROAD, -ARM, _HALF_ROAD, ARM)]
    outline = _at_ground(shapely.get_coordinates(shapely.orient_polygons(shapely.union_all(arms))))
    return Scene(
        name=f"busy_junction_{agents}_{seed}",
        category="nominal",
        factors=(),
        vehicle=pav_rig().vehicle,
        ego=ego,
        agents=tuple(_road_user(index, duration_us, seed) for index in range(agents)),
        lanes=tuple(_lanes(0.0) + _lanes(0.5 * np.pi)),
        road_edges=(outline,),
        drivable=(outline[:-1],),
        route=_at_ground(np.array([[-ARM, _EGO_OFFSET], [ARM, _EGO_OFFSET]])),
    )


def _drive_straight(x: float, y: float, duration_us: int) -> Trajectory:
    times = np.arange(0, duration_us + 1, _SAMPLE_US, dtype=np.int64)
    # It slows down to walking speed before the end of the road.
    way = np.minimum(_EGO_SPEED * times * 1e-6, 0.75 * _EGO_SPEED * 20.0 + 0.25 * _EGO_SPEED * times * 1e-6)
    return Trajectory(times, planar_pose(x + way, np.full(len(times), y), np.zeros(len(times))))


def _lanes(heading: float) -> list[Lane]:
    lanes = []
    for offset in LANE_WIDTH * np.array([-1.5, -0.5, 0.5, 1.5]):
        sign = 1.0 if offset < 0.0 else -1.0
        center, left, right = (
            _turned(np.array([[-sign * ARM, d], [sign * ARM, d]]), heading)
            for d in (offset, offset + 0.5 * sign * LANE_WIDTH, offset - 0.5 * sign * LANE_WIDTH)
        )
        lanes.append(Lane(f"lane_{heading:.1f}_{offset:.2f}", center, left, right))
    return lanes


def _road_user(index: int, duration_us: int, seed: int) -> Agent:
    generator = make_generator("busy junction", seed, index)
    label = _KINDS[index % len(_KINDS)]
    length, width, height = SIZES[label]
    on_foot = label in ("person", "rider", "cone")
    side = float(generator.choice([-1.0, 1.0]))
    lane = generator.choice([1.5, 0.5])
    # Off the ego's own lane and way: on its road only the other direction and the kerbs.
    crossing = bool(generator.random() < 0.6)
    side = side if crossing or on_foot else 1.0
    offset = side * (_HALF_ROAD + generator.uniform(1.0, 3.0)) if on_foot else side * lane * LANE_WIDTH
    start = generator.uniform(_HALF_ROAD + 4.0, ARM) * float(generator.choice([-1.0, 1.0]))
    heading = 0.0 if offset < 0.0 else np.pi
    pace = {"person": 1.2, "rider": 3.0}.get(label, 0.0) if generator.random() < 0.7 else 0.0
    times = np.array([0, duration_us], dtype=np.int64)
    along = start + pace * np.cos(heading) * times * 1e-6
    along = np.clip(along, *((_HALF_ROAD + 3.5, ARM) if start > 0.0 else (-ARM, -_HALF_ROAD - 3.5)))
    turn = 0.5 * np.pi if crossing else 0.0
    places = _turned(np.column_stack([along, np.full(2, offset)]), turn)
    poses = np.column_stack([places[:, :2], np.full(2, height / 2), np.full(2, heading + turn)])
    return Agent(f"{label}_{index}", label, length, width, height, times, poses)


def _turned(points: Array, heading: float) -> Array:
    cos, sin = np.cos(heading), np.sin(heading)
    return _at_ground(
        np.column_stack([cos * points[:, 0] - sin * points[:, 1], sin * points[:, 0] + cos * points[:, 1]])
    )


def _at_ground(points: Array) -> Array:
    return np.column_stack([points, np.zeros(len(points))])
