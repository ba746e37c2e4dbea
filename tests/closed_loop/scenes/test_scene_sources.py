"""Recorded drives as scenes, on small invented files of the data sets' formats."""

import json
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from pyarrow import feather

from olt_closed_loop.evaluation.gate import check_gate
from olt_closed_loop.scenes.maps.lanes import Marking
from olt_closed_loop.scenes.scene import Lane
from olt_closed_loop.scenes.scene_file import read_scene, write_scene
from olt_closed_loop.scenes.sources import find_recordings, read_recording
from olt_closed_loop.scenes.sources.argoverse2 import AXLE_HEIGHT
from olt_closed_loop.scenes.sources.roads import (
    ROUTE_BEYOND,
    edges,
    lane_around,
    lane_between,
    link_by_place,
    outlines,
    route_along,
)
from olt_closed_loop.scenes.sources.swath import add_room
from olt_generator.errors import InputError
from olt_generator.poses import yaw_of

from .recordings import CITY, SPEED, STEPS, points, scenario, write_motion_scenario, write_scenario, write_sensor_log


@pytest.fixture
def sensor_log(tmp_path):
    return write_sensor_log(tmp_path / "log")


@pytest.fixture
def motion_scenario(tmp_path):
    return write_motion_scenario(tmp_path / "scenario")


def test_a_map_of_argoverse_tells_markings_neighbours_and_crossings(sensor_log):
    path = sensor_log / "map" / "log_map_archive_x.json"
    content = json.loads(path.read_text())
    first, second = (content["lane_segments"][name] for name in ("1", "2"))
    first |= {"left_lane_mark_type": "DOUBLE_SOLID_YELLOW", "right_lane_mark_type": "DASHED_WHITE"}
    first |= {"left_neighbor_id": 9, "right_neighbor_id": None, "is_intersection": False}
    second |= {"left_lane_mark_type": "NONE", "right_lane_mark_type": "UNKNOWN", "is_intersection": True}
    corners = [np.add(CITY, (x, y, 0.0)) for x, y in ((10, 5), (10, -5), (13, 5), (13, -5))]
    edges = {"edge1": points(corners[:2]), "edge2": points(corners[2:])}
    content["pedestrian_crossings"] = {"5": {"id": 5, **edges}}
    path.write_text(json.dumps(content))
    scene = read_recording(sensor_log)
    one, other = scene.lanes
    assert (one.left_marking, one.right_marking) == (Marking("double", False), Marking("dashed", True))
    assert (one.left_neighbours, one.right_neighbours, one.junction) == (("9",), (), None)
    assert (other.left_marking, other.right_marking, other.left_neighbours) == (Marking("none"), None, None)
    assert (one.type, other.junction, other.yields_to) == ("driving", "intersection", None)
    (crossing,) = scene.crossings
    assert crossing.lanes == ("1",) and crossing.zebra is None
    assert shapely.Polygon(crossing.outline[:, :2]).is_valid and shapely.LinearRing(crossing.outline[:, :2]).is_ccw


def test_a_sensor_log_is_read_into_the_world_frame(sensor_log):
    scene = read_recording(sensor_log)
    start = SPEED * 0.05 * 4
    np.testing.assert_array_equal(scene.ego.timestamps_us, 100_000 * np.arange(48))
    np.testing.assert_allclose(scene.ego.positions[0], 0.0, atol=1e-9)
    np.testing.assert_allclose(scene.ego.positions[:, 0], SPEED * scene.ego.times, atol=1e-6)
    (parked,) = scene.agents
    assert (parked.id, parked.label, parked.length, parked.width, parked.height) == (
        "parked",
        "automobile",
        4.5,
        1.8,
        1.5,
    )
    np.testing.assert_allclose(parked.poses, [[20.0 - start, 3.5, 0.75, 0.3]] * 48, atol=1e-6)
    assert [(lane.id, lane.successors) for lane in scene.lanes] == [("1", ("2",)), ("2", ())]
    np.testing.assert_allclose(scene.lanes[0].center[:, 2], AXLE_HEIGHT, atol=1e-9)
    assert shapely.LinearRing(scene.drivable[0][:, :2]).is_ccw
    assert any("Ford" in text for text in scene.assumptions)


def test_a_sensor_log_passes_the_gate_and_survives_a_scene_file(sensor_log, tmp_path):
    scene = read_recording(sensor_log)
    again = read_scene(write_scene(scene, tmp_path / "scene.usdc"))
    assert check_gate(again).passed
    assert again.assumptions == scene.assumptions
    np.testing.assert_array_equal(again.route, scene.route)


def test_a_sweep_without_ego_pose_is_named(sensor_log):
    path = sensor_log / "city_SE3_egovehicle.feather"
    feather.write_feather(feather.read_table(path).slice(0, 60), path)
    with pytest.raises(InputError, match="no ego pose at timestamp_ns 1000000003000000000"):
        read_recording(sensor_log)


@pytest.mark.parametrize("name", ["annotations.feather", "map/log_map_archive_x.json"])
def test_damaged_files_of_a_log_are_named(sensor_log, name):
    (sensor_log / name).write_bytes(b"{}")
    with pytest.raises(InputError, match=name):
        read_recording(sensor_log)


def test_a_motion_scenario_gets_sizes_by_class(motion_scenario):
    scene = read_recording(motion_scenario)
    assert scene.name == "argoverse2_abc"
    assert [(agent.id, agent.label) for agent in scene.agents] == [("9", "rider")]
    np.testing.assert_allclose(scene.agents[0].poses[:, 2], 0.5 * scene.agents[0].height)
    np.testing.assert_allclose(scene.agents[0].poses[:, 0], 12.0 + SPEED * scene.ego.times, atol=1e-6)
    assert any("1 tracks of unknown size" in text for text in scene.assumptions)
    assert check_gate(scene).passed


def test_a_nuscenes_scenario_is_put_on_flat_ground(tmp_path):
    scene = read_recording(write_scenario(tmp_path / "one.json.gz", scenario()))
    (bus,) = scene.agents
    assert (bus.label, bus.length, bus.width, bus.height) == ("bus", 11.0, 2.9, 3.4)
    np.testing.assert_allclose(bus.poses, [[60.0, 8.0, 1.7, 3.0]] * 50)
    np.testing.assert_array_equal(bus.timestamps_us, 100_000 * np.arange(10, STEPS))
    assert (scene.vehicle.length, scene.vehicle.width) == (4.084, 1.73)
    np.testing.assert_allclose(scene.ego.positions[:, 2], 0.0)
    np.testing.assert_allclose(scene.lanes[0].left[:, 1], 3.0)
    assert check_gate(scene).passed


def test_where_the_recorded_ego_drove_is_drivable_and_nobody_else_could(tmp_path):
    scene = read_recording(write_scenario(tmp_path / "one.json.gz", scenario(turned=True)))
    assert any(f"({STEPS} of its {STEPS} poses" in text for text in scene.assumptions)
    result = check_gate(scene)
    assert result.checks[0].passed and "off the road" in result.failed[-1].finding
    assert result.narrow[0].metres == pytest.approx(0.0, abs=2e-3)


@pytest.mark.parametrize(("room", "passes"), [(0.05, False), (0.2, True)])
def test_room_about_the_recorded_ego_is_told(tmp_path, room, passes):
    scene = read_recording(write_scenario(tmp_path / "one.json.gz", scenario(turned=True)))
    roomy = add_room(scene, room)
    assert f"{room} m about the recorded ego are drivable" in roomy.assumptions[-1]
    result = check_gate(roomy)
    assert result.passed is passes and result.narrow[0].metres == pytest.approx(room, abs=2e-3)


def test_room_that_is_there_changes_nothing(tmp_path):
    scene = read_recording(write_scenario(tmp_path / "one.json.gz", scenario()))
    assert add_room(scene, 0.2) is scene
    for room in (0.0, -1.0, 3.0, float("nan")):
        with pytest.raises(InputError, match="give more than 0 and at most 2 m"):
            add_room(scene, room)
    with pytest.raises(InputError, match="no drivable area"):
        add_room(replace(scene, drivable=()), 0.2)


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: content["tracks"].pop("ego"),
        lambda content: content["tracks"]["bus"]["metadata"].update(type="spaceship"),
        lambda content: content["tracks"]["bus"]["state"].pop("heading"),
        lambda content: content.pop("map_features"),
        lambda content: content["metadata"].update(ts=[]),
    ],
)
def test_a_damaged_scenario_is_refused_in_one_line(tmp_path, damage):
    content = scenario()
    damage(content)
    with pytest.raises(InputError, match=r"one\.json\.gz: not a ScenarioNet scenario") as caught:
        read_recording(write_scenario(tmp_path / "one.json.gz", content))
    assert "\n" not in str(caught.value)


def test_a_folder_of_scenarios_is_listed_and_not_read_as_one(tmp_path):
    paths = [write_scenario(tmp_path / f"{name}.json.gz", scenario()) for name in "ab"]
    assert find_recordings(tmp_path) == paths
    with pytest.raises(InputError, match=r"2 recorded drives; give one of a\.json\.gz, b\.json\.gz"):
        read_recording(tmp_path)


def test_what_holds_no_drive_is_refused(tmp_path):
    with pytest.raises(InputError, match="no recorded drive"):
        read_recording(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        read_recording(tmp_path / "absent")
    (tmp_path / "broken.json.gz").write_bytes(b"no gzip")
    with pytest.raises(InputError, match="cannot be read"):
        read_recording(tmp_path / "broken.json.gz")


def straight_lane(name, start, yaw, length=50.0, successors=()):
    distances = np.linspace(0.0, length, 11)
    direction = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    center = np.asarray(start) + distances[:, None] * direction
    lane = lane_around(name, center, 1.8)
    return Lane(name, lane.center, lane.left, lane.right, successors)


@given(yaw=st.floats(-np.pi, np.pi), half_width=st.floats(0.5, 4.0))
def test_a_lane_around_a_line_has_its_borders_to_the_left_and_right(yaw, half_width):
    lane = lane_around("a", straight_lane("a", [3.0, 4.0, 0.0], yaw).center, half_width)
    across = np.array([-np.sin(yaw), np.cos(yaw)])
    np.testing.assert_allclose((lane.left - lane.center)[:, :2] @ across, half_width, atol=1e-9)
    np.testing.assert_allclose((lane.right - lane.center)[:, :2] @ across, -half_width, atol=1e-9)


def test_a_lane_around_a_line_that_folds_back_is_finite():
    lane = lane_around("a", np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 0.0, 0.0]]), 1.8)
    assert np.isfinite(lane.left).all() and np.isfinite(lane.right).all()
    np.testing.assert_allclose(np.linalg.norm(lane.left - lane.center, axis=1), 1.8)


@given(yaw=st.floats(-np.pi, np.pi))
def test_a_route_goes_on_along_the_straightest_successor(yaw):
    end = 50.0 * np.array([np.cos(yaw), np.sin(yaw), 0.0])
    lanes = [
        straight_lane("first", [0.0, 0.0, 0.0], yaw, successors=("bend", "on")),
        straight_lane("bend", end, yaw + 0.4),
        straight_lane("on", end, yaw + 0.1),
        straight_lane("against", end, yaw + np.pi, 80.0),
    ]
    route = route_along(np.linspace(0.0, 0.5, 20)[:, None] * end, yaw, lanes)
    length = np.linalg.norm(np.diff(route[:, :2], axis=0), axis=1).sum()
    assert length == pytest.approx(25.0 + 5.0 + ROUTE_BEYOND, abs=6.0)
    last = route[-1] - route[-2]
    assert abs(np.angle(np.exp(1j * (np.arctan2(last[1], last[0]) - yaw - 0.1)))) < 1e-6


def test_a_route_without_lanes_goes_straight_on_even_from_standstill():
    route = route_along(np.zeros((30, 3)), 0.5, [])
    np.testing.assert_allclose(route, [[0.0, 0.0, 0.0], [400.0 * np.cos(0.5), 400.0 * np.sin(0.5), 0.0]])


def test_lanes_are_linked_where_they_meet_and_agree_in_direction():
    lanes = [
        straight_lane("a", [0.0, 0.0, 0.0], 0.0),
        straight_lane("b", [50.1, 0.0, 0.0], 0.3),
        straight_lane("back", [50.0, 0.0, 0.0], 3.0),
        straight_lane("far", [52.0, 0.0, 0.0], 0.0),
    ]
    assert link_by_place(lanes)[0].successors == ("b",)


def test_edges_have_the_area_to_their_left_and_outlines_are_whole():
    ring = shapely.Polygon([(0, 0), (0, 10), (10, 10), (10, 0)])
    hole = shapely.Polygon([(0, 20), (4, 20), (4, 24), (0, 24)], [[(1, 21), (1, 23), (3, 23), (3, 21)]])
    bow_tie = shapely.Polygon([(20, 0), (24, 4), (24, 0), (20, 4)])
    for line in edges([ring, hole]):
        middle, along = 0.5 * (line[0] + line[1])[:2], (line[1] - line[0])[:2]
        left = middle + 0.01 * np.array([-along[1], along[0]]) / np.linalg.norm(along)
        assert shapely.union(ring, hole).covers(shapely.Point(left))
    assert sum(shapely.Polygon(line[:, :2]).area for line in outlines([ring, bow_tie])) == pytest.approx(108.0)


def test_a_lane_between_borders_of_different_lengths_runs_in_the_middle():
    left, right = np.array([[0.0, 2.0, 1.0], [30.0, 2.0, 1.0]]), np.array([[0.0, -2.0, 0.0], [9, -2, 0], [30, -2, 0.0]])
    lane = lane_between("a", left, right, ())
    np.testing.assert_allclose(lane.center[:, 1:], [[0.0, 0.5]] * len(lane.center))
    assert len(lane.left) == len(lane.right) == len(lane.center) >= 17


def test_headings_of_the_recording_are_kept(sensor_log):
    np.testing.assert_allclose(yaw_of(read_recording(sensor_log).ego.T_world_rig), 0.0)
