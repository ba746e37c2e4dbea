"""Crops of what stands before the front camera, each of a known kind at a known distance."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.benchmarks.busy_junction import busy_junction
from olt_closed_loop.scenes.actors import SIZES
from olt_closed_loop.scenes.maps.lanes import Light
from olt_closed_loop.scenes.maps.signals import LAMP_HEIGHT
from olt_closed_loop.scenes.procedural import CATEGORIES, generate_scene
from olt_closed_loop.scenes.scene import Agent, Scene
from olt_closed_loop.scenes.scene_map import map_of
from olt_closed_loop.sensors.ray_casting import SceneRenderer
from olt_closed_loop.sensors.signal_heads import BACKPLATE
from olt_closed_loop.sensors.surfaces import SIGNAL_SURFACES
from olt_closed_loop.sensors.textures import Image
from olt_closed_loop.suite.people import SIGN, SIGN_HEIGHT, SIGN_OFFSET, held_out
from olt_generator.poses import Array, invert, planar_pose, transform
from olt_generator.seeds import make_generator
from olt_toolkit.rigs.rig import FRONT_WIDE
from olt_toolkit.rigs.rig_files import pav_rig

KINDS: tuple[str, ...] = (
    *("automobile", "heavy_truck", "bus", "other_vehicle", "rider", "person", "animal", "cone", "barrier"),
    *("officer_stops", "officer_waves", "sign_stop", "sign_go"),
    *("light_red", "light_amber", "light_green", "light_off"),
)
CROP = 32
NEAR, FAR = 5.0, 30.0
_SCENES = 8
_SLOT_US = 1_000
_LIGHT, _HEAD, _LIGHTS = "light_", "head", 8
_BUS: tuple[float, float, float] = (11.0, 2.5, 3.2)


def film_crops(size: tuple[int, int], count: int, seed: int) -> tuple[Image, NDArray[np.int64], Array]:
    """`count` crops of each kind, filmed in turns in eight scenes of their own: crops, kinds and distances.

    Returns:
        crops (n, 32, 32, 3), the number of each one's kind (n,), and its distance (n,) in metres. The last quarter is
        of scenes that the others do not show.
    """
    numbers = np.arange(count * len(KINDS)) % len(KINDS)
    found = [_film(size, part, seed, index) for index, part in enumerate(np.array_split(numbers, _SCENES))]
    return np.concatenate([crops for crops, _ in found]), numbers, np.concatenate([away for _, away in found])


def draw_sheet(crops: Image, kinds: NDArray[np.int64], distances: Array, columns: int = 12) -> Image:
    """A contact sheet (h, w, 3): a row for each kind, its crops from near to far."""
    rows = []
    for kind in range(len(KINDS)):
        own = np.flatnonzero(kinds == kind)
        own = own[np.argsort(distances[own])][np.linspace(0, len(own) - 1, columns).astype(int)]
        rows.append(np.concatenate([cv2.resize(crops[index], (96, 96)) for index in own], axis=1))
    return np.concatenate(rows)


def _film(size: tuple[int, int], kinds: NDArray[np.int64], seed: int, index: int) -> tuple[Image, Array]:
    """Each agent is there for a time of its own, and is filmed then; the vehicle stands anywhere on its way."""
    generator = make_generator("crops", seed, index)
    category = CATEGORIES[index % len(CATEGORIES)]
    base = generate_scene(category, 9000 + 10 * seed + index) if index % 2 else busy_junction(0, seed=seed + index)
    ways = base.ego.interpolate(generator.integers(0, base.ego.timestamps_us[-1] * 3 // 4, len(kinds)))
    groups, distances = [], generator.uniform(NEAR, FAR, len(kinds))
    lights = _hang_lights(base, kinds, generator)
    for slot, (kind, away) in enumerate(zip(kinds.tolist(), distances.tolist(), strict=True)):
        if KINDS[kind].startswith(_LIGHT):
            head, ways[slot] = _look_at(lights[slot % len(lights)], base, slot, away, generator)
            groups.append([head])
        else:
            groups.append(_place(KINDS[kind], slot, ways[slot], away, generator))
    agents = tuple(agent for group in groups for agent in group if agent.label != _HEAD)
    scene = replace(base, agents=agents, lights=lights)
    renderer = SceneRenderer(scene)
    mounted = pav_rig().fitted(size[1], size[0])[FRONT_WIDE]
    crops = []
    for slot, (group, T_world_rig) in enumerate(zip(groups, ways, strict=True)):
        T_world_camera = T_world_rig @ mounted.T_rig_camera
        rgb = renderer.render(mounted.camera, T_world_camera, 2 * slot * _SLOT_US, T_world_rig).rgb
        pixels, _ = mounted.camera.project(transform(invert(T_world_camera), _corners(group)))
        crops.append(_crop(rgb, pixels))
    return np.stack(crops), distances


def _hang_lights(base: Scene, kinds: NDArray[np.int64], generator: np.random.Generator) -> tuple[Light, ...]:
    """Lights at places of their own, which show at each slot the state that it asks for, and else any."""
    times_us = 2 * _SLOT_US * np.arange(len(kinds), dtype=np.int64)
    found = []
    for index, T_world_rig in enumerate(
        base.ego.interpolate(generator.integers(0, base.ego.timestamps_us[-1], _LIGHTS))
    ):
        states = generator.choice(list(SIGNAL_SURFACES), len(kinds))
        asked = [slot for slot in range(index, len(kinds), _LIGHTS) if KINDS[kinds[slot]].startswith(_LIGHT)]
        states[asked] = [KINDS[kinds[slot]].removeprefix(_LIGHT) for slot in asked]
        x, y, _ = transform(T_world_rig, np.array([[0.0, generator.uniform(-9.0, -3.0), 0.0]]))[0]
        lane = base.lanes[generator.integers(len(base.lanes))].id
        found.append(Light(f"light_{index}", (lane,), times_us, tuple(states.tolist()), np.array([x, y, LAMP_HEIGHT])))
    return tuple(found)


def _look_at(light: Light, base: Scene, slot: int, away: float, generator: np.random.Generator) -> tuple[Agent, Array]:
    """The box of a light's head, and a pose (4, 4) of a vehicle in the traffic that it rules, so far before it."""
    center = map_of(base).lane(light.lanes[0]).center
    turn = float(np.arctan2(*(center[1, :2] - center[0, :2])[::-1])) + generator.uniform(-0.3, 0.3)
    bearing, position = generator.uniform(-0.45, 0.45), light.position
    assert position is not None
    x, y = position[:2] - away * np.array([np.cos(turn), np.sin(turn)])
    yaw = turn - bearing
    pose = planar_pose(x - 2.0 * np.cos(yaw), y - 2.0 * np.sin(yaw), yaw)
    return _there(f"head_{slot}", _HEAD, BACKPLATE, np.array([*position, turn + np.pi]), slot), pose


def _place(kind: str, slot: int, T_world_rig: Array, away: float, generator: np.random.Generator) -> list[Agent]:
    bearing = generator.uniform(-0.45, 0.45)
    x, y, _ = transform(T_world_rig, np.array([[2.0 + away * np.cos(bearing), away * np.sin(bearing), 0.0]]))[0]
    forward = float(np.arctan2(T_world_rig[1, 0], T_world_rig[0, 0]))
    directs = kind.startswith(("officer", "sign"))
    # Who directs traffic faces those who are directed.
    yaw = forward + np.pi + generator.uniform(-0.3, 0.3) if directs else generator.uniform(-np.pi, np.pi)
    if not directs:
        length, width, height = _BUS if kind == "bus" else SIZES[kind]
        gap = 0.4 * length * (length > 3.0)
        place = np.array([x + gap * np.cos(forward), y + gap * np.sin(forward), height / 2, yaw])
        return [_there(f"{kind}_{slot}", kind, (length, width, height), place, slot)]
    body = _there(f"person_{slot}", "person", SIZES["person"], np.array([x, y, SIZES["person"][2] / 2, yaw]), slot)
    if kind.startswith("sign"):
        side = yaw - np.pi / 2
        x, y = x + SIGN_OFFSET * np.cos(side), y + SIGN_OFFSET * np.sin(side)
        place = np.array([x, y, SIGN_HEIGHT + SIGN[2] / 2, yaw])
        return [body, _there(f"{kind}_{slot}", kind, SIGN, place, slot)]
    # Who stops holds out both arms; one arm hangs, which the body shows, while the other waves before the body.
    waves = kind == "officer_waves"
    directions = [yaw + np.pi / 2 - (generator.uniform(-0.9, 0.9) if waves else 0.0)]
    directions += [] if waves else [yaw - np.pi / 2]
    return [
        body,
        *(
            held_out(f"arm_{index}_{slot}", (x, y), np.full(2, turn), _slot_times(slot))
            for index, turn in enumerate(directions)
        ),
    ]


def _there(name: str, label: str, size: tuple[float, float, float], pose: Array, slot: int) -> Agent:
    return Agent(name, label, *size, _slot_times(slot), np.tile(pose, (2, 1)))


def _slot_times(slot: int) -> NDArray[np.int64]:
    return np.array([0, _SLOT_US], dtype=np.int64) + 2 * slot * _SLOT_US


def _corners(group: Sequence[Agent]) -> Array:
    """Corners (n, 3) in the world of the boxes of some agents."""
    signs = np.array([[a, b, c] for a in (-0.5, 0.5) for b in (-0.5, 0.5) for c in (-0.5, 0.5)])
    found = []
    for agent in group:
        x, y, z, yaw = agent.poses[0]
        local = signs * [agent.length, agent.width, agent.height]
        cos, sin = np.cos(yaw), np.sin(yaw)
        turned = np.column_stack(
            [cos * local[:, 0] - sin * local[:, 1], sin * local[:, 0] + cos * local[:, 1], local[:, 2]]
        )
        found.append(turned + np.array([x, y, z]))
    return np.concatenate(found)


def _crop(rgb: Image, pixels: Array) -> Image:
    """The square around pixels (n, 2), a sixth larger than they need, brought to 32 x 32."""
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    side = 1.17 * max(float((high - low).max()), 4.0)
    left, top = (low + high) / 2 - side / 2
    scale = side / CROP
    places = np.arange(CROP, dtype=np.float32) * scale + 0.5 * scale - 0.5
    columns, rows = np.meshgrid(left + places, top + places)
    places = (columns.astype(np.float32), rows.astype(np.float32))
    return np.asarray(cv2.remap(rgb, *places, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.uint8)
