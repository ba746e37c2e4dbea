"""Recordings whose content is damaged: a scene that can be used, or one line that names the file, and soon."""

import copy
import json
import time

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pyarrow import feather, parquet

from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.scenes.sources import read_recording
from olt_generator.errors import InputError

from .recordings import scenario, write_motion_scenario, write_scenario, write_sensor_log

MOST_CPU_SECONDS = 5.0
EXAMPLES = settings(deadline=None, suppress_health_check=list(HealthCheck))
NUMBERS = [0, -1, 1, 0.5, 2**31, 2**63, 10**400, 1e-300, 1e9, 1e18, 1e300, float("nan"), float("inf"), -float("inf")]
VALUES = [*NUMBERS, None, True, "", "1.5", "LANE", [], {}, [[]], [[1.0, 2.0]], [1.0], {"x": 1.0}, [{"x": 0, "y": 0}]]


def check(path, name):
    """The recording is read into a scene whose parts fit together, or refused in one line that names the file."""
    start = time.process_time()
    try:
        scene = read_recording(path)
    except InputError as error:
        assert name in str(error) and "\n" not in str(error), error
        return
    finally:
        assert time.process_time() - start < MOST_CPU_SECONDS
    assert_sound(scene)


def assert_sound(scene: Scene):
    assert scene.ego.timestamps_us[0] == 0 and np.all(np.isfinite(scene.ego.T_world_rig))
    end_us = scene.ego.timestamps_us[-1]
    assert len({agent.id for agent in scene.agents}) == len(scene.agents)
    for agent in scene.agents:
        assert len(agent.timestamps_us) == len(agent.poses) > 0 and np.all(np.isfinite(agent.poses))
        assert np.all(np.diff(agent.timestamps_us) > 0)
        assert agent.timestamps_us[0] >= 0 and agent.timestamps_us[-1] <= end_us
        assert min(agent.length, agent.width, agent.height) > 0.0
    lines = [line for lane in scene.lanes for line in (lane.center, lane.left, lane.right)]
    for line in [*lines, *scene.road_edges, *scene.drivable, scene.route]:
        assert len(line) >= 2 and np.all(np.isfinite(line))


def change(draw, holder):
    """Change one thing somewhere in nested lists and objects."""
    keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
    if not keys:
        return
    key = draw(st.sampled_from(keys))
    inner = holder[key]
    if isinstance(inner, (dict, list)) and inner and draw(st.integers(0, 4)):
        change(draw, inner)
        return
    way = draw(st.sampled_from(["value", "delete", "again", "scale", "turn", "cut"]))
    if way == "delete":
        del holder[key]
    elif way == "again" and isinstance(holder, list):
        holder.insert(key, copy.deepcopy(inner))
    elif way == "scale" and isinstance(inner, list):
        holder[key] = scaled(inner, draw(st.sampled_from([1e-3, 1e3, 1e6, 180.0 / np.pi, -1.0, 0.0])))
    elif way == "turn" and isinstance(inner, list):
        inner.reverse()
    elif way == "cut" and isinstance(inner, list):
        del inner[draw(st.integers(0, len(inner))) :]
    else:
        holder[key] = copy.deepcopy(draw(st.sampled_from(VALUES)))


def scaled(value, factor):
    if isinstance(value, list):
        return [scaled(item, factor) for item in value]
    return value * factor if isinstance(value, (int, float)) else value


@EXAMPLES
@given(data=st.data())
def test_a_damaged_scenario_is_a_scene_or_is_refused(tmp_path_factory, data):
    content = scenario(turned=data.draw(st.booleans()))
    for _ in range(data.draw(st.integers(1, 3))):
        change(data.draw, content)
    check(write_scenario(tmp_path_factory.mktemp("damaged") / "one.json.gz", content), "one.json.gz")


@EXAMPLES
@given(data=st.data())
def test_a_damaged_map_is_a_scene_or_is_refused(tmp_path_factory, data):
    folder = write_motion_scenario(tmp_path_factory.mktemp("damaged") / "scenario")
    path = folder / "log_map_archive_x.json"
    content = json.loads(path.read_text())
    for _ in range(data.draw(st.integers(1, 3))):
        change(data.draw, content)
    path.write_text(json.dumps(content))
    check(folder, folder.name)


def change_table(draw, table: pa.Table) -> pa.Table:
    """Change a column, a cell, or the rows of a table."""
    name = draw(st.sampled_from(table.column_names))
    at, values = table.column_names.index(name), table[name].to_pylist()
    row = draw(st.integers(0, max(len(values) - 1, 0)))
    way = draw(st.sampled_from(["cell", "column", "drop", "scale", "text", "rows", "again", "turn"]))
    if way == "drop":
        return table.drop_columns([name])
    if way == "rows":
        return table.slice(row, draw(st.integers(0, len(values))))
    if way == "again":
        return pa.concat_tables([table, table.slice(row, 3)])
    if way == "turn":
        return table.take(pa.array(range(len(values))[::-1], pa.int64()))
    if way == "text":
        return table.set_column(at, name, [list(map(str, values))])
    if way == "scale" and values and isinstance(values[0], (int, float)):
        factor = draw(st.sampled_from([1e-3, 0.0, -1.0, 180.0 / np.pi, 1e3]))
        return with_column(table, at, [type(values[0])(value * factor) for value in values])
    new = draw(st.sampled_from([0, 1, -1, 2**40, 1e300, 0.5, float("nan"), float("inf"), None, "x", "EGO_VEHICLE"]))
    changed = [new] * len(values) if way == "column" else [new if i == row else v for i, v in enumerate(values)]
    return with_column(table, at, changed)


def with_column(table: pa.Table, at: int, values: list) -> pa.Table:
    """The table with other values in a column; with none where they make no column."""
    try:
        return table.set_column(at, table.column_names[at], [values])
    except (pa.ArrowException, OverflowError):
        return table.set_column(at, table.column_names[at], [[None] * len(values)])


@EXAMPLES
@given(data=st.data())
def test_a_damaged_sensor_log_is_a_scene_or_is_refused(tmp_path_factory, data):
    folder = write_sensor_log(tmp_path_factory.mktemp("damaged") / "log")
    name = data.draw(st.sampled_from(["annotations.feather", "city_SE3_egovehicle.feather"]))
    table = feather.read_table(folder / name)
    for _ in range(data.draw(st.integers(1, 2))):
        table = change_table(data.draw, table) if table.num_columns else table
    feather.write_feather(table, folder / name)
    check(folder, folder.name)


@EXAMPLES
@given(data=st.data())
def test_a_damaged_motion_scenario_is_a_scene_or_is_refused(tmp_path_factory, data):
    folder = write_motion_scenario(tmp_path_factory.mktemp("damaged") / "scenario")
    path = folder / "scenario_abc.parquet"
    table = parquet.read_table(path)
    for _ in range(data.draw(st.integers(1, 2))):
        table = change_table(data.draw, table) if table.num_columns else table
    parquet.write_table(table, path)
    check(folder, folder.name)


@pytest.mark.parametrize("content", [[], 3, "x", None, {}, {"metadata": []}])
def test_another_document_is_refused(tmp_path, content):
    with pytest.raises(InputError, match=r"one\.json\.gz: not a ScenarioNet scenario"):
        read_recording(write_scenario(tmp_path / "one.json.gz", content))
