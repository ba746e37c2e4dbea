"""Labels of what is around the vehicle, and of held lines."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from olt_closed_loop.privileged.labels import REACH, ROADSIDE, label_holds, label_obstacles, label_road
from olt_closed_loop.scenes.actors import agent_poses
from olt_closed_loop.suite.scenes import make_scene
from olt_closed_loop.suite.training import make_training_scene
from olt_generator.poses import planar_pose, transform, yaw_of
from olt_toolkit.recordings.truth import OBSTACLE_CLASSES


def test_boxes_are_where_the_agents_are():
    scene, start_us = make_scene("rider_crosses"), 1_300_000
    tracks = label_obstacles(scene, start_us)
    assert set(tracks.labels) <= set(OBSTACLE_CLASSES) and len(tracks.boxes) > 50
    assert np.all(np.diff(tracks.timestamps_us) >= 0) and tracks.timestamps_us[0] == 0
    agents = {agent.id: agent for agent in scene.agents}
    for row in range(0, len(tracks.boxes), 17):
        time_us = np.array([tracks.timestamps_us[row] + start_us])
        T_world_rig, agent = scene.ego.interpolate(time_us)[0], agents[str(tracks.track_ids[row])]
        x, y, z, yaw = agent_poses(agent, time_us)[0]
        np.testing.assert_allclose(transform(T_world_rig, tracks.boxes[row, None, :3])[0], (x, y, z), atol=1e-6)
        turned = tracks.boxes[row, 3] + yaw_of(T_world_rig) - yaw
        assert np.cos(turned) == pytest.approx(1.0)
        assert tuple(tracks.boxes[row, 4:]) == (agent.length, agent.width, agent.height)
    assert np.hypot(*tracks.boxes[:, :2].T).max() <= REACH


def test_a_light_holds_the_way_until_it_is_green():
    scene = make_training_scene("red_straight", 1)
    holds = label_holds(scene, 0)
    known = np.isfinite(holds.distance)
    assert holds.is_held.any() and not holds.is_held[~known].any()
    # It comes to the line and passes it when it is no longer held.
    assert holds.distance[holds.is_held].min() > 0.0
    assert np.all(np.diff(holds.distance[known]) < 0.05)
    (light,) = [light for light in scene.lights if "arm3_in_0>arm1_out_0" in light.lanes]
    for time_us, held in zip(holds.timestamps_us[known].tolist(), holds.is_held[known].tolist(), strict=True):
        assert held == (light.state_at(time_us) == "red")


def test_a_hand_holds_the_way():
    holds = label_holds(make_scene("officer_overrules_light"), 0)
    assert holds.is_held.any() and not holds.is_held[-1]


def test_nothing_holds_a_road_without_lights():
    holds = label_holds(make_scene("straight_road"), 500_000)
    assert not holds.is_held.any() and np.isnan(holds.distance).all()
    assert holds.timestamps_us[0] == 0 and holds.timestamps_us[-1] == 19_500_000


@pytest.mark.parametrize("event", ["straight_road", "left_hand_crossing", "roundabout_busy"])
def test_the_road_goes_as_far_as_is_told_and_ends_there(event):
    scene, start_us = make_scene(event), 2_000_000
    road = label_road(scene, start_us)
    T_world_rig = scene.ego.interpolate(np.array([start_us]))[0]
    T_world_rig = planar_pose(*T_world_rig[:2, 3], yaw_of(T_world_rig))
    points = transform(T_world_rig, np.column_stack([road[:, :2], np.zeros(len(road))]))[:, :2]
    assert shapely.distance(shapely.points(points), shapely.LineString(scene.route[:, :2])).max() < 1e-6
    drivable = shapely.union_all([shapely.Polygon(outline[:, :2]) for outline in scene.drivable])
    tangent = np.gradient(points, axis=0)
    left = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1) / np.linalg.norm(tangent, axis=1)[:, None]
    for place, side, (right_metres, left_metres) in list(zip(points, left, road[:, 2:], strict=True))[10:-10:7]:
        for metres, out in ((right_metres, -side), (left_metres, side)):
            way = shapely.LineString([place, place + (metres - 0.01) * out]) if metres > 0.1 else shapely.Point(place)
            assert drivable.buffer(0.11).covers(way)
            if metres < ROADSIDE - 0.1:
                assert drivable.boundary.distance(shapely.Point(place + (metres + 0.05) * out)) < 0.15


def test_left_hand_traffic_has_its_road_to_the_right():
    right, left = label_road(make_scene("left_hand_crossing"), 0)[5, 2:]
    assert right > left + 2.0


def test_without_road_nothing_is_told():
    scene = make_scene("straight_road")
    assert label_road(replace(scene, drivable=()), 0) is None
