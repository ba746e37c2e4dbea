"""Hills: what stands on them, and how a vehicle leans with them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_closed_loop.scenes.hills import Wave, lay_hills, pose_on_hills, put_on_hills, stand_up
from olt_closed_loop.scenes.procedural import generate_scene
from olt_closed_loop.scenes.scene import Agent, Hills
from olt_generator.poses import planar_pose, transform
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

HILLS = lay_hills(0.4, (Wave(5.0, 120.0, 0.3), Wave(2.0, 60.0, 2.0)))


@given(st.floats(-500.0, 500.0), st.floats(-500.0, 500.0), st.floats(-np.pi, np.pi))
def test_a_vehicle_stands_on_its_axles(x: float, y: float, yaw: float) -> None:
    pose = pose_on_hills(HILLS, planar_pose(x, y, yaw), DEFAULT_VEHICLE)
    rotation = pose[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    # Its origin is on the ground, x points to the ground below the front axle, and it is not upside down.
    assert pose[2, 3] == pytest.approx(float(HILLS.height(pose[:3, 3])))
    front = np.array([x + DEFAULT_VEHICLE.wheelbase * np.cos(yaw), y + DEFAULT_VEHICLE.wheelbase * np.sin(yaw), 0.0])
    front[2] = HILLS.height(front)
    ahead = (front - pose[:3, 3]) / np.linalg.norm(front - pose[:3, 3])
    np.testing.assert_allclose(rotation[:, 0], ahead, atol=1e-12)
    assert rotation[2, 2] > 0.9


def test_height_changes_along_one_direction_only() -> None:
    along, across = np.array([np.cos(0.4), np.sin(0.4)]), np.array([-np.sin(0.4), np.cos(0.4)])
    base = 37.0 * along
    assert np.ptp(HILLS.height(base + np.linspace(-300, 300, 50)[:, None] * across)) < 1e-9
    expected = 5.0 * np.sin(2 * np.pi / 120.0 * 37.0 + 0.3) + 2.0 * np.sin(2 * np.pi / 60.0 * 37.0 + 2.0)
    assert float(HILLS.height(base)) == pytest.approx(expected)
    assert HILLS.height(along * 1e5) == HILLS.heights[-1]


def test_a_lifted_scene_keeps_its_plan() -> None:
    level = generate_scene("nominal", 3)
    lifted = put_on_hills(level, HILLS)
    np.testing.assert_allclose(lifted.ego.positions[:, :2], level.ego.positions[:, :2], atol=1e-9)
    assert np.ptp(lifted.ego.positions[:, 2]) > 0.5
    for before, after in zip(level.agents, lifted.agents, strict=True):
        assert np.array_equal(after.poses[:, [0, 1, 3]], before.poses[:, [0, 1, 3]])
        np.testing.assert_allclose(after.poses[:, 2] - before.poses[:, 2], HILLS.height(before.poses), atol=1e-9)
    np.testing.assert_allclose(lifted.route[:, 2], HILLS.height(level.route))


def test_level_hills_change_nothing() -> None:
    level = generate_scene("nominal", 3)
    flat = put_on_hills(level, lay_hills(1.0, ()))
    np.testing.assert_allclose(flat.ego.T_world_rig, level.ego.T_world_rig, atol=1e-12)


@given(st.floats(-3.0, 3.0), st.floats(-np.pi, np.pi), st.floats(-0.3, 0.3))
def test_a_vehicle_of_others_leans_with_the_ground(direction: float, yaw: float, slope: float) -> None:
    hills = Hills(direction, -100.0, 200.0, np.array([-100.0 * slope, 100.0 * slope]))
    times, pose = np.array([0, 1]), np.array([3.0, -4.0, 0.0, yaw])
    pose[2] = float(hills.height(pose[:2])) + 0.75
    car = Agent("car", "automobile", 4.6, 1.85, 1.5, times, np.tile(pose, (2, 1)))
    stood = stand_up(car, pose, hills)
    below = np.array([[x, y, -0.75] for x in (-2.3, 2.3) for y in (-0.9, 0.9)])
    wheels = transform(stood, below)
    np.testing.assert_allclose(wheels[:, 2], hills.height(wheels), atol=1e-9)
    np.testing.assert_allclose(stood[:3, :3] @ stood[:3, :3].T, np.eye(3), atol=1e-12)
    # Seen from above it looks where it did.
    assert np.cos(np.arctan2(stood[1, 0], stood[0, 0]) - yaw) == pytest.approx(1.0)


def test_people_stay_upright_and_level_ground_changes_nothing() -> None:
    hills, pose = Hills(0.0, -100.0, 200.0, np.array([-20.0, 20.0])), np.array([3.0, -4.0, 1.5, 0.7])
    size, times = (0.5, 0.6, 1.75), np.array([0, 1])
    walker = Agent("walker", "person", *size, times, np.tile(pose, (2, 1)))
    for agent, ground in ((walker, hills), (replace(walker, label="animal"), None)):
        np.testing.assert_allclose(stand_up(agent, pose, ground), planar_pose(3.0, -4.0, 0.7, 1.5), atol=1e-15)
