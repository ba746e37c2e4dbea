"""Every calibration among the real recordings: pixels come back to themselves, and rigs agree with their source."""

import json

import numpy as np
import polars as pl
import pytest

from olt_generator.cameras import BrownConradyCamera, PinholeCamera
from olt_generator.poses import invert, make_pose, pose_from_quaternion
from olt_toolkit import OpenOptions, open_recording
from olt_toolkit.rigs.rig_files import load_rig, pav_rig

KITTI_DRIVE = "kitti_raw_2011_09_26_drive_0013"
ARGOVERSE = "argoverse2_sensor_log_7fab2350/calibration"


def round_trip(camera):
    """Largest distance in pixels over a grid that includes the outermost edges, and the share that the lens reaches."""
    columns = np.linspace(-0.5, camera.width - 0.5 - 1e-9, 97)
    rows = np.linspace(-0.5, camera.height - 0.5 - 1e-9, 61)
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1)
    rays = camera.rays(pixels)
    reached = np.isfinite(rays[..., 0])
    back, _ = camera.project(12.0 * rays)
    return float(np.linalg.norm(back - pixels, axis=-1)[reached].max()), float(reached.mean())


def check_round_trip(camera, reach=1.0):
    error, reached = round_trip(camera)
    assert error < 1e-6
    assert reached >= reach


def kitti_field(text, name):
    line = next(line for line in text.splitlines() if line.startswith(name + ":"))
    return [float(value) for value in line.split()[1:]]


def test_the_seven_nvidia_lenses(nvidia_rig):
    for mounted in nvidia_rig.values():
        for camera in (mounted.camera, mounted.camera.resized(1920, 1080), mounted.camera.resized(832, 480)):
            check_round_trip(camera)


def test_the_measured_rig_is_close_to_the_nominal_one(nvidia_rig):
    for name, mounted in nvidia_rig.items():
        T_nominal_measured = invert(pav_rig()[name].T_rig_camera) @ mounted.T_rig_camera
        assert np.linalg.norm(T_nominal_measured[:3, 3]) < 0.5, name
        assert np.degrees(np.arccos(min(1.0, 0.5 * (np.trace(T_nominal_measured[:3, :3]) - 1.0)))) < 6.0, name


def test_the_raw_kitti_lenses(shared_real):
    """The four cameras before rectification, whose distortion is strong: one folds just before a corner."""
    text = (shared_real / KITTI_DRIVE / "calib_cam_to_cam.txt").read_text()
    for index in range(4):
        width, height = (int(value) for value in kitti_field(text, f"S_0{index}"))
        K, D = kitti_field(text, f"K_0{index}"), kitti_field(text, f"D_0{index}")
        check_round_trip(BrownConradyCamera(width, height, K[0], K[4], K[2], K[5], *D), 0.999)


def test_the_kitti_rig_is_the_one_of_its_drive(shared_real):
    recording = open_recording(shared_real / KITTI_DRIVE, OpenOptions(duration=1.0, width=1242))
    mounted = load_rig("kitti")["image_02"]
    assert mounted.camera == recording.camera
    assert np.abs(mounted.T_rig_camera[:3, 3] - recording.T_rig_camera[:3, 3]).max() < 0.03
    assert np.degrees(np.arccos(mounted.T_rig_camera[:3, 2] @ recording.T_rig_camera[:3, 2])) < 1.5


def test_the_argoverse_rig_is_that_of_its_log(shared_real):
    rig = load_rig("argoverse2")
    poses = {row["sensor_name"]: row for row in _rows(shared_real / ARGOVERSE / "egovehicle_SE3_sensor.feather")}
    for row in _rows(shared_real / ARGOVERSE / "intrinsics.feather"):
        mounted, pose = rig[row["sensor_name"]], poses[row["sensor_name"]]
        assert isinstance(mounted.camera, BrownConradyCamera)
        assert (mounted.camera.fx, mounted.camera.cy) == (row["fx_px"], row["cy_px"])
        assert (mounted.camera.k1, mounted.camera.k2, mounted.camera.k3) == (row["k1"], row["k2"], row["k3"])
        T_axle_camera = pose_from_quaternion(
            [pose[name] for name in ("qx", "qy", "qz", "qw")], [pose["tx_m"], pose["ty_m"], pose["tz_m"] + 0.323]
        )
        assert np.allclose(mounted.T_rig_camera, T_axle_camera, atol=1e-6)
        check_round_trip(mounted.camera)


def test_the_nuscenes_rig_is_that_of_its_scene(shared_real):
    text = (shared_real / "nuscenes_scene_0061_six_cameras" / "calibration_and_boxes.json").read_text()
    rig = load_rig("nuscenes")
    for name, camera in json.loads(text)["cameras"].items():
        matrix, pose = np.array(camera["cam2img"]), np.array(camera["cam2ego"])
        mounted = rig[name]
        assert mounted.camera == PinholeCamera(1600, 900, matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2])
        assert np.allclose(mounted.T_rig_camera, make_pose(pose[:3, :3], pose[:3, 3]), atol=1e-5)
        check_round_trip(mounted.camera)


def _rows(path):
    return pl.read_ipc(path).iter_rows(named=True)


@pytest.mark.parametrize("name", ["pav", "nuscenes", "pandaset", "argoverse2", "kitti", "dashcam"])
def test_the_rigs_of_the_package(name):
    """Over what the lens reaches: the corners of PandaSet's front image lie beyond its fold."""
    for mounted in load_rig(name).cameras.values():
        check_round_trip(mounted.camera, 0.97 if name == "pandaset" else 1.0)
