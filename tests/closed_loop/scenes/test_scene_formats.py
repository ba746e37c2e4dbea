"""CommonRoad, OpenDRIVE, OpenSCENARIO, Waymo motion and NuRec: what a scene has of what a file says."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_closed_loop.evaluation.evaluation import find_scenes, load_scene
from olt_closed_loop.evaluation.gate import check_gate
from olt_closed_loop.scenes.scene_file import read_scene, write_scene
from olt_closed_loop.scenes.sources import find_recordings, read_recording
from olt_closed_loop.scenes.sources.opendrive import LaneKey, parse_road_network
from olt_closed_loop.scenes.sources.opendrive_lines import Clothoid
from olt_closed_loop.scenes.sources.openscenario.parameters import evaluate, substitute
from olt_generator.errors import InputError
from olt_generator.poses import yaw_of

from . import written_scenes as written
from .recordings import write_scenario
from .test_scene_sources import scenario

SOON = written.trigger(written.after("1"))
ENDINGS = ("xml", "xodr", "xosc", "tfrecord", "usdz")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return written.write_all(tmp_path_factory.mktemp("written"))


@pytest.fixture(scope="module", params=ENDINGS)
def scene(request, files):
    return read_recording(files[request.param])


def lane_of(scene, name):
    return next(lane for lane in scene.lanes if lane.id == name)


def agent_of(scene, name):
    return next(agent for agent in scene.agents if agent.id == name)


def test_the_gate_holds(scene):
    result = check_gate(scene)
    assert result.passed, result.failed


def test_the_ego_begins_at_the_origin_and_drives_along_its_heading(scene):
    np.testing.assert_allclose(scene.ego.positions[0], 0.0, atol=1e-9)
    assert np.linalg.norm(scene.ego.positions[-1]) > 50.0
    ways = np.diff(scene.ego.positions[:50], axis=0)
    ahead = scene.ego.T_world_rig[:49, :3, 0]
    np.testing.assert_allclose(np.einsum("ni,ni->n", ways, ahead), np.linalg.norm(ways, axis=1), rtol=1e-9)


def test_a_scene_file_keeps_it(scene, tmp_path):
    again = read_scene(write_scene(scene, tmp_path / "scene.usdc"))
    for kind in ("lanes", "agents", "stop_lines", "crossings", "lights", "assumptions"):
        kept, wanted = getattr(again, kind), getattr(scene, kind)
        assert [getattr(one, "id", one) for one in kept] == [getattr(one, "id", one) for one in wanted]
    assert [lane.left_marking for lane in again.lanes] == [lane.left_marking for lane in scene.lanes]
    assert check_gate(again).checks == check_gate(scene).checks


def test_borders_are_on_their_sides_and_lanes_end_where_others_begin(scene):
    by_id = {lane.id: lane for lane in scene.lanes}
    for lane in scene.lanes:
        ahead = lane.center[1, :2] - lane.center[0, :2]
        to_left = lane.left[0, :2] - lane.right[0, :2]
        assert ahead[0] * to_left[1] - ahead[1] * to_left[0] > 0.0
        for name in lane.successors:
            np.testing.assert_allclose(by_id[name].center[0], lane.center[-1], atol=1e-6)


# CommonRoad


def test_commonroad(files):
    scene = read_recording(files["xml"])
    assert scene.name == "commonroad_ZAM_Test-1_1_T-1_10"
    truck = agent_of(scene, "11")
    assert (truck.label, truck.length, truck.width) == ("heavy_truck", 8.0, 2.4)
    # The rear axle is behind the recorded middle of the box.
    np.testing.assert_allclose(truck.poses[0, :2], [10.0 + scene.vehicle.rear_axle_to_bbox_center, 4.0], atol=1e-9)
    lane = lane_of(scene, "1")
    assert (lane.successors, lane.left_neighbours, lane.right_neighbours) == (("2",), ("3",), ())
    assert (lane.left_marking.pattern, lane.right_marking.crossable, lane.type) == ("dashed", False, "driving")
    (line,), (light,) = scene.stop_lines, scene.lights
    assert (line.lanes, line.control, light.lanes) == (("1",), "light", ("2",))
    # Red for 2 s and green for 3 s from 1 s on, again and again.
    assert [light.state_at(round(1e6 * time)) for time in (0.5, 1.5, 3.5, 5.9)] == ["green", "red", "green", "green"]


def test_who_is_the_ego_of_a_commonroad_scenario(files):
    with pytest.raises(InputError, match="obstacle 11 is no car that moves; the cars are 10"):
        load_scene(f"{files['xml']}#11")
    assert load_scene(f"{files['xml']}#10").name.endswith("_10")


def test_a_car_that_is_no_ego_is_refused(files):
    with pytest.raises(InputError, match="obstacle 12 is no car that moves"):
        read_recording(files["xml"].with_name("one.xml#12"))


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ('commonRoadVersion="2020a"', 'commonRoadVersion="2017a"', "commonRoadVersion 2017a"),
        ('timeStepSize="0.1"', 'timeStepSize="1.0"', "timeStepSize of 1 s"),
        ('timeStepSize="0.1"', 'timeStepSize="nan"', "timeStepSize is 'nan'"),
        ("<x>10.0</x>", "<x>1e999</x>", "obstacle 10: point x is '1e999'"),
        ("<type>car</type>", "<type>tank</type>", "obstacle 10: type tank"),
        ('<dynamicObstacle id="11">', '<dynamicObstacle id="10">', "two obstacles of one id"),
        ("<rectangle>", "<polygon><rectangle></rectangle></polygon><rectangle>", "a shape of 2 parts"),
        ("<width>1.8</width>", "<width>0</width>", "obstacle 10: a box of 4.5 x 0 m"),
    ],
)
def test_what_is_wrong_with_a_commonroad_scenario_is_named(tmp_path, old, new, named):
    content = written.commonroad()
    assert old in content
    path = tmp_path / "one.xml"
    path.write_text(content.replace(old, new))
    with pytest.raises(InputError, match=named) as caught:
        check_gate(read_recording(path))
    assert str(path) in str(caught.value)


# OpenDRIVE


def test_opendrive_lanes(files):
    scene = read_recording(files["xodr"])
    lane = lane_of(scene, "1:0:-1")
    assert lane.successors == ("4:0:-1", "5:0:-1")
    assert (lane.left_neighbours, lane.right_neighbours) == (("1:0:1",), ("1:0:-2",))
    assert (lane.left_marking.pattern, lane.right_marking.pattern) == ("solid", "dashed")
    assert (lane.junction, lane_of(scene, "5:0:-1").junction) == (None, "7")
    assert lane.speed_limit == pytest.approx(50.0 / 3.6)
    assert lane_of(scene, "1:0:1").center[0, 0] > lane_of(scene, "1:0:1").center[-1, 0]


def test_left_hand_traffic_is_the_mirror_image():
    right, left = (parse_road_network(written.opendrive(rule).encode(), "it").lanes()[0] for rule in ("RHT", "LHT"))
    for one, other in zip(right, left, strict=True):
        np.testing.assert_allclose(one.center, other.center[::-1], atol=1e-9)
        np.testing.assert_allclose(one.left, other.right[::-1], atol=1e-9)
        assert one.left_marking == other.right_marking


@given(st.floats(-0.2, 0.2), st.floats(-0.01, 0.01), st.floats(0.5, 40.0))
def test_clothoids_follow_their_curvature(curvature, change, length):
    s = np.linspace(0.0, length, 2001)
    u, v, turned = Clothoid(curvature, change).at(s)
    np.testing.assert_allclose(np.hypot(np.diff(u), np.diff(v)), length / 2000, rtol=2e-5)  # a chord is shorter
    np.testing.assert_allclose(turned[-1], curvature * length + 0.5 * change * length**2, atol=1e-9)
    middle = 0.5 * (turned[1:] + turned[:-1])
    np.testing.assert_allclose(np.diff(u), np.cos(middle) * length / 2000, atol=1e-6)
    np.testing.assert_allclose(np.diff(v), np.sin(middle) * length / 2000, atol=1e-6)


def test_an_arc_of_four_metres_far_from_the_origin():
    quarter = 2.0 * np.pi
    road = written.road(
        "1",
        written.geometry(1e6, -1e6, np.pi - 0.01, quarter, '<arc curvature="0.25"/>'),
        quarter,
        "",
        "",
        written.lane(-1),
    )
    network = parse_road_network(f"<OpenDRIVE>{road}</OpenDRIVE>".encode(), "it")
    center = network.lanes()[0][0].center[:, :2]
    middle = np.array([1e6, -1e6]) + 4.0 * np.array([-np.sin(np.pi - 0.01), np.cos(np.pi - 0.01)])
    np.testing.assert_allclose(np.linalg.norm(center - middle, axis=1), 6.0, atol=1e-8)


def test_lanes_that_do_not_meet_are_not_linked():
    content = written.opendrive().replace('x="350" y="0" hdg="0" length="30"', 'x="350" y="9" hdg="0" length="30"')
    network = parse_road_network(content.encode(), "it")
    assert network.following(LaneKey("1", 0, -1)) == (LaneKey("5", 0, -1),)


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("<line/>", "<poly3 a='0' b='0' c='0' d='0'/>", "road 1: geometry <poly3> is not read"),
        ('curvature="0.05"', 'curvature="9"', "turns more than four times"),
        ('rule="RHT"', 'rule="up"', "rule up"),
        ('length="400"', 'length="1e7"', "length 1e\\+07"),
        ('length="400"', 'length="-1"', "road 1"),
        ('<laneSection s="0">', '<laneSection s="5">', "lane sections"),
        ('<lane id="-1"', '<lane id="1"', "on the wrong side"),
        ('unit="km/h"', 'unit="knots"', "a speed in knots"),
    ],
)
def test_what_is_wrong_with_a_road_network_is_named(tmp_path, old, new, named):
    content = written.opendrive()
    assert old in content
    path = tmp_path / "one.xodr"
    path.write_text(content.replace(old, new, 1) if "curvature" not in old else content.replace(old, new))
    with pytest.raises(InputError, match=named) as caught:
        read_recording(path)
    assert str(path) in str(caught.value)


# OpenSCENARIO


def test_a_cut_in(files):
    scene = read_recording(files["xosc"])
    (other,) = scene.agents
    times = other.timestamps_us * 1e-6
    y = other.poses[:, 1] - 1.4 * np.sin(other.poses[:, 3])  # of the rear axle
    np.testing.assert_allclose(y[times <= 2.0], -4.0, atol=1e-9)
    np.testing.assert_allclose(y[times >= 4.2], 0.0, atol=1e-9)
    # Half of a sinusoid over 2 s, which begins in the step after 2 s.
    changing = (times > 2.1) & (times < 4.0)
    begun = 2.05
    np.testing.assert_allclose(y[changing], -2.0 - 2.0 * np.cos(np.pi * (times[changing] - begun) / 2.0), atol=0.02)
    np.testing.assert_allclose(other.poses[0, 0], 20.0 + 1.4, atol=1e-9)
    assert other.poses[changing, 3].max() > 0.2
    np.testing.assert_allclose(np.diff(scene.ego.positions[:, 0]), 1.0, atol=1e-9)


def carried_out(tmp_path, events, **changes):
    scene = read_recording(written.write_openscenario(tmp_path, events=events, **changes))
    return scene, scene.agents[0]


def speeds(agent):
    return np.diff(agent.poses[:, 0]) / 0.1


def test_braking_at_a_rate_after_a_delay(tmp_path):
    target = '<AbsoluteTargetSpeed value="4"/>'
    action = written.speed_action(target, "linear", "rate", "3")
    events = written.event("brake", action, written.trigger(written.after("1"), delay="0.5"))
    _, other = carried_out(tmp_path, events)
    found = speeds(other)
    np.testing.assert_allclose(found[:15], 10.0, atol=1e-6)
    np.testing.assert_allclose(np.diff(found[17:33]), -0.3, atol=0.01)
    np.testing.assert_allclose(found[40:], 4.0, atol=1e-6)


def test_an_event_after_another(tmp_path):
    done = (
        '<ByValueCondition><StoryboardElementStateCondition storyboardElementType="action" '
        'storyboardElementRef="cut in action" state="completeState"/></ByValueCondition>'
    )
    stop = written.speed_action('<AbsoluteTargetSpeed value="2"/>')
    events = written.CUT_IN + written.event("slow", stop, written.trigger(done, edge="rising"))
    _, other = carried_out(tmp_path, events)
    found = speeds(other)
    np.testing.assert_allclose(found[:38], 10.0, atol=0.2)  # of the box, which turns
    np.testing.assert_allclose(found[45:], 2.0, atol=1e-6)


@pytest.mark.parametrize(
    ("condition", "first_metres"),
    [
        ('<TraveledDistanceCondition value="30"/>', 30.0),
        (
            '<RelativeDistanceCondition entityRef="Other" relativeDistanceType="longitudinal" value="20.5" '
            'freespace="false" rule="lessThan"/>',
            0.0,
        ),
        ('<SpeedCondition value="9" rule="greaterThan"/>', 0.0),
        ('<TimeHeadwayCondition entityRef="Other" value="2.1" freespace="false" rule="lessThan"/>', 0.0),
        (
            '<ReachPositionCondition tolerance="1"><Position><LanePosition roadId="1" laneId="-1" s="90"/></Position>'
            "</ReachPositionCondition>",
            39.0,
        ),
    ],
)
def test_conditions_on_the_ego(tmp_path, condition, first_metres):
    stop = written.speed_action('<AbsoluteTargetSpeed value="0"/>')
    start = written.trigger(written.by_entity("Ego", condition), edge="none")
    _, other = carried_out(tmp_path, written.event("stop", stop, start))
    travelled = other.poses[-1, 0] - other.poses[0, 0]
    assert first_metres <= travelled <= first_metres + 1.6


def test_a_walk_along_a_trajectory(tmp_path):
    vertices = "".join(
        f'<Vertex time="{time}"><Position><WorldPosition x="{x}" y="{y}"/></Position></Vertex>'
        for time, x, y in ((0, 20.0, -2.0), (4, 20.0, 6.0))
    )
    follow = written.private(
        "<RoutingAction><FollowTrajectoryAction><Trajectory name='t' closed='false'><Shape><Polyline>"
        f"{vertices}</Polyline></Shape></Trajectory><TimeReference><Timing domainAbsoluteRelative='relative' scale='1'"
        " offset='0'/></TimeReference><TrajectoryFollowingMode followingMode='position'/></FollowTrajectoryAction>"
        "</RoutingAction>"
    )
    _, other = carried_out(tmp_path, written.event("walk", follow, SOON), stop="9")
    there = other.timestamps_us >= 1_300_000
    y = other.poses[there, 1][:30]
    np.testing.assert_allclose(np.diff(y), 0.2, atol=1e-6)
    np.testing.assert_allclose(other.poses[-20:, 1] - other.poses[-1, 1], 0.0, atol=1e-9)
    np.testing.assert_allclose(other.poses[there, 3][:30], np.pi / 2.0, atol=1e-6)


def test_the_way_at_a_fork_is_the_straight_one(tmp_path):
    scene, _ = carried_out(tmp_path, "", stop="45")
    assert scene.ego.path_length == pytest.approx(450.0, abs=1.0)
    np.testing.assert_allclose(scene.ego.positions[:, 1], 0.0, atol=1e-6)


def test_an_assigned_route_leads_to_the_left(tmp_path):
    waypoints = "".join(
        f'<Waypoint routeStrategy="shortest"><Position><LanePosition roadId="{road}" laneId="-1" s="10"/></Position>'
        "</Waypoint>"
        for road in ("1", "3")
    )
    assign = written.private(
        f"<RoutingAction><AssignRouteAction><Route name='r' closed='false'>{waypoints}</Route></AssignRouteAction>"
        "</RoutingAction>"
    )
    route = f'<Private entityRef="Ego">{assign}</Private>'
    scene, _ = carried_out(tmp_path, "", stop="40", init=route)
    assert yaw_of(scene.ego.T_world_rig[-1]) == pytest.approx(np.pi / 2.0, abs=1e-6)


@pytest.mark.parametrize(
    ("events", "named"),
    [
        (written.event("e", written.private("<VisibilityAction/>"), ""), "<VisibilityAction> is not read as an action"),
        (
            written.event("e", "<GlobalAction/>", SOON),
            "event e: <GlobalAction> is not read",
        ),
        (
            written.event("e", "<PrivateAction/>", written.trigger(written.by_entity("Ego", "<OffroadCondition/>"))),
            "condition one: <OffroadCondition> is not read",
        ),
        (
            written.event("e", written.teleport("<RoadPosition/>"), SOON),
            "<RoadPosition> is not read as a position",
        ),
        (
            written.event("e", written.lane_change('<AbsoluteTargetLane value="-7"/>'), SOON),
            "road 1 has no lane -7",
        ),
        (
            written.event("e", written.speed_action('<AbsoluteTargetSpeed value="$Nobody"/>'), ""),
            "parameter \\$Nobody is not declared",
        ),
        (
            written.event("e", written.speed_action('<AbsoluteTargetSpeed value="${1 / 0}"/>'), ""),
            "cannot be evaluated",
        ),
        (
            written.event("e", written.speed_action('<AbsoluteTargetSpeed value="-3"/>'), SOON),
            "driving backwards",
        ),
    ],
)
def test_what_is_not_read_of_a_scenario_is_named(tmp_path, events, named):
    with pytest.raises(InputError, match=named):
        carried_out(tmp_path, events)


@pytest.mark.parametrize("roads", ["/etc/roads.xodr", "C:\\roads.xodr", "file:///roads.xodr", "roads.txt"])
def test_roads_elsewhere_are_refused(tmp_path, roads):
    with pytest.raises(InputError, match=r"is not relative to the scenario|is no OpenDRIVE file"):
        carried_out(tmp_path, "", roads=roads)


@given(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(0.1, 1e3))
def test_expressions(a, b, c):
    values = {"a": repr(a), "b": repr(b), "c": repr(c)}
    assert evaluate("-$a + 2 * ($b - $c) / $c", values) == pytest.approx(-a + 2.0 * (b - c) / c)
    assert evaluate("sqrt($a * $a)", values) == pytest.approx(abs(a))
    assert substitute("$a", values) == repr(a)


@pytest.mark.parametrize(
    "expression",
    ["__import__('os')", "(1).__class__", "9**9**9", "[1]*9", "'a'*9", "1 if 1 else 2", "(" * 250, "pow(9e9, 9e9)"],
)
def test_expressions_are_arithmetic_alone(expression):
    with pytest.raises(InputError):
        evaluate(expression, {})


# Waymo


def test_waymo(files):
    scene = read_recording(files["tfrecord"])
    assert [agent.id for agent in scene.agents] == ["0", "0#2"]
    assert any("away for more than" in note for note in scene.assumptions)
    assert scene.vehicle.length == pytest.approx(4.68)
    np.testing.assert_allclose(scene.agents[0].poses[0, :2], [1.5, 3.7], atol=1e-6)
    lane = lane_of(scene, "5")
    assert (lane.left_neighbours, lane.left_marking.pattern, lane.type) == (("6",), "dashed", "driving")
    assert lane.speed_limit == pytest.approx(11.176)
    (light,), (crossing,) = scene.lights, scene.crossings
    assert (light.state_at(1_000_000), light.state_at(3_000_000), light.lanes) == ("red", "green", ("5",))
    area = np.roll(crossing.outline[:, 0], -1) * crossing.outline[:, 1]
    assert np.sum(crossing.outline[:, 0] * np.roll(crossing.outline[:, 1], -1) - area) > 0.0


def test_a_file_of_many_scenarios(tmp_path):
    path = written.write_waymo(tmp_path / "training.tfrecord-00000-of-01000", "abc", "def")
    assert [found.name.partition("#")[2] for found in find_recordings(path)] == ["abc", "def"]
    assert find_scenes([str(path)]) == find_scenes([str(tmp_path)]) == [f"{path}#abc", f"{path}#def"]
    assert load_scene(f"{path}#def").name == "waymo_def"
    with pytest.raises(InputError, match="holds 2 recorded drives"):
        read_recording(path)
    with pytest.raises(InputError, match="holds 0 scenarios of id xyz"):
        load_scene(f"{path}#xyz")


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda scenario: scenario.timestamps_seconds.__setitem__(5, float("nan")), "timestamps_seconds"),
        (lambda scenario: scenario.timestamps_seconds.__setitem__(5, 0.0), "is before the one before it"),
        (lambda scenario: setattr(scenario, "sdc_track_index", 9), "sdc_track_index 9"),
        (lambda scenario: scenario.tracks[1].states.pop(), "has 59 states for 60 times"),
        (lambda scenario: setattr(scenario.tracks[0].states[3], "center_x", float("nan")), "track 0: row 3"),
        (lambda scenario: setattr(scenario.tracks[0].states[3], "center_x", 1e300), "track 0: row 3"),
        (lambda scenario: setattr(scenario.map_features[1], "id", 5), "two lanes of one id"),
        (lambda scenario: setattr(scenario, "scenario_id", b""), "has no scenario_id"),
    ],
)
def test_what_is_wrong_with_a_waymo_scenario_is_named(tmp_path, change, named):
    scenario = written.waymo_scenario()
    change(scenario)
    path = written.write_records(tmp_path / "one.tfrecord", scenario.SerializeToString())
    with pytest.raises(InputError, match=named):
        read_recording(path)


def test_a_waymo_scenario_of_scenarionet(tmp_path):
    content = scenario()
    nuscenes = read_recording(write_scenario(tmp_path / "one.json.gz", content))
    content["metadata"]["dataset"] = "waymo"
    waymo = read_recording(write_scenario(tmp_path / "two.json.gz", content))
    assert waymo.name.startswith("waymo_") and waymo.vehicle.wheelbase == 2.99
    # The recorded position is that of the middle of the box, so the ego's axle is behind that of nuScenes' ego.
    ahead = waymo.agents[0].poses[0, :2] - nuscenes.agents[0].poses[0, :2]
    assert np.linalg.norm(ahead) == pytest.approx(waymo.vehicle.rear_axle_to_bbox_center)


# NuRec


def test_nurec(files):
    scene = read_recording(files["usdz"])
    (other,) = scene.agents
    assert (scene.name, other.id, other.label) == ("nurec_clipgt-test", "7", "automobile")
    np.testing.assert_allclose(other.poses[0], [12.0, 4.0, 0.75, 0.0], atol=1e-9)
    assert (scene.vehicle.length, scene.vehicle.rear_axle_to_bbox_center) == (4.8, 1.4)
    assert lane_of(scene, "1").successors == ("2",)
    (line,) = scene.stop_lines
    assert (line.lanes, line.control) == (("1",), "stop")


def changed_rigs(change):
    members = written.nurec_members()
    rigs = json.loads(members["rig_trajectories.json"])
    change(rigs)
    return members | {"rig_trajectories.json": json.dumps(rigs).encode()}


def test_both_names_of_the_package(tmp_path):
    path = written.write_nurec(
        tmp_path / "one.usdz", changed_rigs(lambda rigs: rigs.update(world_to_nurec=rigs.pop("world_to_nre")))
    )
    assert read_recording(path).name == "nurec_clipgt-test"


def test_without_a_map_leaving_the_road_is_not_measured(tmp_path):
    members = {name: content for name, content in written.nurec_members().items() if "parquet" not in name}
    scene = read_recording(written.write_nurec(tmp_path / "one.usdz", members))
    assert scene.drivable == () and any("is not measured" in note for note in scene.assumptions)


def test_a_map_of_opendrive_is_brought_to_its_place_on_earth(tmp_path):
    """At the equator and the prime meridian, east is y and north is z of the earth-centred frame."""
    T_earth_map = np.eye(4)
    T_earth_map[:3, :3] = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    T_earth_map[0, 3] = 6_378_137.0
    T_map_world = np.eye(4)
    T_map_world[:2, 3] = -7.0, 2.0
    header = '<header revMajor="1" revMinor="6"><geoReference>+proj=tmerc +lat_0=0 +lon_0=0</geoReference></header>'
    roads = written.opendrive().replace('<header revMajor="1" revMinor="6"/>', header)
    members = changed_rigs(lambda rigs: rigs.update(T_world_base=(T_earth_map @ T_map_world).tolist()))
    members = {name: content for name, content in members.items() if "parquet" not in name}
    scene = read_recording(written.write_nurec(tmp_path / "one.usdz", members | {"map.xodr": roads.encode()}))
    np.testing.assert_allclose(lane_of(scene, "1:0:-1").center[0], [-43.0, -4.0, 0.0], atol=1e-6)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda rigs: rigs.pop("world_to_nre"), "world_to_nre or world_to_nurec is missing"),
        (lambda rigs: rigs["rig_trajectories"].append({}), "2 trajectories"),
        (lambda rigs: rigs["rig_trajectories"][0]["T_rig_worlds"].pop(), "T_rig_worlds is"),
        (lambda rigs: rigs["rig_trajectories"][0]["T_rig_worlds"][3][0].__setitem__(3, float("nan")), "T_rig_worlds"),
        (lambda rigs: rigs["rig_trajectories"][0]["T_rig_worlds"][3][0].__setitem__(0, -1.0), "no rotation"),
        (lambda rigs: rigs["rig_trajectories"][0]["T_rig_world_timestamps_us"].__setitem__(3, 1), "time 3"),
        (lambda rigs: rigs["rig_trajectories"][0]["rig_bbox"].update(rot=[0, 0, 1]), "rig_bbox: is turned"),
    ],
)
def test_what_is_wrong_with_a_nurec_scene_is_named(tmp_path, change, named):
    path = written.write_nurec(tmp_path / "one.usdz", changed_rigs(change))
    with pytest.raises(InputError, match=named):
        read_recording(path)
