"""The JSON format of rollouts: what is read, and what is refused in words."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from olt_closed_loop.commands import app
from olt_closed_loop.rollouts.rollout_files import parse_rollout, read_rollout_file
from olt_closed_loop.scoring.definitions import DEFINITIONS
from olt_generator.errors import InputError

from ...fuzzing import SECONDS


def written(folder, values):
    path = folder / "drive.json"
    path.write_text(json.dumps(values))
    return path


def test_a_file_is_read_as_it_stands(tmp_path, texts):
    agent = texts.agent(np.array([[5.0, 1.0, 0.2, 2.0], [6.0, 1.0, 0.2, 2.5]]), start=3)
    record = read_rollout_file(written(tmp_path, texts.rollout(texts.along_x(), agents={"a": agent})))
    assert (record.name, record.handover_us, len(record.timestamps_us)) == ("drive", 1_700_000, 81)
    np.testing.assert_array_equal(record.agents[0].poses, [[5.0, 1.0, 2.0, 0.2], [6.0, 1.0, 2.5, 0.2]])
    np.testing.assert_array_equal(record.poses[3], [3.0, 0.0, 0.0, 0.0])
    assert len(record.lanes) == 2 and len(record.road_edges) == 2


def test_agents_without_a_height_stand_on_the_ground(texts):
    record = parse_rollout(texts.rollout(texts.along_x(), agents={"a": texts.agent(np.zeros((3, 3)))}), "drive")
    np.testing.assert_array_equal(record.agents[0].poses[:, 2], 0.75)


def test_only_samples_at_times_of_the_ego_count(texts):
    agent = texts.agent(np.zeros((4, 3))) | {"timestamps_us": [0, 150_000, 200_000, 250_000]}
    late = texts.agent(np.zeros((1, 3))) | {"timestamps_us": [50_000]}
    empty = texts.agent(np.zeros((0, 3)))
    agents = {"a": agent, "late": late, "empty": empty}
    record = parse_rollout(texts.rollout(texts.along_x(), agents=agents), "drive")
    assert [(agent.id, agent.timestamps_us.tolist()) for agent in record.agents] == [("a", [0, 200_000])]


@given(spacing=st.floats(0.1, 9.0), resample=st.sampled_from([0.5, 1.0, 2.0]))
def test_lines_get_points_and_keep_their_own(texts, spacing, resample):
    corners = [[0.0, 0.0], [spacing, 0.0], [spacing, 2.0 * spacing]]
    road = {"lanes": [], "road_edges": [corners], "resample_m": resample}
    (edge,) = parse_rollout(texts.rollout(texts.along_x(), map=road), "drive").road_edges
    assert np.linalg.norm(np.diff(edge, axis=0), axis=1).max() <= resample
    for corner in corners:
        assert np.linalg.norm(edge[:, :2] - corner, axis=1).min() < 1e-12
    assert np.linalg.norm(np.diff(edge, axis=0), axis=1).sum() == pytest.approx(3.0 * spacing)


def test_lights_are_red_as_written_and_unknown_where_nothing_is_written(texts):
    values = texts.rollout(texts.along_x())
    values["map"]["lanes"][0]["red_us"] = [[0, 5], [7, 9]]
    assert [lane.red_us is None for lane in parse_rollout(values, "drive").lanes] == [False, True]
    np.testing.assert_array_equal(parse_rollout(values, "drive").lanes[0].red_us, [[0, 5], [7, 9]])
    values["map"]["lanes"][0]["red_us"] = []
    assert parse_rollout(values, "drive").lanes[0].red_us.shape == (0, 2)
    values["map"]["lanes"][0]["red_us"] = [[5, 5]]
    with pytest.raises(InputError, match=r"red_us: a phase ends before it begins"):
        parse_rollout(values, "drive")


def test_resampling_by_zero_leaves_lines_alone(texts):
    road = {"lanes": [], "road_edges": [[[0.0, 0.0], [50.0, 0.0]]], "resample_m": 0}
    (edge,) = parse_rollout(texts.rollout(texts.along_x(), map=road), "drive").road_edges
    assert len(edge) == 2


BROKEN = {
    "times twice": ({"timestamps_us": [0, 0]}, "not after the one before"),
    "no times": ({"timestamps_us": []}, "one or more integer"),
    "times in seconds": ({"timestamps_us": [0.0, 0.1]}, "integer microseconds"),
    "too few poses": ({"timestamps_us": [0, 1, 2]}, "81 rows for 3 times"),
    "no recording": ({"gt": {"timestamps_us": [], "poses": []}}, "gt timestamps_us"),
    "poses that are no rows": ({"gt": {"timestamps_us": [0], "poses": [1.0]}}, "gt poses: give rows"),
    "a pose not finite": ({"gt": {"timestamps_us": [0], "poses": [[0.0, float("nan"), 0.0]]}}, "row 0 is not finite"),
    "a line of one point": ({"map": {"lanes": [], "road_edges": [[[0, 0]]]}}, "road edge has 1 points"),
    "resampling by nothing": ({"map": {"lanes": [], "road_edges": [], "resample_m": -1}}, "resample_m is -1"),
    "agents as a list": ({"agents": [1]}, "another form"),
    "a box without width": ({"agents": {"a": {"length": 1, "width": 0, "height": 1}}}, "sizes must be positive"),
    "an agent seen twice": (
        {"agents": {"a": {"length": 1, "width": 1, "height": 1, "timestamps_us": [5, 5], "poses": [[0, 0, 0]] * 2}}},
        "agent a timestamps_us: time 1",
    ),
    "a pose beyond the map": ({"gt": {"timestamps_us": [0], "poses": [[1e300, 0.0, 0.0]]}}, "1e\\+300 is no place"),
    "a heading in no unit": ({"gt": {"timestamps_us": [0], "poses": [[0.0, 0.0, 1e12]]}}, "1e\\+12 is no place"),
    "a lane beyond the map": ({"map": {"lanes": [], "road_edges": [[[0, 0], [1e30, 0]]]}}, "1e\\+30 is no place"),
    "a box as long as a country": ({"agents": {"a": {"length": 1e6, "width": 1, "height": 1}}}, "at most 10000 m"),
    "nanoseconds": ({"gt": {"timestamps_us": [10**18], "poses": [[0.0] * 3]}}, "is it another unit"),
    "no end of time": ({"render_start_us": 1e30}, "render_start_us is 1e\\+30"),
    "a plan of no time": (
        {"plans": [{"now_us": 10**30, "timestamps_us": [0], "poses": [[0.0] * 3]}]},
        "plan 0: now_us is 1e\\+30",
    ),
}


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_broken_is_refused_in_words(tmp_path, texts, name):
    changes, message = BROKEN[name]
    with pytest.raises(InputError, match=message):
        read_rollout_file(written(tmp_path, texts.rollout(texts.along_x()) | changes))


@pytest.mark.parametrize("field", ["timestamps_us", "ego", "agents", "gt", "plans", "render_start_us"])
def test_a_missing_field_is_named(tmp_path, texts, field):
    values = texts.rollout(texts.along_x())
    del values[field]
    with pytest.raises(InputError, match=field):
        read_rollout_file(written(tmp_path, values))


def test_what_is_not_json_is_refused(tmp_path):
    (tmp_path / "drive.json").write_text("no")
    with pytest.raises(InputError, match="not a JSON file"):
        read_rollout_file(tmp_path / "drive.json")
    with pytest.raises(InputError, match="not a JSON file"):
        read_rollout_file(tmp_path / "absent.json")


@settings(max_examples=12)
@given(seed=st.integers(0, 10_000), definition=st.sampled_from(DEFINITIONS))
def test_the_command_prints_one_object_for_any_rollout(tmp_path_factory, texts, seed, definition):
    path = written(tmp_path_factory.mktemp("rollout"), texts.random(seed))
    result = CliRunner().invoke(app, ["score-rollout", str(path), "--definition", definition, "--json"])
    assert result.exit_code == 0, result.output
    values = json.loads(result.output)
    assert values["definition"] == definition
    if definition == "strict":
        assert values["valid"] and 0.0 <= values["score"] <= 1.0
    else:
        scored = {"score", "progress_score", "failure_reason", "passed"}
        assert set(values["scene"]) in (scored, {"error"})
        assert len(values["raw"]) == (23 if definition == "alpasim@3032e0c" else 25)
        assert values["summary_row"]["score"] == values["scene"].get("score")


def test_alpasim_alone_is_the_version_that_the_output_names(tmp_path, texts):
    path = written(tmp_path, texts.rollout(texts.along_x()))
    arguments = ["score-rollout", str(path), "--definition", "alpasim"]
    assert json.loads(CliRunner().invoke(app, [*arguments, "--json"]).stdout)["definition"] == "alpasim@3032e0c"
    assert "definition alpasim@3032e0c" in CliRunner().invoke(app, arguments).stdout


@pytest.mark.parametrize("change", [{"failure": "the policy raised"}, {"driver_ended": True}])
def test_a_drive_that_the_driver_breaks_off_is_a_failed_row_of_the_challenge(tmp_path, texts, change):
    path = written(tmp_path, texts.rollout(texts.along_x()) | change)
    arguments = ["score-rollout", str(path), "--definition", "alpasim@challenge-2026-09", "--json"]
    values = json.loads(CliRunner().invoke(app, arguments).stdout)
    row = values["summary_row"]
    assert (row["status"], row["passed"], row["score"]) == ("fail", False, 0.0)
    assert row["failure_reason"] == change.get("failure", "the driver ended the session")
    measured = {name for name, value in row["score_metrics"].items() if value is not None}
    assert measured == {"progress_score"} and row["score_metrics"]["progress_score"] == 0.0
    assert values["scene"]["score"] == 0.0 and values["final"] == {}


def test_a_choice_of_another_kind_is_refused(texts):
    with pytest.raises(InputError, match="driver_ended is 1; give bool"):
        parse_rollout(texts.rollout(texts.along_x()) | {"driver_ended": 1}, "drive")


def test_the_command_prints_a_table(tmp_path, texts):
    path = written(tmp_path, texts.rollout(texts.along_x()))
    result = CliRunner().invoke(app, ["score-rollout", str(path)])
    assert result.exit_code == 0 and "definition strict" in result.output and "mean_speed" in result.output


@pytest.fixture
def damaged_drive(tmp_path, texts):
    path = tmp_path / "drive.json"
    agent = texts.agent(texts.along_x(count=9))
    path.write_text(json.dumps(texts.rollout(texts.along_x(count=9), agents={"a": agent})))
    return path


def test_damaged_rollouts_are_read_or_refused_in_words(fuzzer, damaged_drive):
    fuzzer.run("rollout", damaged_drive)


@pytest.mark.slow
def test_damaged_rollouts_for_long(fuzzer, damaged_drive):
    fuzzer.run("rollout", damaged_drive, seconds=SECONDS)
