"""A scene at a crossroads with everything that a map may hold."""

from dataclasses import replace

import numpy as np

from olt_closed_loop.scenes.maps.arms import Arm
from olt_closed_loop.scenes.maps.cross_sections import CrossSection
from olt_closed_loop.scenes.maps.junctions import junction
from olt_closed_loop.scenes.maps.lanes import Marking
from olt_closed_loop.scenes.maps.signals import SignalPlan, with_signals
from olt_closed_loop.scenes.polylines import points_along
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.scenes.scene_map import with_map
from olt_generator.poses import planar_pose
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

SECTION = CrossSection(cycle_width=1.5, sidewalk_width=2.0, wear=0.25, speed_limit=13.9)


def crossroads(left_hand=False):
    """Lights on two arms, yield and stop lines on the others, two crossings, and lanes of which less is known."""
    controls = ("light", "yield", "light", "stop")
    arms = [
        Arm(k * np.pi / 2.0, 1 + k % 2, 1, 40.0, SECTION, control=control, crossing=k < 2)
        for k, control in enumerate(controls)
    ]
    road_map = with_signals(junction(arms, left_hand=left_hand), SignalPlan(phases=((0, 2),)), end=20.0)
    first, second, *others = road_map.lanes
    unknown = replace(first, type=None, left_neighbours=None, yields_to=None, left_marking=None, speed_limit=None)
    half_known = replace(second, right_marking=Marking("solid"))
    painted = tuple(replace(place, zebra=zebra) for place, zebra in zip(road_map.crossings, (True, None), strict=True))
    return replace(road_map, lanes=(unknown, half_known, *others), crossings=painted)


def crossroads_scene(seconds=4.0, steps=41):
    """The ego comes from the west and drives straight on, 10 m/s."""
    road_map = crossroads()
    route = road_map.route_line(("arm2_in_0", "arm2_in_0>arm0_out_0", "arm0_out_0"))
    times = np.linspace(0.0, seconds, steps)
    x, y, _ = points_along(route, 5.0 + 10.0 * times).T
    empty = Scene(
        name="crossroads",
        category="nominal",
        factors=(),
        vehicle=DEFAULT_VEHICLE,
        ego=Trajectory(np.round(times * 1e6).astype(np.int64), planar_pose(x, y, 0.0)),
        agents=(),
        lanes=(),
        road_edges=(),
        drivable=(),
        route=route,
    )
    return with_map(empty, road_map)
