"""nuScenes trees: tables read row by row, images that may be missing, a pose for every image."""

import json
import shutil

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from olt_datasets.sources.json_rows import read_rows
from olt_datasets.sources.nuscenes import DATASET
from olt_generator.errors import InputError
from olt_generator.poses import yaw_of
from olt_toolkit.clips.clip import EgoMotion
from olt_toolkit.recordings.drives import open_dataset
from olt_toolkit.recordings.recording import OpenOptions
from olt_toolkit.rigs.rig import (
    CAMERA_INDEX,
    CROSS_LEFT,
    CROSS_RIGHT,
    FRONT_TELE,
    FRONT_WIDE,
    MountedCamera,
)
from olt_toolkit.rigs.rig_files import load_rig

KEY = "scene-0007"
OPTIONS = OpenOptions(width=96)


def set_field(table, row, field, value):
    """A change of one field of one row; a value of None takes it out."""

    def change(tables):
        if value is None:
            del tables[table][row][field]
        else:
            tables[table][row][field] = value

    return change


def test_drives_are_told_from_the_tables(write_nuscenes, tmp_path):
    dataset = open_dataset(write_nuscenes(), tmp_path / "cache")
    assert (dataset.source, dataset.keys()) == ("nuscenes", [KEY])
    drive = dataset.drive(KEY)
    assert drive.scene_id == "nuscenes/s"
    assert drive.front_us.tolist() == [83_333 * k for k in range(109)]
    assert drive.ego_span_us == (0, 83_333 * 108 + 20_000)
    assert set(drive.cameras) == set(load_rig("nuscenes").cameras)
    assert set(drive.true_views) == set(CAMERA_INDEX)
    assert (drive.country, drive.split) == ("SG", None)
    assert any("Wait, turn left" in note for note in drive.notes)
    assert any("cross_left view is a mosaic of several cameras, which shows 61% of it" in note for note in drive.notes)


def test_scenes_are_told_by_token_and_not_by_name(write_nuscenes, tmp_path):
    def add_namesake(tables):
        tables["scene"].append(tables["scene"][0] | {"token": "t"})
        tables["sample"][0]["scene_token"] = "t"

    tree = write_nuscenes(seconds=2.0)
    moved = tree.rename(tmp_path / "moved")
    assert DATASET.open(moved, tmp_path / "cache").drive(KEY).scene_id == "nuscenes/s"
    twice = DATASET.open(write_nuscenes(seconds=2.0, change=add_namesake), tmp_path / "cache")
    with pytest.raises(InputError, match=r"scene\.json: 2 scenes are called 'scene-0007' \(s, t\)"):
        twice.drive(KEY)


def test_the_test_release_is_test(write_nuscenes, tmp_path):
    tree = write_nuscenes("v1.0-test", seconds=2.0, change=set_field("log", 0, "location", "elsewhere"))
    drive = DATASET.open(tree, tmp_path / "cache").drive(KEY)
    assert (drive.country, drive.split) == (None, "test")


def test_a_window_gives_motion_and_mosaics_of_its_time(write_nuscenes, tmp_path, true_motion, world):
    recording = DATASET.open(write_nuscenes(), tmp_path / "cache").open(KEY, (1_000_000, 1_400_000), OPTIONS)
    assert recording.timestamps_us.tolist() == [83_333 * k for k in range(4)]
    start_us = 83_333 * 13
    reference = recording.reference
    assert reference.timestamps_us[0] == -start_us
    assert np.diff(reference.timestamps_us).min() >= 10_000
    np.testing.assert_allclose(
        reference.T_world_rig, true_motion((reference.timestamps_us + start_us) * 1e-6), atol=1e-9
    )
    motion = EgoMotion.from_trajectory(reference)
    ahead = motion.velocity / np.linalg.norm(motion.velocity, axis=1, keepdims=True)
    heading = yaw_of(motion.trajectory.T_world_rig)
    np.testing.assert_allclose(ahead[:, :2], np.stack([np.cos(heading), np.sin(heading)], -1), atol=0.01)
    front = MountedCamera(recording.camera, recording.T_rig_camera)
    assert world.mistakes(recording.frames[0], front).max() <= 6
    for name in (FRONT_WIDE, CROSS_LEFT, CROSS_RIGHT, FRONT_TELE):
        mistakes = world.mistakes(recording.views[name][3], recording.mounted[name])
        assert np.percentile(mistakes[recording.observed[name]], 98) <= 6
    assert any("CAM_BACK_LEFT" in note and "20 ms" in note for note in recording.assumptions)


def test_images_that_are_not_on_disk_are_left_out(write_nuscenes, tmp_path):
    tree = write_nuscenes(seconds=4.0)
    shutil.rmtree(tree / "sweeps" / "CAM_BACK_LEFT")
    drive = DATASET.open(tree, tmp_path / "cache").drive(KEY)
    assert set(drive.true_views) == set(CAMERA_INDEX) - {CROSS_LEFT}
    assert any("CAM_BACK_LEFT lacks images" in note for note in drive.notes)
    shutil.rmtree(tree / "sweeps" / "CAM_FRONT")
    drive = DATASET.open(tree, tmp_path / "cache").drive(KEY)
    assert drive.front_us.tolist() == [6 * 83_333 * k for k in range(9)]
    assert set(drive.true_views) == set(CAMERA_INDEX)
    assert any("2.0 images a second" in note for note in drive.notes)
    assert drive.ego_span_us == (0, 83_333 * 48 + 20_000)
    shutil.rmtree(tree / "samples" / "CAM_FRONT")
    dataset = DATASET.open(tree, tmp_path / "cache")
    assert dataset.keys() == []
    with pytest.raises(InputError, match="CAM_FRONT are not on disk"):
        dataset.drive(KEY)


def test_the_tables_are_read_once_and_again_when_they_change(write_nuscenes, tmp_path):
    tree, cache = write_nuscenes(seconds=1.0), tmp_path / "cache"
    dataset = DATASET.open(tree, cache)
    first = dataset.drive(KEY)
    (kept,) = cache.iterdir()
    written = kept.stat().st_mtime_ns
    np.testing.assert_array_equal(DATASET.open(tree, cache).drive(KEY).front_us, first.front_us)
    assert kept.stat().st_mtime_ns == written
    scene = tree / "v1.0-mini" / "scene.json"
    scene.write_text(scene.read_text().replace("turn left", "turn right"))
    assert any("turn right" in note for note in DATASET.open(tree, cache).drive(KEY).notes)


def test_scenes_of_the_mini_release_are_those_of_the_full_one(write_nuscenes, tmp_path):
    tree = write_nuscenes("v1.0-mini", seconds=1.0)
    shutil.copytree(tree / "v1.0-mini", tree / "v1.0-test")
    dataset = DATASET.open(tree, tmp_path / "cache")
    assert dataset.keys() == [KEY]
    assert dataset.drive(KEY).split == "test"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (set_field("sample_data", 3, "timestamp", "soon"), r"sample_data\.json: row 3: field timestamp is 'soon'"),
        (set_field("sample_data", 2, "width", None), r"sample_data\.json: row 2: field width is missing"),
        (set_field("sample_data", 2, "filename", "samples/../../etc/passwd"), "leaves the data set"),
        (set_field("sample_data", 2, "filename", "/etc/passwd"), "leaves the data set"),
        (set_field("sample_data", 4, "ego_pose_token", "lost"), r"ego_pose\.json: no row with token lost"),
        (set_field("sample_data", 4, "sample_token", "lost"), r"sample\.json: no row with token lost"),
        (set_field("sample_data", 4, "timestamp", 1_532_402_927_000_000), r"sample_data\.timestamp"),
        (set_field("sample_data", 4, "width", 100), r"sample_data\.width changes"),
        (set_field("ego_pose", 5, "rotation", [1, 1, 1, 1]), "quaternion of length 1"),
        (set_field("ego_pose", 5, "translation", [0.0, float("nan"), 0.0]), "row 5: field translation"),
        (set_field("calibrated_sensor", 1, "camera_intrinsic", [[1, 0], [0, 1]]), "3 x 3 matrix"),
        (set_field("sample", 0, "scene_token", "lost"), "no scene_token lost"),
        (set_field("scene", 0, "log_token", "lost"), "no log_token lost"),
    ],
)
def test_damaged_tables_are_named(write_nuscenes, tmp_path, change, message):
    tree = write_nuscenes(seconds=1.0, change=change)
    with pytest.raises(InputError, match=message):
        DATASET.open(tree, tmp_path / "cache").drive(KEY)


def test_missing_tables_images_and_scenes_are_named(write_nuscenes, tmp_path):
    tree = write_nuscenes(seconds=1.0)
    dataset = DATASET.open(tree, tmp_path / "cache")
    with pytest.raises(InputError, match="no scene 'scene-9999'"):
        dataset.drive("scene-9999")
    for image in tree.glob("samples/CAM_FRONT/*.jpg"):
        image.unlink()
        image.write_bytes(b"\xff\xd8\xff no image")
    with pytest.raises(InputError, match="cannot be decoded"):
        dataset.open(KEY, (0, 500_000), OPTIONS)
    (tree / "v1.0-mini" / "log.json").unlink()
    with pytest.raises(InputError, match=r"log\.json: no such table"):
        DATASET.open(tree, tmp_path / "cache").keys()
    with pytest.raises(InputError, match="give the root of nuScenes"):
        DATASET.open(tmp_path, tmp_path / "cache")
    assert not DATASET.recognises(tmp_path)


rows = st.lists(
    st.fixed_dictionaries({"token": st.text(), "timestamp": st.integers(), "translation": st.lists(st.floats(-9, 9))}),
    max_size=20,
)


@settings(max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(rows, st.sampled_from([None, 0, 1]), st.integers(1, 40))
def test_rows_come_back_whatever_the_blocks(tmp_path, monkeypatch, listed, indent, block):
    monkeypatch.setattr("olt_datasets.sources.json_rows._BLOCK", block)
    path = tmp_path / "rows.json"
    path.write_text(json.dumps(listed, indent=indent), encoding="utf-8")
    assert list(read_rows(path, {"token": str, "timestamp": int, "translation": list})) == listed


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(1, 60))
def test_a_file_that_was_cut_off_is_refused(tmp_path, kept):
    path = tmp_path / "rows.json"
    text = json.dumps([{"token": "abc", "timestamp": 12}, {"token": "def", "timestamp": 13}])
    path.write_text(text[:kept])
    assert kept < len(text)
    with pytest.raises(InputError, match=r"rows\.json"):
        list(read_rows(path, {"token": str, "timestamp": int}))


@pytest.mark.parametrize("text", ["", "{}", "[1]", '[{"token": "a"} nonsense', '[{"token": true}]', "[" * 10_000])
def test_what_is_no_list_of_rows_is_refused(tmp_path, text):
    path = tmp_path / "rows.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"rows\.json"):
        list(read_rows(path, {"token": str}))


def test_a_look_at_a_drive(write_nuscenes, tmp_path, check_peek):
    check_peek(DATASET.open(write_nuscenes(seconds=1.0), tmp_path / "cache"), KEY, 80)
