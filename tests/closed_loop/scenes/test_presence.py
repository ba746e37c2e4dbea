"""Who is there when: gaps, jumps, times and places of recorded drives, and what of them is refused."""

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pyarrow import feather, parquet

from olt_closed_loop.evaluation.gate import check_gate
from olt_closed_loop.scenes.looks import generate_looks
from olt_closed_loop.scenes.sources import find_recordings, read_recording
from olt_closed_loop.scenes.sources.tracks import MOST_GAP_US
from olt_closed_loop.scoring.definitions import score_rollout
from olt_closed_loop.simulation.closed_loop import replay
from olt_generator.errors import InputError

from .recordings import SPEED, STEPS, scenario, write_motion_scenario, write_scenario, write_sensor_log

STEP_US = 100_000
FEW = settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def read(tmp_path, content):
    return read_recording(write_scenario(tmp_path / "one.json.gz", content))


def state_of(content, name):
    return content["tracks"][name]["state"]


def absent(content, name, steps):
    """Steps that are padded with zeros and not valid."""
    state = state_of(content, name)
    for step in steps:
        state["valid"][step], state["heading"][step], state["position"][step] = 0, 0.0, [0.0, 0.0, 0.0]


def test_steps_without_an_ego_are_no_poses(tmp_path):
    content = scenario()
    absent(content, "ego", [0, 1, 20, 21, 22, STEPS - 1])
    scene = read(tmp_path, content)
    assert len(scene.ego) == STEPS - 6
    assert scene.ego.path_length == pytest.approx(SPEED * 0.1 * (STEPS - 4))
    np.testing.assert_allclose(scene.ego.positions[:, 0], SPEED * scene.ego.times, atol=1e-9)
    assert any(text.startswith(f"6 of {STEPS} steps of the ego: not valid") for text in scene.assumptions)
    # The bus, from step 10 on, keeps its place and time.
    np.testing.assert_allclose(scene.agents[0].poses[:, 0], 60.0 - SPEED * 0.2)
    assert scene.agents[0].timestamps_us[0] == 8 * STEP_US


def test_of_a_drive_with_a_long_gap_the_longest_stretch_is_kept(tmp_path):
    content = scenario()
    absent(content, "ego", range(15, 25))
    scene = read(tmp_path, content)
    np.testing.assert_array_equal(scene.ego.timestamps_us, STEP_US * np.arange(STEPS - 25))
    assert any("only 2.5 to 5.9 s of the recording" in text for text in scene.assumptions)


def test_padding_that_is_called_valid_is_refused(tmp_path):
    content = scenario()
    absent(content, "ego", [20])
    state_of(content, "ego")["valid"][20] = 1
    with pytest.raises(
        InputError, match=r"one\.json\.gz: .*track ego: the ego moves 1132 m in the 0\.10 s before 2\.00"
    ):
        read(tmp_path, content)


@pytest.mark.parametrize("valid", [[0] * STEPS, [0] * 30 + [1] + [0] * (STEPS - 31)])
def test_an_ego_that_is_hardly_ever_valid_is_refused(tmp_path, valid):
    content = scenario()
    state_of(content, "ego")["valid"] = valid
    with pytest.raises(InputError, match=r"track ego.* valid"):
        read(tmp_path, content)


@FEW
@given(first=st.integers(12, 30), gap=st.integers(1, 20))
def test_an_agent_that_is_away_for_longer_than_the_gap_is_another_one(tmp_path, first, gap):
    content = scenario()
    absent(content, "bus", range(first, first + gap))
    agents = read(tmp_path, content).agents
    assert [agent.id for agent in agents] == (["bus", "bus#2"] if (gap + 1) * STEP_US > MOST_GAP_US else ["bus"])
    kept = np.setdiff1d(np.arange(10, STEPS), np.arange(first, first + gap))
    np.testing.assert_array_equal(np.concatenate([agent.timestamps_us for agent in agents]), STEP_US * kept)


def test_no_ghost_drives_through_the_ego(tmp_path):
    """The bus goes from one side of the street to the other; on the line between, it would meet the ego."""
    content = scenario()
    state = state_of(content, "bus")
    for step in range(STEPS):
        state["position"][step] = [1020.0, 508.0 if step < 20 else 492.0, 0.0]
    absent(content, "bus", range(20, 32))
    scene = read(tmp_path, content)
    score = score_rollout(scene, replay(scene))
    assert [agent.id for agent in scene.agents] == ["bus", "bus#2"] and not score.collided
    assert any("1 agents (bus) are away for more than 0.5 s or jump" in text for text in scene.assumptions)
    colors = generate_looks(scene).agent_colors
    assert colors["bus"] == colors["bus#2"]


def test_a_jump_is_no_motion(tmp_path):
    content = scenario()
    for step in range(30, STEPS):
        state_of(content, "bus")["position"][step][1] += 15.0
    assert [len(agent.poses) for agent in read(tmp_path, content).agents] == [20, 30]


def test_an_agent_that_is_never_valid_is_left_out_and_named(tmp_path):
    content = scenario()
    absent(content, "bus", range(STEPS))
    state_of(content, "bus")["position"][3] = [float("nan")] * 3
    scene = read(tmp_path, content)
    assert scene.agents == () and "1 of 1 agents (bus): valid at no time of the drive" in scene.assumptions


def change_state(field, step, value):
    def change(content):
        state_of(content, "bus")[field][step] = value

    return change


def change_all(name, field, values):
    def change(content):
        state_of(content, name)[field] = values

    return change


def change_times(times):
    def change(content):
        content["metadata"]["ts"] = times.tolist()

    return change


def change_map(**feature):
    def change(content):
        content["map_features"]["with area"].update(feature)

    return change


TIMES = 0.1 * np.arange(STEPS)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (change_state("position", 20, [float("nan"), 0.0, 0.0]), r"track bus is valid at 2\.00 s, .* nan, 0"),
        (change_state("heading", 20, None), r"track bus is valid at 2\.00 s"),
        (change_state("position", 20, [1e6, 1e6, 0.0]), r"track bus at 2\.00 s"),
        (change_all("bus", "valid", [1]), "track bus: valid has 1 values for 60 steps"),
        (change_all("bus", "length", [[0.0]] * STEPS), "track bus: a box of 0 x 2.9 x 3.4 m"),
        (change_all("bus", "width", [["wide"]] * STEPS), "track bus: width is not made of numbers"),
        (change_all("bus", "height", [[3400.0]] * STEPS), "track bus: a box of 11 x 2.9 x 3400 m"),
        (change_all("ego", "heading", [90.0] * STEPS), "track ego: the ego does not drive where its heading points"),
        (change_times(np.where(np.arange(STEPS) == 7, 0.6, TIMES)), r"metadata: ts: time 7 \(0\.600000 s\) repeats"),
        (change_times(np.where(np.arange(STEPS) == 7, 0.1, TIMES)), r"metadata: ts: time 7 \(0\.100000 s\) is before"),
        (change_times(1e6 * TIMES), "metadata: ts: steps of 100000 s, .* another unit"),
        (change_times(TIMES * np.nan), "metadata: ts is no row of one or more finite seconds"),
        (change_map(polyline=[[0.0, float("nan")]]), r"map feature with area: polyline: row 0 \(0, nan\)"),
        (change_map(polygon=[[0, 1e300], [1, 1], [2, 2]]), "map feature with area: polygon: row 0"),
        (change_map(polygon=[[1000, 500], [1001, 500]]), "map feature with area: polygon: 3 or more rows"),
        (change_map(polyline=[[0.0, 0.0], [1e6, 0.0]]), "map feature with area: polyline is more than 20 km"),
        (lambda content: content["metadata"].update(dataset="nuplan"), "metadata: dataset is nuplan"),
        (lambda content: content["tracks"].update(odd={"type": "UNSET"}), "track odd: category unset is not known"),
        (lambda content: content["tracks"].update(odd=[]), "track odd: type is missing"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(tmp_path, change, named):
    content = scenario()
    change(content)
    with pytest.raises(InputError, match=rf"one\.json\.gz: not a ScenarioNet scenario.*{named}"):
        read(tmp_path, content)


def test_tracks_without_a_category_go_by_their_type_and_the_ego_is_no_obstacle(tmp_path):
    content = scenario()
    for kind in ("VEHICLE", "PEDESTRIAN", "CYCLIST", "TRAFFIC_CONE", "TRAFFIC_BARRIER"):
        content["tracks"][kind] = {"type": kind, "state": state_of(content, "bus")}
    content["tracks"]["again"] = {"type": "VEHICLE", "metadata": {"type": "EGO_VEHICLE"}, "state": None}
    scene = read(tmp_path, content)
    labels = ["bus", "automobile", "person", "rider", "cone", "barrier"]
    assert [agent.label for agent in scene.agents] == labels
    assert any("1 of 7 tracks: of the ego's class" in text for text in scene.assumptions)


@pytest.mark.parametrize("features", [{}, {"line": {"type": "ROAD_LINE", "polyline": []}}])
def test_without_a_map_nobody_is_said_to_be_on_the_road(tmp_path, features):
    content = scenario()
    content["map_features"] = features
    scene = read(tmp_path, content)
    assert (scene.lanes, scene.drivable, scene.road_edges) == ((), (), ())
    assert any("leaving the road is not measured" in text for text in scene.assumptions)
    assert score_rollout(scene, replay(scene)).offroad is None
    gate = check_gate(scene)
    assert gate.passed and "leaving the road not measured" in gate.checks[0].finding


def test_a_folder_of_plain_json_is_found_and_pickles_are_named(tmp_path):
    (tmp_path / "one.json").write_text("{}")
    assert [path.name for path in find_recordings(tmp_path)] == ["one.json"]
    (tmp_path / "one.json").rename(tmp_path / "one.pkl")
    with pytest.raises(InputError, match="pickles are not opened"):
        find_recordings(tmp_path)


@pytest.fixture
def log(tmp_path):
    return write_sensor_log(tmp_path / "log")


def edit(path, change):
    table = feather.read_table(path)
    feather.write_feather(change(table), path)


def with_values(table, column, values):
    return table.set_column(table.column_names.index(column), column, [values])


def test_rows_of_the_ego_are_no_obstacle(log):
    path = log / "annotations.feather"
    table = feather.read_table(path)
    ego = with_values(with_values(table, "category", ["EGO_VEHICLE"] * len(table)), "track_uuid", ["x"] * len(table))
    zero = [0.0] * len(table)
    for column in ("tx_m", "ty_m", "tz_m"):
        ego = with_values(ego, column, zero)
    feather.write_feather(pa.concat_tables([table, ego]), log / "annotations_with_ego.feather")
    path.unlink()
    scene = read_recording(log)
    assert [agent.id for agent in scene.agents] == ["parked"] and check_gate(scene).passed


def test_a_log_without_annotations_is_refused(log):
    edit(log / "annotations.feather", lambda table: table.slice(0, 0))
    with pytest.raises(InputError, match=r"annotations\.feather: holds no rows"):
        read_recording(log)
    (log / "annotations.feather").unlink()
    with pytest.raises(InputError, match=r"log: none of annotations\.feather, annotations_with_ego\.feather"):
        read_recording(log)


def test_a_log_without_a_map_is_a_scene_without_lanes(log):
    (log / "map" / "log_map_archive_x.json").unlink()
    scene = read_recording(log)
    assert scene.lanes == () and any("leaving the road is not measured" in text for text in scene.assumptions)


def test_rows_that_are_there_twice_are_one(log):
    before = read_recording(log)
    edit(log / "annotations.feather", lambda table: pa.concat_tables([table, table.slice(3, 5)]))
    edit(log / "city_SE3_egovehicle.feather", lambda table: pa.concat_tables([table.slice(50), table.slice(0, 60)]))
    again = read_recording(log)
    np.testing.assert_array_equal(again.agents[0].poses, before.agents[0].poses)
    np.testing.assert_array_equal(again.ego.T_world_rig, before.ego.T_world_rig)


def moved_again(table):
    twice = table.slice(4, 1)
    return pa.concat_tables([table, with_values(twice, "tx_m", [twice["tx_m"][0].as_py() + 1.0])])


def nowhere(table):
    return with_values(table, "ty_m", [float("nan") if i == 7 else v for i, v in enumerate(table["ty_m"].to_pylist())])


def in_microseconds(table):
    return with_values(table, "timestamp_ns", pc.divide(table["timestamp_ns"], 1000).to_pylist())


@pytest.mark.parametrize(
    ("name", "change", "named"),
    [
        ("annotations", moved_again, "track parked: two samples at 0.40 s that differ"),
        ("city_SE3_egovehicle", moved_again, "two ego poses at timestamp_ns 1000000000200000000 that differ"),
        ("annotations", nowhere, r"column ty_m holds nan \(track_uuid parked timestamp_ns 1000000000900000000\)"),
        ("annotations", in_microseconds, "timestamp_ns: steps of 0.0001 s"),
        ("annotations", lambda t: with_values(t, "qw", [2.0] * len(t)), r"quaternion .* \(track_uuid parked"),
        (
            "annotations",
            lambda t: with_values(t, "timestamp_ns", [0.5] * len(t)),
            "column timestamp_ns holds float64, whole numbers",
        ),
        ("annotations", lambda t: with_values(t, "category", ["SHIP"] * len(t)), "class SHIP of track parked"),
        ("annotations", lambda t: with_values(t, "width_m", ["1"] * len(t)), "column width_m holds object, numbers"),
    ],
)
def test_what_is_wrong_with_a_log_is_named_with_its_place(log, name, change, named):
    edit(log / f"{name}.feather", change)
    with pytest.raises(InputError, match=rf"{name}\.feather: .*{named}"):
        read_recording(log)


def test_sweeps_with_a_gap_are_cut(log):
    def without_ten(table):
        return pa.concat_tables([table.slice(0, 12), table.slice(22)])

    edit(log / "annotations.feather", without_ten)
    scene = read_recording(log)
    assert len(scene.ego) == 26 and scene.ego.positions[-1, 0] == pytest.approx(SPEED * 2.5)
    assert any("12 of 38 poses of the ego" in text for text in scene.assumptions)
    assert scene.agents[0].timestamps_us[0] == 0


def test_tracks_of_a_motion_scenario_are_cut_where_they_are_away(tmp_path):
    folder = write_motion_scenario(tmp_path / "scenario")
    path = folder / "scenario_abc.parquet"
    rows = [
        {**row, "object_type": row["object_type"].upper()}
        for row in parquet.read_table(path).to_pylist()
        if not (row["track_id"] == "9" and 20 <= row["timestep"] < 30)
    ]
    parquet.write_table(pa.Table.from_pylist(rows), path)
    scene = read_recording(folder)
    assert [(agent.id, len(agent.poses)) for agent in scene.agents] == [("9", 20), ("9#2", 30)]
