"""Argoverse 2 as a data set of trajectories."""

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import feather, parquet

from olt_datasets.sources.argoverse2 import DATASET
from olt_generator.errors import InputError
from olt_generator.poses import yaw_of
from olt_toolkit.recordings.drives import open_dataset
from olt_toolkit.recordings.recording import OpenOptions


def write_scenario(folder, name="0a1e", steps=110, track="AV", **changed):
    """The ego drives a bend of radius 20 m at 5 m/s; another car stands. Rows come in no order."""
    folder = folder / name
    folder.mkdir(parents=True)
    times = 0.1 * np.arange(steps)
    yaw = 0.25 * times
    columns = {
        "track_id": [track] * steps + ["7"] * steps,
        "timestep": np.tile(np.arange(steps), 2),
        "position_x": np.concatenate([1000.0 + 20.0 * np.sin(yaw), np.zeros(steps)]),
        "position_y": np.concatenate([-500.0 - 20.0 * np.cos(yaw), np.zeros(steps)]),
        "heading": np.concatenate([yaw, np.zeros(steps)]),
        "scenario_id": [name] * 2 * steps,
    } | changed
    order = np.random.default_rng(0).permutation(2 * steps)
    table = {name: np.asarray(values)[order] for name, values in columns.items() if values is not None}
    parquet.write_table(pa.table(table), folder / f"scenario_{name}.parquet")
    return folder


def write_log(folder, **changed):
    """Straight along x of the city at 10 m/s, a pose every 5 ms."""
    folder.mkdir(parents=True)
    times_ns = 5_000_000 * np.arange(400)
    still = np.zeros(400)
    columns = {"timestamp_ns": 315966253572412942 + times_ns, "qw": still + 1.0, "tx_m": 1e-8 * times_ns}
    columns |= dict.fromkeys(("qx", "qy", "qz", "ty_m", "tz_m"), still) | changed
    feather.write_feather(pa.table(columns), folder / "city_SE3_egovehicle.feather")
    return folder


def test_scenarios_and_logs_of_all_splits_are_drives(tmp_path):
    write_scenario(tmp_path / "train")
    write_scenario(tmp_path / "test", "0b", steps=50)
    write_log(tmp_path / "val" / "7fab")
    dataset = open_dataset(tmp_path, tmp_path / "cache")
    keys = dataset.keys()
    assert (dataset.source, keys) == ("argoverse2", ["test/0b", "train/0a1e", "val/7fab"])
    drives = [dataset.drive(key) for key in keys]
    assert [drive.split for drive in drives] == ["test", "train", "val"]
    assert [drive.ego_span_us for drive in drives] == [(0, 4_900_000), (0, 10_900_000), (0, 1_995_000)]
    assert all(drive.front_us.size == 0 and drive.cameras == () and drive.true_views == () for drive in drives)
    assert drives[1].scene_id == "argoverse2/0a1e"
    assert drives[1].country == "US"
    assert any("no images" in note for note in drives[1].notes)


def test_drives_are_told_by_what_is_in_their_files(tmp_path):
    folders = [
        write_scenario(tmp_path / "train"),
        write_scenario(tmp_path / "val", scenario_id=None),
        write_log(tmp_path / "train" / "7fab"),
        write_log(tmp_path / "train" / "other", tx_m=1e-7 * np.arange(400)),
    ]
    ids = [DATASET.open(folder, tmp_path).drive(".").scene_id for folder in folders]
    assert ids[0] == "argoverse2/0a1e"
    assert len(set(ids)) == 4
    moved = [folder.rename(tmp_path / f"folder {index}") for index, folder in enumerate(folders)]
    assert [DATASET.open(folder, tmp_path).drive(".").scene_id for folder in moved] == ids


def test_a_scenario_of_several_ids_is_refused(tmp_path):
    folder = write_scenario(tmp_path, scenario_id=["a", "b"] * 110)
    with pytest.raises(InputError, match="column scenario_id holds 2 ids"):
        DATASET.open(folder, tmp_path).drive(".")


def test_trajectories_are_those_of_the_rig_on_the_ground(tmp_path):
    write_scenario(tmp_path / "train")
    write_log(tmp_path / "train" / "7fab")
    dataset = DATASET.open(tmp_path, tmp_path / "cache")
    bend, straight = dataset.ego_motion("train/0a1e"), dataset.ego_motion("train/7fab")
    assert bend.positions[0].tolist() == [0.0, 0.0, 0.0]
    assert bend.path_length == pytest.approx(5.0 * 10.9, rel=1e-4)
    assert yaw_of(bend.T_world_rig) == pytest.approx(0.025 * np.arange(110))
    assert straight.path_length == pytest.approx(19.95)
    assert straight.positions[:, 2] == pytest.approx(-0.32)


def test_poses_of_one_microsecond_count_once(tmp_path):
    times_ns = 315966253572412942 + 5_000_000 * np.arange(400)
    times_ns[7] = times_ns[6] + 5
    folder = write_log(tmp_path / "log", timestamp_ns=times_ns)
    ego = DATASET.open(folder, tmp_path / "cache").ego_motion(".")
    assert len(ego) == 399


def test_nothing_can_be_opened(tmp_path):
    write_scenario(tmp_path / "train")
    dataset = open_dataset(tmp_path / "train" / "0a1e", tmp_path / "cache")
    assert dataset.keys() == ["."]
    with pytest.raises(InputError, match="has no images to open"):
        dataset.open(".", (0, 1_000_000), OpenOptions())


@pytest.mark.parametrize(
    ("changed", "complaint"),
    [
        ({"track": "7"}, r"scenario_0a1e\.parquet: no track AV"),
        ({"heading": None}, r"scenario_0a1e\.parquet: .*heading"),
        ({"position_x": np.full(220, np.nan)}, r"scenario_0a1e\.parquet: column position_x"),
        ({"timestep": np.zeros(220, int)}, r"scenario_0a1e\.parquet: track AV has two rows of timestep 0"),
    ],
)
def test_a_damaged_scenario_is_refused(tmp_path, changed, complaint):
    dataset = open_dataset(write_scenario(tmp_path, **changed), tmp_path / "cache")
    with pytest.raises(InputError, match=complaint):
        dataset.drive(".")


def test_a_file_that_is_no_table_is_refused_in_one_line(tmp_path):
    folder = write_scenario(tmp_path)
    # The length of the footer is right, the footer is not.
    (folder / "scenario_0a1e.parquet").write_bytes(b"PAR1" + b"\xff" * 100 + b"\x64\0\0\0PAR1")
    with pytest.raises(InputError, match=r"scenario_0a1e\.parquet: cannot be read") as caught:
        DATASET.open(folder, tmp_path / "cache").drive(".")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("changed", [{"qw": np.zeros(400)}, {"tx_m": np.full(400, np.inf)}])
def test_a_damaged_log_is_refused(tmp_path, changed):
    dataset = open_dataset(write_log(tmp_path / "log", **changed), tmp_path / "cache")
    with pytest.raises(InputError, match=r"city_SE3_egovehicle\.feather"):
        dataset.drive(".")
    with pytest.raises(InputError, match="no Argoverse 2 drive 'x'"):
        dataset.drive("x")


def test_there_is_nothing_to_look_at(tmp_path):
    dataset = open_dataset(write_log(tmp_path / "log"), tmp_path / "cache")
    with pytest.raises(InputError, match="has no images to open"):
        dataset.peek(".", np.zeros(1, np.int64), 320, np.zeros(1, np.int64))
