"""The long-tail suite: how many events, made the same each time, drivable, apart from others; and suites as files."""

import json
from dataclasses import replace

import numpy as np
import pytest
import shapely
from typer.testing import CliRunner

from olt_closed_loop.commands import app
from olt_closed_loop.evaluation.evaluation import load_scene
from olt_closed_loop.evaluation.suite_check import EventCheck, SuiteCheck, check_event, check_suite
from olt_closed_loop.evaluation.suite_table import label_scores, summarize_suite
from olt_closed_loop.scenes.maps.frames import moved
from olt_closed_loop.scenes.maps.lanes import HUMAN
from olt_closed_loop.scenes.procedural import generate_scene
from olt_closed_loop.scenes.scene_file import read_scene, write_scene
from olt_closed_loop.scenes.scene_map import map_of, with_map
from olt_closed_loop.scoring.definitions import RolloutScore
from olt_closed_loop.suite.apart import lane_shape, shared_lanes
from olt_closed_loop.suite.catalogue import CATEGORIES, EVENTS, FACTORS, LONGTAIL
from olt_closed_loop.suite.event import in_mirror
from olt_closed_loop.suite.files import Suite, SuiteScene, built_in_suites, find_suite, read_suite, write_suite
from olt_closed_loop.suite.scenes import make_scene, scene_of
from olt_generator.errors import InputError
from olt_generator.seeds import make_generator

FAST = ("way_taken_from_left", "people_cross_left_turn", "rider_crosses", "closed_lane")


def test_the_53_stand_in_the_papers_proportion():
    counts = [sum(EVENTS[name].category == category for name in LONGTAIL) for category in CATEGORIES]
    assert counts == [24, 6, 17, 6] and len(LONGTAIL) == 53
    assert {entry.category for entry in EVENTS.values()} - set(CATEGORIES) == {
        "animal",
        "debris",
        "cut_in",
        "emergency_vehicle",
        "nominal",
    }


def test_every_factor_is_known_and_held_by_some_event():
    held = {factor for name in LONGTAIL for factor in EVENTS[name].factors}
    assert held == set(FACTORS)


def test_an_event_and_seed_give_the_same_bytes(tmp_path):
    files = []
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        make_scene.__globals__["_make"].cache_clear()
        path = write_scene(make_scene("rider_crosses"), tmp_path / folder / "scene.usdc")
        files.append((path.read_bytes(), path.with_name("scene.looks.usdc").read_bytes()))
    assert files[0] == files[1]
    assert not np.array_equal(make_scene("rider_crosses", 1).route, make_scene("rider_crosses", 2).route)


def test_a_scene_of_the_suite_survives_its_file(tmp_path):
    scene = make_scene("way_taken_from_left")
    read = read_scene(write_scene(scene, tmp_path / "scene.usda"))
    assert (read.name, read.category, read.factors) == (scene.name, scene.category, scene.factors)
    assert [agent.id for agent in read.agents] == [agent.id for agent in scene.agents]
    np.testing.assert_array_equal(read.route, scene.route)


@pytest.mark.parametrize("name", list(EVENTS))
def test_agents_are_told_apart_and_are_there_in_time(name):
    event = EVENTS[name].make(make_generator("suite event", name, 0))
    ids = [agent.id for agent in event.agents]
    assert len(set(ids)) == len(ids)
    for agent in event.agents:
        assert np.isfinite(agent.poses).all() and len(agent.timestamps_us) >= 2
        assert np.all(np.diff(agent.timestamps_us) > 0)


@pytest.mark.parametrize("name", [name for name in LONGTAIL if "human_guided_traffic_control" in EVENTS[name].factors])
def test_whoever_directs_traffic_is_to_be_seen(name):
    """Their arms or sign show stop exactly while the line is held, where there is one."""
    event = EVENTS[name].make(make_generator("suite event", name, 0))
    labels = {agent.label for agent in event.agents}
    assert "person" in labels and ("arm" in labels or {"sign_stop", "sign_go"} <= labels)
    red = [light for light in event.ground.road_map.lights if light.by_hand]
    signs = [agent for agent in event.agents if agent.label == "sign_stop"]
    for light in red:
        for sign in signs:
            assert {light.state_at(int(time_us)) for time_us in sign.timestamps_us} == {"red"}


def test_a_hand_outranks_the_lamp_that_contradicts_it():
    """The ego's light is green while the hand stops it, and red when the hand waves it through; the drive obeys."""
    scene = make_scene("officer_overrules_light")
    hand = next(light for light in scene.lights if light.by_hand and light.id != f"{HUMAN}_others")
    lamp = next(light for light in scene.lights if light.position is not None and set(hand.lanes) <= set(light.lanes))
    let_go = int(hand.timestamps_us[-1])
    assert hand.state_at(0) == "red" and lamp.state_at(0) == "green"
    assert hand.state_at(let_go) == "green" and lamp.state_at(let_go) == lamp.state_at(20_000_000) == "red"
    road_map = map_of(scene)
    assert road_map.light_of(hand.lanes[0]) is hand
    for others in (light for light in scene.lights if light.id == f"{HUMAN}_others"):
        red = [road_map.red_us(lane, 20_000_000) for lane in others.lanes]
        assert len(red) and all(spans is not None and len(spans) == 0 for spans in red)
    line = next(lane for lane in scene.lanes if lane.id == hand.lanes[0]).center[0, :2]
    ahead = (scene.ego.T_world_rig[:, :2, 3] - line) @ (scene.ego.T_world_rig[0, :2, 0])
    assert scene.ego.timestamps_us[ahead > 0.0][0] > let_go
    assert len([light for light in scene.lights if light.position is not None]) == 4


@pytest.mark.parametrize("name", LONGTAIL)
def test_roads_have_what_the_factors_say(name):
    event, factors = EVENTS[name].make(make_generator("suite event", name, 0)), EVENTS[name].factors
    assert (event.hills is not None) is ("hills" in factors)
    lamps = [light for light in event.ground.road_map.lights if light.position is not None]
    assert bool(lamps) is ("traffic_lights" in factors)
    x, y, _ = event.ground.course.locate(event.ground.start, np.array([-20.0, 0.0, 20.0]))
    areas = [shapely.Polygon(outline[:, :2]) for outline in event.ground.road_map.drivable]
    right, left = (
        shapely.LineString([(x[1], y[1]), (x[end], y[end])]).intersection(shapely.union_all(areas)).length
        for end in (0, 2)
    )
    assert (left < right) is ("left_hand_traffic" in factors)


def test_events_lie_on_hills_under_lights_and_in_left_hand_traffic():
    held = [factor for name in LONGTAIL for factor in EVENTS[name].factors]
    assert held.count("hills") >= 3 and held.count("left_hand_traffic") >= 4 and held.count("traffic_lights") >= 3


@pytest.mark.parametrize("name", [name for name in LONGTAIL if "hills" in EVENTS[name].factors])
def test_what_lies_behind_a_crest_stands_on_the_ground(name):
    scene = make_scene(name)
    assert scene.hills is not None
    heights = scene.hills.height(scene.ego.T_world_rig[:, :3, 3])
    np.testing.assert_allclose(scene.ego.T_world_rig[:, 2, 3], heights, atol=1e-9)
    assert np.ptp(heights) > 1.5
    for agent in scene.agents:
        ground = scene.hills.height(agent.poses[:, :3])
        np.testing.assert_allclose(agent.poses[:, 2] - 0.5 * agent.height, ground, atol=1e-6)


def test_arms_in_the_mirror_reach_away_from_the_body():
    make = EVENTS["officer_stops_both_ways"].make
    for maker in (make, in_mirror(make)):
        agents = maker(make_generator("mirror")).agents
        body = next(agent for agent in agents if agent.id == "officer").poses[0]
        for arm in (agent for agent in agents if agent.label == "arm"):
            x, y, _, yaw = arm.poses.T
            outward = np.stack([x, y]) - body[:2, None]
            assert np.all(outward[0] * -np.sin(yaw) + outward[1] * np.cos(yaw) > 0.5)


@pytest.mark.parametrize("name", FAST)
def test_an_event_is_driven_by_who_sees_everything_only(name):
    event = check_event(f"longtail/{name}")
    assert event.solvable and not event.solved_by


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("name", LONGTAIL)
def test_every_event_can_be_driven(name, seed):
    event = check_event(f"longtail/{name}:{seed}")
    assert event.gate == () and event.collided == ()
    assert set(event.privileged.values()) == {1.0}
    assert len(event.solved_by) < 4


def test_roads_are_known_wherever_they_lie():
    scene = generate_scene("nominal", 0)
    elsewhere = with_map(scene, moved(map_of(scene), 1000.0, -500.0, 2.0))
    assert [lane_shape(lane) for lane in elsewhere.lanes] == [lane_shape(lane) for lane in scene.lanes]
    assert len(shared_lanes([scene], [elsewhere])) == len(scene.lanes)
    assert shared_lanes([make_scene("rider_crosses")], [scene]) == []


def test_a_check_finds_roads_that_are_shared():
    result = check_suite(["longtail/rider_crosses"], ["longtail/rider_crosses"])
    assert result.shared and not result.passed
    assert check_suite(["longtail/rider_crosses"], ["nominal:0"]).passed


def event_check(solved: int, score: float = 1.0) -> EventCheck:
    names = ("constant speed", "go straight", "stop", "route")
    baselines = {name: (1.0 if index < solved else 0.0, False) for index, name in enumerate(names)}
    return EventCheck("x", "y", (), {"strict": score}, (), baselines, ())


@pytest.mark.parametrize(
    ("solved", "passes"), [((0, 0, 0, 0, 1), True), ((0, 0, 0, 1, 1), False), ((0, 0, 0, 0, 4), False)]
)
def test_a_suite_is_refused_when_knowing_nothing_is_enough(solved, passes):
    assert SuiteCheck(tuple(event_check(count) for count in solved), (), 0).passed is passes


def test_a_suite_is_refused_when_an_event_cannot_be_driven():
    assert not SuiteCheck((event_check(0), event_check(0, score=0.9)), (), 0).passed


def test_names_of_events_and_seeds_are_checked():
    assert load_scene("longtail/rider_crosses:1").name == "longtail_rider_crosses_1"
    for source, complaint in (("longtail/nothing", "is not one of"), ("longtail/rider_crosses:x", "no seed")):
        with pytest.raises(InputError, match=complaint):
            scene_of(source)


def score(scene: str, value: float | None, collided: bool | None = False) -> RolloutScore:
    return RolloutScore(scene, "own", "policy", 0, valid=value is not None, score=value, collided=collided)


def test_a_table_has_rows_by_category_and_factor_and_counts_weights():
    suite = Suite("mine", (SuiteScene("a", 3.0, "first", ("wet",)), SuiteScene("b", 1.0, "second", ("wet", "dark"))))
    scores = [score("a", 1.0), score("a", 1.0), score("b", 0.0, True), score("b", None, None)]
    table = summarize_suite(suite, scores)
    assert [row.category for row in table.categories.rows] == ["first", "second", "overall"]
    factors = {row.category: (row.rollouts, row.alpasim_score) for row in table.factors}
    assert factors == {"dark": (2, 0.0), "wet": (4, pytest.approx(2 / 3))}
    assert table.weighted_score == pytest.approx(6 / 7) and table.weighted_collision_rate == pytest.approx(1 / 7)
    assert [one.category for one in label_scores(suite, scores)] == ["first", "first", "second", "second"]


def test_a_suites_file_is_read_as_it_was_written(tmp_path):
    suite = built_in_suites()["longtail"]
    suite = replace(suite, scenes=(*suite.scenes[:3], SuiteScene("nominal:3", 2.5)))
    write_suite(suite, tmp_path / "suite.yaml")
    assert read_suite(tmp_path / "suite.yaml") == suite
    assert find_suite("longtail").sources == [f"longtail/{name}" for name in LONGTAIL]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("[]", "is a mapping"),
        ("scenes: []", "list of 1"),
        ("scenes: [nominal:0]", "scene 0: give a mapping"),
        ("scenes: [{scene: 3}]", "scene is 3"),
        ("scenes: [{scene: nominal:0, weight: 0}]", "weight is 0"),
        ("scenes: [{scene: nominal:0, weight: .inf}]", "weight is inf"),
        ("scenes: [{scene: nominal:0, weight: true}]", "weight is True"),
        ("scenes: [{scene: nominal:0, factors: wet}]", "factors is"),
        ("scenes: [{scene: nominal:0, categories: x}]", "categories"),
        ("scenes: [{scene: nominal:0}, {scene: nominal:0}]", "comes twice"),
        ("scenes: [{scene: longtail/nothing}]", "is not one of"),
        ("{name: [1], scenes: [{scene: nominal:0}]}", "name is"),
    ],
)
def test_a_file_that_is_no_suite_is_refused_in_words(tmp_path, text, complaint):
    path = tmp_path / "suite.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=complaint):
        read_suite(path)


def test_the_commands_list_make_check_and_run(tmp_path):
    runner, only = CliRunner(), ["--only", "rider_crosses"]
    listed = runner.invoke(app, ["suite", "list", "cyclists"])
    assert listed.exit_code == 0 and "longtail/rider_crosses" in listed.output
    made = runner.invoke(app, ["suite", "make", "longtail", "--out", str(tmp_path), *only])
    assert made.exit_code == 0, made.output
    options = ["--apart-from", "nominal:0", "--seeds", "2", "--workers", "1", "--json"]
    checked = runner.invoke(app, ["suite", "check", *only, *options])
    assert checked.exit_code == 0, checked.output
    sources = [event["source"] for event in json.loads(checked.stdout)["events"]]
    assert sources == ["longtail/rider_crosses:0", "longtail/rider_crosses:1"]
    options = ["--suite", str(tmp_path / "suite.yaml"), "--policy", "privileged", "--rollouts", "1", "--workers", "1"]
    driven = runner.invoke(app, ["run", *options, "--no-baselines"])
    assert driven.exit_code == 0, driven.output
    assert "by factor" in driven.output and "AS 1.000, CR 0.000" in driven.output
    assert runner.invoke(app, ["run", "nominal:0", "--suite", "longtail"]).exit_code == 2
