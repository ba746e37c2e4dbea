"""What a scene looks like beyond its geometry: colours, sun, buildings, trees and poles. Only rendering needs it."""

from dataclasses import dataclass

import numpy as np
import shapely

from olt_closed_loop.scenes.actors import footprints
from olt_closed_loop.scenes.scene import Scene
from olt_generator.seeds import derive_seed, make_generator

Color = tuple[float, float, float]
"""Red, green, blue in 0 ... 255."""

# Where scenery may stand: distance from the drivable area, metres.
_NEAREST, _FARTHEST = 2.0, 50.0
_PROPOSALS = 450
_POLE_OFFSET, _POLE_SPACING = 0.8, 32.0

_AGENT_COLORS: dict[str, tuple[Color, ...]] = {
    "automobile": ((190, 30, 30), (40, 70, 140), (225, 225, 225), (60, 62, 66), (150, 152, 155), (30, 90, 60)),
    "heavy_truck": ((215, 215, 210), (200, 120, 30), (70, 100, 160)),
    "bus": ((200, 60, 50), (235, 190, 40), (60, 110, 170)),
    "trailer": ((200, 200, 198), (120, 126, 132)),
    "train_or_tram_car": ((190, 40, 45), (40, 110, 160)),
    "other_vehicle": ((40, 130, 50), (190, 40, 30), (40, 80, 160)),
    "rider": ((230, 60, 40), (40, 110, 210), (240, 200, 40)),
    "person": ((240, 120, 20), (210, 220, 40)),
    "stroller": ((60, 80, 150), (150, 50, 70)),
    "animal": ((140, 100, 65), (120, 85, 55)),
    "cone": ((240, 100, 20),),
    "barrier": ((235, 235, 230),),
    "arm": ((215, 255, 60),),
    "sign_stop": ((120, 120, 125),),
    "sign_go": ((120, 120, 125),),
}
_OTHER_AGENT: tuple[Color, ...] = ((170, 165, 160),)
_BUILDINGS: tuple[Color, ...] = ((205, 190, 165), (178, 120, 95), (195, 195, 200), (220, 205, 180), (150, 140, 130))
_CROWNS: tuple[Color, ...] = ((70, 105, 45), (55, 90, 50), (95, 115, 50))
_TRUNK: Color = (95, 75, 55)
_POLE: Color = (135, 138, 140)


@dataclass(frozen=True)
class SceneryBox:
    """A standing box: kind (building, crown, trunk, pole), centre and size (3,) in metres, yaw, and base colour."""

    kind: str
    center: tuple[float, float, float]
    size: tuple[float, float, float]
    yaw: float
    color: Color


@dataclass(frozen=True)
class Looks:
    """The looks of one scene.

    Attributes:
        texture_seed: shifts the textures of road and sky.
        sun_direction: unit vector (x, y, z) towards the sun.
        zenith, horizon: colours of the sky.
        grass, gravel, asphalt, paint: colours of the ground.
        cloudiness: share of the sky that clouds cover, 0 ... 1.
        agent_colors: base colour by agent id.
        scenery: buildings, trees and poles.
    """

    texture_seed: int
    sun_direction: tuple[float, float, float]
    zenith: Color
    horizon: Color
    grass: Color
    gravel: Color
    asphalt: Color
    paint: Color
    cloudiness: float
    agent_colors: dict[str, Color]
    scenery: tuple[SceneryBox, ...]


def generate_looks(scene: Scene) -> Looks:
    """Invent looks: a pure function of the scene's name and geometry."""
    generator = make_generator("looks", scene.name)
    elevation, azimuth = generator.uniform(np.radians(30), np.radians(65)), generator.uniform(-np.pi, np.pi)
    sun = (np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation))
    agent_colors = {}
    for agent in scene.agents:
        # Who is away for a while and back (`sources.tracks`) looks as before.
        chooser = make_generator("agent color", scene.name, agent.id.partition("#")[0])
        colors = _AGENT_COLORS.get(agent.label, _OTHER_AGENT)
        agent_colors[agent.id] = _shade(colors[chooser.integers(len(colors))], chooser, 0.08)
    grey, dry = generator.uniform(88.0, 122.0), generator.uniform(0.0, 1.0)
    return Looks(
        texture_seed=derive_seed("texture", scene.name) % 2**31,
        sun_direction=(float(sun[0]), float(sun[1]), float(sun[2])),
        zenith=_shade((70, 120, 195), generator, 0.15),
        horizon=_shade((196, 210, 224), generator, 0.05),
        grass=(float(70 + 60 * dry), float(100 + 15 * dry), float(45 + 20 * dry)),
        gravel=_shade((140, 130, 115), generator, 0.1),
        asphalt=(float(grey), float(grey), float(grey + 3.0)),
        paint=_shade((238, 238, 232), generator, 0.04),
        cloudiness=float(generator.uniform(0.2, 0.7)),
        agent_colors=agent_colors,
        scenery=_generate_scenery(scene),
    )


def _generate_scenery(scene: Scene) -> tuple[SceneryBox, ...]:
    generator = make_generator("scenery", scene.name)
    # No scenery stands on the road or where agents come and go.
    road = [shapely.Polygon(outline[:, :2]) for outline in scene.drivable]
    lanes = [] if road else [shapely.LineString(lane.center[:, :2]).buffer(2.5) for lane in scene.lanes]
    tracks = [area for agent in scene.agents for area in footprints(agent.poses[[0, -1]], agent.length, agent.width)]
    occupied = shapely.union_all([*road, *lanes, *tracks])
    boxes = _poles(scene, occupied)
    built_up = generator.uniform(0.1, 0.5)
    west, south, east, north = occupied.buffer(_FARTHEST).bounds
    proposed = [
        (_building if generator.random() < built_up else _tree)(x, y, generator)
        for x, y in generator.uniform((west, south), (east, north), size=(_PROPOSALS, 2)).tolist()
    ]
    circles = np.array([[*parts[-1].center[:2], np.hypot(*parts[-1].size[:2]) / 2] for parts in proposed])
    room = shapely.distance(occupied, shapely.points(circles[:, :2])) - circles[:, 2]
    free = (room > _NEAREST) & (room < _FARTHEST)
    taken = np.zeros((0, 3))
    for parts, circle in zip((p for p, f in zip(proposed, free, strict=True) if f), circles[free], strict=True):
        if np.all(np.hypot(*(taken[:, :2] - circle[:2]).T) > taken[:, 2] + circle[2] + _NEAREST):
            taken = np.concatenate([taken, circle[None]])
            boxes += parts
    return tuple(boxes)


def _poles(scene: Scene, occupied: shapely.Geometry) -> list[SceneryBox]:
    """Street lights along the road edges."""
    poles: list[SceneryBox] = []
    for edge in scene.road_edges:
        line = shapely.LineString(edge[:, :2]).offset_curve(-_POLE_OFFSET)
        for point in map(line.interpolate, np.arange(15.0, line.length, _POLE_SPACING)):
            if shapely.distance(occupied, point) > _POLE_OFFSET / 2:
                poles.append(SceneryBox("pole", (point.x, point.y, 3.5), (0.16, 0.16, 7.0), 0.0, _POLE))
    return poles


def _building(x: float, y: float, generator: np.random.Generator) -> list[SceneryBox]:
    length, width = generator.uniform(8.0, 20.0, size=2)
    height = 3.0 * generator.integers(1, 5) + 0.5
    color = _shade(_BUILDINGS[generator.integers(len(_BUILDINGS))], generator, 0.1)
    yaw = float(generator.uniform(0.0, np.pi))
    return [SceneryBox("building", (x, y, height / 2), (float(length), float(width), float(height)), yaw, color)]


def _tree(x: float, y: float, generator: np.random.Generator) -> list[SceneryBox]:
    trunk, crown = generator.uniform(1.5, 2.5), generator.uniform(2.5, 5.0)
    width = generator.uniform(2.0, 4.0)
    color = _shade(_CROWNS[generator.integers(len(_CROWNS))], generator, 0.15)
    yaw = float(generator.uniform(0.0, np.pi))
    return [
        SceneryBox("trunk", (x, y, float(trunk / 2)), (0.3, 0.3, float(trunk)), yaw, _TRUNK),
        SceneryBox("crown", (x, y, float(trunk + crown / 2)), (float(width), float(width), float(crown)), yaw, color),
    ]


def _shade(color: Color, generator: np.random.Generator, spread: float) -> Color:
    gain = generator.uniform(1.0 - spread, 1.0 + spread)
    red, green, blue = np.minimum(np.array(color) * gain, 255.0).tolist()
    return red, green, blue
