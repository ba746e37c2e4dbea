"""Damaged scene files, and damaged files of recorded drives: read as scenes, or refused in one line."""

import pytest

from olt_closed_loop.scenes.procedural import generate_scene
from olt_closed_loop.scenes.scene_file import write_scene

from ...fuzzing import SECONDS
from .maps.crossroads import crossroads_scene
from .test_scene_sources import motion_scenario, scenario, sensor_log, write_scenario

__all__ = ["motion_scenario", "sensor_log"]  # fixtures

SCENES = (
    ("scene.usda", "scene.usda"),
    ("scene.usda", "scene.looks.usda"),
    ("scene.usdc", "scene.usdc"),
    ("crossroads.usda", "crossroads.usda"),
)


@pytest.fixture
def scene_files(tmp_path):
    """A scene as text and one in binary, each with its looks, and one with a whole map."""
    for suffix in ("usda", "usdc"):
        write_scene(generate_scene("nominal", 3), tmp_path / suffix / f"scene.{suffix}")
    write_scene(crossroads_scene(), tmp_path / "usda" / "crossroads.usda")
    return tmp_path


def find(folder, scene, name):
    folder = folder / scene.rpartition(".")[2]
    return folder / name, folder / scene


@pytest.mark.parametrize(("scene", "name"), SCENES)
def test_damaged_scene_files(fuzzer, scene_files, scene, name):
    fuzzer.run("scene", *find(scene_files, scene, name), examples=10)


@pytest.mark.slow
@pytest.mark.parametrize(("scene", "name"), SCENES)
def test_damaged_scene_files_for_long(fuzzer, scene_files, scene, name):
    fuzzer.run("scene", *find(scene_files, scene, name), seconds=SECONDS)


RECORDED = (
    ("sensor_log", "city_SE3_egovehicle.feather"),
    ("sensor_log", "annotations.feather"),
    ("sensor_log", "map/log_map_archive_x.json"),
    ("motion_scenario", "scenario_abc.parquet"),
    ("motion_scenario", "log_map_archive_x.json"),
    ("scenarios", "one.json.gz"),
)


@pytest.fixture
def scenarios(tmp_path):
    write_scenario(tmp_path / "one.json.gz", scenario())
    return tmp_path


@pytest.mark.parametrize(("kind", "name"), RECORDED)
def test_damaged_files_of_recorded_drives(fuzzer, request, kind, name):
    fuzzer.run("scenario", *find_recorded(request, kind, name), examples=10)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "name"), RECORDED)
def test_damaged_files_of_recorded_drives_for_long(fuzzer, request, kind, name):
    fuzzer.run("scenario", *find_recorded(request, kind, name), seconds=SECONDS)


def find_recorded(request, kind, name):
    folder = request.getfixturevalue(kind)
    return folder / name, folder / name if kind == "scenarios" else folder
