"""Invented scenes: feasible, clear of everything, on the road, and the same for the same seed."""

from functools import cache

import numpy as np
import pytest
import shapely

from olt_closed_loop.scenes.procedural import CATEGORIES, generate_scene
from olt_closed_loop.scenes.scene import Scene
from olt_generator.errors import InputError
from olt_generator.poses import yaw_of

SEEDS = range(10)


@cache
def scene_of(category: str, seed: int) -> Scene:
    return generate_scene(category, seed)


@pytest.fixture(scope="module", params=CATEGORIES)
def scenes(request: pytest.FixtureRequest) -> list[Scene]:
    return [scene_of(request.param, seed) for seed in SEEDS]


def speeds(scene: Scene) -> np.ndarray:
    return np.linalg.norm(np.diff(scene.ego.positions, axis=0), axis=1) / np.diff(scene.ego.times)


def ego_polygons(scene: Scene, times_us: np.ndarray) -> np.ndarray:
    pose = scene.ego.interpolate(times_us)
    size = scene.vehicle
    rear = size.rear_axle_to_bbox_center - size.length / 2
    corners = np.array([[rear, -1], [rear + size.length, -1], [rear + size.length, 1], [rear, 1]])
    corners[:, 1] *= size.width / 2
    return shapely.polygons(np.einsum("nij,kj->nki", pose[:, :2, :2], corners) + pose[:, None, :2, 3])


def test_ego_moves_as_a_careful_human_can(scenes: list[Scene]) -> None:
    for scene in scenes:
        speed, step = speeds(scene), float(np.diff(scene.ego.times)[0])
        acceleration = np.diff(speed) / step
        yaw_rate = np.diff(np.unwrap(yaw_of(scene.ego.T_world_rig))) / step
        assert np.all(acceleration >= -4.0) and np.all(acceleration <= 2.0), scene.name
        assert np.abs(speed * yaw_rate).max() <= 3.0, scene.name
        assert speed.min() >= 2.0 and 8.0 <= speed.max() <= 14.0, scene.name
        assert scene.ego.times[-1] >= 13.0


def test_heading_is_the_tangent_of_the_path_and_the_pose_is_planar(scenes: list[Scene]) -> None:
    for scene in scenes:
        x, y = scene.ego.positions[:, :2].T
        tangent = np.arctan2(y[2:] - y[:-2], x[2:] - x[:-2])
        turn = yaw_of(scene.ego.T_world_rig[1:-1]) - tangent
        assert np.abs(np.arctan2(np.sin(turn), np.cos(turn))).max() < 1e-3
        assert np.all(scene.ego.T_world_rig[:, 2] == (0.0, 0.0, 1.0, 0.0))


def test_ego_keeps_clear_of_every_agent(scenes: list[Scene]) -> None:
    times = np.arange(0, scenes[0].ego.timestamps_us[-1] + 1, 50_000)
    for scene in scenes:
        ego = ego_polygons(scene, times)
        for agent in scene.agents:
            here = (times >= agent.timestamps_us[0]) & (times <= agent.timestamps_us[-1])
            x, y = (np.interp(times[here], agent.timestamps_us, agent.poses[:, axis]) for axis in (0, 1))
            yaw = np.interp(times[here], agent.timestamps_us, np.unwrap(agent.poses[:, 3]))
            half = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * (agent.length / 2, agent.width / 2)
            along = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
            left = np.stack([-np.sin(yaw), np.cos(yaw)], axis=-1)
            corners = half[:, :1] * along[:, None] + half[:, 1:] * left[:, None] + np.stack([x, y], -1)[:, None]
            assert shapely.distance(ego[here], shapely.polygons(corners)).min() >= 0.3, (scene.name, agent.id)


def test_ego_stays_inside_the_drivable_area(scenes: list[Scene]) -> None:
    for scene in scenes:
        outline = shapely.LinearRing(scene.drivable[0][:, :2])
        assert outline.is_ccw
        area = shapely.Polygon(outline)
        assert area.is_valid
        assert area.contains(ego_polygons(scene, scene.ego.timestamps_us[::5])).all(), scene.name


def test_road_bends_gently_and_its_edges_have_the_road_on_their_left(scenes: list[Scene]) -> None:
    for scene in scenes:
        area = shapely.Polygon(scene.drivable[0][:, :2])
        for edge in scene.road_edges:
            step = edge[1:, :2] - edge[:-1, :2]
            left = np.stack([-step[:, 1], step[:, 0]], axis=-1) / np.linalg.norm(step, axis=1, keepdims=True)
            assert shapely.contains(area, shapely.points(edge[:-1, :2] + 0.5 * step + 0.3 * left)).all()
            turn = np.diff(np.unwrap(np.arctan2(step[:, 1], step[:, 0])))
            assert np.abs(turn / np.linalg.norm(step[1:], axis=1)).max() < 1.0 / 60.0


def test_lanes_follow_each_other_and_lie_between_their_borders(scenes: list[Scene]) -> None:
    for scene in scenes:
        lanes = {lane.id: lane for lane in scene.lanes}
        followed = [(lane, lanes[name]) for lane in scene.lanes for name in lane.successors]
        assert followed
        for lane, following in followed:
            np.testing.assert_allclose(lane.center[-1], following.center[0], atol=1e-6)
        for lane in scene.lanes:
            step = np.gradient(lane.center[:, :2], axis=0)
            to_left = (lane.left - lane.center)[:, :2]
            assert np.all(step[:, 0] * to_left[:, 1] - step[:, 1] * to_left[:, 0] > 0.0)
            np.testing.assert_allclose(lane.left + lane.right, 2.0 * lane.center, atol=1e-6)
            np.testing.assert_allclose(np.linalg.norm(lane.left - lane.right, axis=1), 3.5, atol=1e-6)


@pytest.mark.parametrize("category", CATEGORIES)
def test_same_seed_gives_the_same_scene(category: str) -> None:
    first, second, other = scene_of(category, 5), generate_scene(category, 5), scene_of(category, 6)
    assert np.array_equal(first.ego.T_world_rig, second.ego.T_world_rig)
    assert [agent.poses.tobytes() for agent in first.agents] == [agent.poses.tobytes() for agent in second.agents]
    assert not np.array_equal(first.ego.T_world_rig, other.ego.T_world_rig)


@pytest.mark.parametrize(
    ("category", "label"),
    [("work_zone", "barrier"), ("cyclists", "rider"), ("animal", "animal"), ("path_reassignment", "cone")],
)
def test_event_is_there(category: str, label: str) -> None:
    assert all(any(a.label == label for a in scene_of(category, seed).agents) for seed in SEEDS)


def test_ego_brakes_for_the_animal_and_leaves_its_lane_where_cones_lead_it() -> None:
    for seed in SEEDS:
        assert speeds(scene_of("animal", seed)).min() < 4.5
        scene = scene_of("path_reassignment", seed)
        route = shapely.LineString(scene.route[:, :2])
        away = shapely.distance(route, shapely.points(scene.ego.positions[:, :2]))
        assert 3.3 < away.max() < 3.7


def test_some_recordings_start_off_the_lane_centre_and_return() -> None:
    offsets = []
    for seed in SEEDS:
        scene = scene_of("nominal", seed)
        route = shapely.LineString(scene.route[:, :2])
        offsets.append(shapely.distance(route, shapely.points(scene.ego.positions[[0, -1], :2])))
    start, end = np.array(offsets).T
    assert 0.3 < start.max() <= 0.61
    assert end.max() < 0.02


def test_unknown_category_is_refused() -> None:
    with pytest.raises(InputError, match="'flood' is not one of nominal"):
        generate_scene("flood", 0)
