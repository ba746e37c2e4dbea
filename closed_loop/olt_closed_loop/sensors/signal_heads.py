"""Heads of traffic lights as boxes: pole, arm, housing, and a face whose lenses show the state of the moment.

Sizes are those of large real heads: three lenses of 0.3 m one above the other, and a backplate with a white rim.
"""

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from olt_closed_loop.scenes.maps.lanes import Light, LightState
from olt_closed_loop.scenes.scene import Hills, Scene
from olt_closed_loop.sensors.boxes import Boxes
from olt_closed_loop.sensors.surfaces import SIGNAL_SURFACES, SURFACE_INDEX
from olt_generator.poses import Array, planar_pose

HOUSING, BACKPLATE = (0.2, 0.36, 1.08), (0.04, 0.66, 1.38)
"""Depth, width and height in metres of the box that holds the lenses, and of the dark plate around them."""
_POLE, _ARM = 0.14, 0.1
_BEHIND, _BESIDE_ROAD = 0.25, 0.6
_GREY, _DARK = (110.0, 113.0, 115.0), (30.0, 30.0, 32.0)


class SignalHeads:
    """The heads of the lights of a scene whose lamps have a position; those without one are not drawn.

    A head looks against the traffic of the lanes that it rules, or to all four sides where the map has none of them.
    It stands on a pole below it, or where that is road hangs from an arm whose pole stands at the nearest edge.

    Attributes:
        standing: everything that never changes.
    """

    def __init__(self, scene: Scene) -> None:
        self._lights = [light for light in scene.lights if light.position is not None]
        places = np.array([light.position for light in self._lights]).reshape(-1, 3)
        facing = [_facing(light, scene) for light in self._lights]
        yaw = np.array([0.0 if one is None else one for one in facing])
        self._all_round = np.array([one is None for one in facing], dtype=bool)
        towards = np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(len(yaw))])
        housings = _boxes(places, HOUSING, yaw, _DARK)
        road = _road(scene) if self._lights else shapely.Polygon()
        mounts = [_mount(one, road, scene.hills) for one in places - _BEHIND * towards]
        self.standing = Boxes.concatenate([housings, *mounts])
        plate = np.where(self._all_round[:, None], (BACKPLATE[1], *BACKPLATE[1:]), BACKPLATE)
        self._faces = _boxes(places + 0.5 * HOUSING[0] * towards * ~self._all_round[:, None], plate, yaw, _DARK)

    def __len__(self) -> int:
        return len(self._lights)

    def at(self, time_us: int) -> Boxes:
        """The faces of the heads as they are at a time."""
        for index, light in enumerate(self._lights):
            shown = SURFACE_INDEX[SIGNAL_SURFACES[_shown(light.state_at(time_us))]]
            self._faces.surface[index, : 4 if self._all_round[index] else 1] = shown
        return self._faces


def _shown(state: LightState) -> LightState:
    """What the lenses show; a state that is not known lights none."""
    return "off" if state == "unknown" else state


def _facing(light: Light, scene: Scene) -> float | None:
    """The direction that a head looks, radians: against the mean heading at the start of its lanes."""
    ahead = [lane.center[1, :2] - lane.center[0, :2] for lane in scene.lanes if lane.id in light.lanes]
    if not ahead:
        return None
    x, y = np.mean([one / np.hypot(*one) for one in ahead], axis=0)
    return float(np.arctan2(-y, -x))


def _road(scene: Scene) -> BaseGeometry:
    return shapely.union_all([shapely.Polygon(outline[:, :2]).buffer(0.0) for outline in scene.drivable])


def _mount(top: Array, road: BaseGeometry, hills: Hills | None) -> Boxes:
    """The pole behind a head whose middle is at `top` (3,), and the arm to it where the pole stands aside."""
    foot = _foot(top, road)
    ground = 0.0 if hills is None else float(hills.height(foot))
    upper = top[2] + 0.5 * HOUSING[2]
    pole = _boxes(np.array([[*foot, 0.5 * (ground + upper)]]), (_POLE, _POLE, upper - ground), np.zeros(1), _GREY)
    along = foot - top[:2]
    reach = float(np.hypot(*along))
    if reach < _POLE:
        return pole
    middle = np.array([[*(top[:2] + 0.5 * along), top[2]]])
    arm = _boxes(middle, (reach, _ARM, _ARM), np.array([np.arctan2(along[1], along[0])]), _GREY)
    return Boxes.concatenate([pole, arm])


def _foot(top: Array, road: BaseGeometry) -> Array:
    """Where the pole of a head stands (2,): below it, or beside the road that is there."""
    place = shapely.Point(top[:2])
    if not road.covers(place):
        return top[:2]
    edge = shapely.get_coordinates(shapely.shortest_line(place, road.boundary))[1]
    away = edge - top[:2]
    return edge + _BESIDE_ROAD * away / max(float(np.hypot(*away)), 1e-9)


def _boxes(center: Array, size: Array | tuple[float, float, float], yaw: Array, color: tuple[float, ...]) -> Boxes:
    """Plain boxes at centres (n, 3) of one size (3,) or each of its own (n, 3), turned by yaw (n,)."""
    count = len(center)
    return Boxes(
        center=center,
        half=np.broadcast_to(0.5 * np.asarray(size), (count, 3)).copy(),
        axes=planar_pose(0.0, 0.0, yaw)[..., :3, :3],
        color=np.tile(np.array(color, dtype=np.float32), (count, 1)),
        surface=np.full((count, 6), SURFACE_INDEX["plain"], dtype=np.int32),
        repeats=np.ones((count, 3), dtype=np.float32),
        lit=np.ones(count, dtype=bool),
    )
