"""Heads of traffic lights in pictures: where they are, what they show, and from where that can be read."""

from dataclasses import replace

import numpy as np
import pytest

from olt_closed_loop.scenes.conditions import parse_conditions
from olt_closed_loop.scenes.hills import lay_crest, put_on_hills
from olt_closed_loop.scenes.maps.arms import Arm
from olt_closed_loop.scenes.maps.junctions import junction
from olt_closed_loop.scenes.maps.lanes import Light
from olt_closed_loop.scenes.maps.signals import SignalPlan, with_signals
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.scenes.scene_map import with_map
from olt_closed_loop.sensors.ray_casting import rig_sensors
from olt_closed_loop.sensors.signal_heads import SignalHeads
from olt_generator.poses import planar_pose
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE, FRONT_TELE, FRONT_WIDE

TOY, FULL = (64, 112), (320, 576)
STATES = {"green": 0, "amber": 10_000_000, "red": 13_000_000}
"""When the plan of these scenes shows what to the arm that the ego comes on."""
FRONT = DEFAULT_VEHICLE.rear_axle_to_bbox_center + DEFAULT_VEHICLE.length / 2


def lit_scene(left_hand=False) -> Scene:
    """A junction of four arms with lights; the ego stands on arm 2, whose lights are green until 10 s."""
    arms = [Arm(k * np.pi / 2.0, length=120.0, control="light") for k in range(4)]
    plan = SignalPlan(phases=((2, 0), (1, 3)), green=10.0)
    road_map = with_signals(junction(arms, left_hand=left_hand), plan)
    route = road_map.route_line(road_map.route("arm2_in_0", "arm0_out_0"))
    times = np.array([0, 20_000_000], dtype=np.int64)
    poses = planar_pose(np.full(2, route[0, 0]), np.full(2, route[0, 1]), np.zeros(2))
    empty = Scene("lit", "nominal", (), DEFAULT_VEHICLE, Trajectory(times, poses), (), (), (), (), route)
    return with_map(empty, road_map)


def before_the_line(scene: Scene, front_gap: float) -> np.ndarray:
    """The pose of a vehicle whose front is so far before its stop line, metres."""
    line = next(line for line in scene.stop_lines if line.id == "arm2_stop")
    x, y, _ = line.points.mean(axis=0)
    return planar_pose(x - front_gap - FRONT, y, 0.0)


def shown(picture: np.ndarray) -> str | None:
    """The state whose colour a picture (3, H, W) shows most strongly; None where none is."""
    red, green, blue = picture.astype(np.float64)
    strength = {
        "red": np.minimum(red - green, red - blue),
        "amber": np.minimum(red - blue, 2.0 * green - red) - 1.4 * np.abs(red - 1.43 * green),
        "green": np.minimum(green - red, green - 1.2 * blue),
    }
    best = max(strength, key=lambda state: strength[state].max())
    return best if strength[best].max() > 70.0 else None


@pytest.mark.parametrize("left_hand", [False, True])
@pytest.mark.parametrize("light", ["day", "night"])
@pytest.mark.parametrize(
    ("camera", "size", "gap"),
    [(FRONT_WIDE, TOY, 1.0), (FRONT_WIDE, TOY, 12.0), (FRONT_TELE, TOY, 60.0), (FRONT_WIDE, FULL, 40.0)],
)
def test_a_camera_reads_the_lamp_at_the_line_and_from_afar(left_hand, light, camera, size, gap):
    scene = lit_scene(left_hand)
    conditions = replace(parse_conditions(light, "clear"), street_lights=False)
    sensors = rig_sensors(scene, conditions)
    pose = before_the_line(scene, gap)
    seen = {state: shown(sensors((camera,), size, pose, time_us)[0]) for state, time_us in STATES.items()}
    assert seen == {state: state for state in STATES}


def test_a_light_shows_its_state_to_its_own_traffic_only():
    scene = lit_scene()
    sensors, pose = rig_sensors(scene), before_the_line(scene, 5.0)
    own = next(light for light in scene.lights if light.id == "arm2_light")
    others = tuple(light for light in scene.lights if light is not own)
    behind = rig_sensors(replace(scene, lights=others))
    assert shown(sensors((FRONT_WIDE,), FULL, pose, STATES["red"])[0]) == "red"
    assert shown(behind((FRONT_WIDE,), FULL, pose, STATES["red"])[0]) is None


def test_a_light_that_is_off_or_not_known_shows_nothing():
    scene = lit_scene()
    pose, pictures = before_the_line(scene, 8.0), []
    for state in ("off", "unknown"):
        lights = tuple(replace(light, timestamps_us=np.array([0]), states=(state,)) for light in scene.lights)
        pictures.append(rig_sensors(replace(scene, lights=lights))((FRONT_WIDE,), FULL, pose, 1)[0])
        assert shown(pictures[-1]) is None
    np.testing.assert_array_equal(*pictures)


def test_lights_without_a_position_are_not_drawn():
    scene = lit_scene()
    nowhere = replace(scene, lights=tuple(replace(light, position=None) for light in scene.lights))
    assert len(SignalHeads(scene)) == 4 and len(SignalHeads(nowhere)) == 0
    pictures = [rig_sensors(one)((FRONT_WIDE,), TOY, before_the_line(one, 5.0), 0) for one in (nowhere, scene)]
    bare = rig_sensors(replace(scene, lights=()))((FRONT_WIDE,), TOY, before_the_line(scene, 5.0), 0)
    np.testing.assert_array_equal(pictures[0], bare)
    assert not np.array_equal(pictures[1], bare)


def test_a_head_over_the_road_hangs_from_an_arm_whose_pole_stands_beside_it():
    scene = lit_scene()
    x, y, _ = before_the_line(scene, -30.0)[:3, 3]
    light = Light("over", ("arm2_in_0",), np.array([0]), ("red",), np.array([x, y, 5.2]))
    heads = SignalHeads(replace(scene, lights=(light,)))
    assert len(heads.standing) == 3
    low = heads.standing.center[:, 2] - heads.standing.half[:, 2]
    assert low.min() == pytest.approx(0.0) and np.sort(low)[1] > 4.5
    pole = heads.standing.center[np.argmin(low), :2]
    assert np.hypot(*(pole - [x, y])) > 1.0


def test_lights_of_lanes_that_the_map_lacks_show_to_all_sides():
    scene = lit_scene()
    light = Light("round", ("elsewhere",), np.array([0]), ("red",), np.array([0.0, 0.0, 4.0]))
    sensors = rig_sensors(replace(scene, lights=(light,)))
    for yaw in (0.0, np.pi / 2, np.pi, -np.pi / 2):
        pose = planar_pose(-15.0 * np.cos(yaw), -15.0 * np.sin(yaw), yaw)
        assert shown(sensors((FRONT_WIDE,), FULL, pose, 0)[0]) == "red"


def test_poles_stand_on_hills():
    scene = put_on_hills(lit_scene(), lay_crest(0.0, 0.0, 6.0, 200.0))
    standing = SignalHeads(scene).standing
    poles = standing.select(np.flatnonzero(standing.half[:, 2] > 1.0))
    assert len(poles) == 4 and scene.hills is not None
    np.testing.assert_allclose(poles.center[:, 2] - poles.half[:, 2], scene.hills.height(poles.center), atol=1e-6)


def test_the_same_moment_gives_the_same_picture_again():
    scene = lit_scene()
    sensors, pose = rig_sensors(scene), before_the_line(scene, 5.0)
    first = sensors((FRONT_WIDE,), TOY, pose, STATES["red"])
    sensors((FRONT_WIDE,), TOY, pose, STATES["green"])
    np.testing.assert_array_equal(first, sensors((FRONT_WIDE,), TOY, pose, STATES["red"]))
