"""Damaged files of data sets: every drive is read, or refused in one line; the cache holds whole files alone."""

import shutil

import pytest

from ...fuzzing import SECONDS
from .test_argoverse2 import write_log, write_scenario
from .test_kitti_odometry import write_sequence
from .test_kitti_raw import write_drive
from .test_nexar import write_challenge as write_nexar

KITTI = ("calib_cam_to_cam.txt", "image_02_timestamps.txt", "oxts/0000000003.txt", "image_02/0000000000.png")
PANDASET = tuple(f"001/camera/front_camera/{name}.json" for name in ("poses", "timestamps", "intrinsics"))
NUSCENES = tuple(
    f"v1.0-mini/{name}.json" for name in ("sensor", "calibrated_sensor", "scene", "sample", "sample_data", "ego_pose")
)


@pytest.fixture
def roots(tmp_path, pandaset_tree, write_nuscenes):
    def make(source):
        if source == "kitti":
            return write_drive(tmp_path)
        if source == "kitti_odometry":
            return write_sequence(tmp_path / "sequence")
        if source == "nexar":
            return write_nexar(tmp_path / "nexar")
        if source == "argoverse2":
            write_scenario(tmp_path / "av2" / "val")
            write_log(tmp_path / "av2" / "val" / "log")
            return tmp_path / "av2"
        if source == "nuscenes":
            return write_nuscenes(seconds=1.0, cameras=["CAM_FRONT"])
        # The images are names of one file: copies of the links would be, too.
        return shutil.copytree(pandaset_tree, tmp_path / "pandaset", copy_function=shutil.copyfile)

    return make


CASES = [("kitti", name) for name in KITTI] + [("pandaset", name) for name in PANDASET]
CASES += [("nuscenes", name) for name in NUSCENES]
CASES += [("kitti_odometry", name) for name in ("calib.txt", "times.txt", "poses.txt", "image_0/000000.png")]
CASES += [("nexar", "train.csv"), ("nexar", "test.csv"), ("nexar", "train/00022.mp4")]
CASES += [("argoverse2", f"val/{name}") for name in ("0a1e/scenario_0a1e.parquet", "log/city_SE3_egovehicle.feather")]


@pytest.mark.parametrize(("source", "name"), CASES)
def test_damaged_files_of_data_sets(fuzzer, roots, source, name):
    root = roots(source)
    fuzzer.run("dataset", root / name, root, examples=8)


@pytest.mark.slow
@pytest.mark.parametrize(("source", "name"), CASES)
def test_damaged_files_of_data_sets_for_long(fuzzer, roots, source, name):
    root = roots(source)
    fuzzer.run("dataset", root / name, root, seconds=SECONDS)
