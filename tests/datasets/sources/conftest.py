"""A world infinitely far away whose colour tells the direction, and small drives that were filmed in it."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from olt_generator.cameras import pixel_rays
from olt_generator.poses import planar_pose
from olt_toolkit import OpenOptions
from olt_toolkit.rigs.rig import MountedCamera
from olt_toolkit.rigs.rig_files import load_rig


class World:
    """Colours: red ahead, green to the left, blue above."""

    @staticmethod
    def colours(directions):
        """Colours (..., 3) uint8 of unit directions (..., 3) in the rig."""
        return np.rint(127.5 * (1.0 + directions)).astype(np.uint8)

    def picture(self, mounted, shrink=1):
        """What a camera sees, drawn on fewer pixels and enlarged."""
        camera = mounted.camera.resized(mounted.camera.width // shrink, mounted.camera.height // shrink)
        rays = np.nan_to_num(pixel_rays(camera), nan=-1.0) @ mounted.T_rig_camera[:3, :3].T
        return cv2.resize(self.colours(rays), (mounted.camera.width, mounted.camera.height))

    def mistakes(self, view, mounted):
        """Largest error (h, w) of a picture's colours."""
        true = self.colours(pixel_rays(mounted.camera) @ mounted.T_rig_camera[:3, :3].T)
        return np.abs(view.astype(int) - true).max(axis=-1)


@pytest.fixture(scope="session")
def world():
    return World()


@pytest.fixture(scope="session")
def check_peek():
    """Looks at a drive and compares with what opening it gives: the images nearest in time, and how far colours are."""

    def check(dataset, key, width=24, tolerance=3):
        front_us = dataset.drive(key).front_us
        wanted = np.array([front_us[-1], front_us[1] + 1, front_us[0] - 5, front_us[1]])
        images, times_us = dataset.peek(key, wanted, width, np.zeros(4, np.int64))
        assert times_us.tolist() == front_us[[-1, 1, 0, 1]].tolist()
        assert images.shape[2] == width
        opened = dataset.open(key, (0, int(front_us[-1])), OpenOptions(width=width, views=())).frames
        assert np.abs(images.astype(int) - opened[[-1, 1, 0, 1]]).max(axis=-1).mean() <= tolerance

    return check


def drive_pose(seconds):
    """The rig on its way: a left bend of 50 m at 8 m/s, north-east of some origin."""
    angle = 0.16 * np.asarray(seconds) + 0.7
    return planar_pose(100.0 + 50.0 * np.sin(angle), 200.0 - 50.0 * np.cos(angle), angle)


def quaternion_wxyz(T):
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat().tolist()
    return [w, x, y, z]


def write_jpeg(path: Path, image):
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 98])


@pytest.fixture(scope="session")
def pandaset_tree(tmp_path_factory, world):
    """Sequence 001 with four of the six cameras, 80 images each at 10 Hz; the left camera 20 ms later."""
    root = tmp_path_factory.mktemp("pandaset")
    for name in ("front_camera", "front_left_camera", "left_camera", "front_right_camera"):
        mounted = load_rig("pandaset")[name]
        folder = root / "001" / "camera" / name
        write_jpeg(folder / "00.jpg", world.picture(mounted, shrink=8))
        for index in range(1, 80):
            (folder / f"{index:02d}.jpg").hardlink_to(folder / "00.jpg")
        times = 1557539924.25 + 0.1 * np.arange(80) + (0.02 if name == "left_camera" else 0.0)
        poses = drive_pose(times - 1557539924.25) @ mounted.T_rig_camera
        camera = mounted.camera
        lens = {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy}
        (folder / "intrinsics.json").write_text(json.dumps(lens))
        (folder / "timestamps.json").write_text(json.dumps(times.tolist()))
        (folder / "poses.json").write_text(json.dumps([_pandaset_pose(pose) for pose in poses]))
    return root


def _pandaset_pose(T):
    position = dict(zip("xyz", T[:3, 3].tolist(), strict=True))
    return {"position": position, "heading": dict(zip("wxyz", quaternion_wxyz(T), strict=True))}


@pytest.fixture
def write_nuscenes(tmp_path, world):
    """Write a nuScenes tree of one scene, scene-0007, with small images; every camera fires at its own times."""

    def write(version="v1.0-mini", seconds=9.0, cameras=None, change=None):
        rig = load_rig("nuscenes")
        names = list(rig.cameras) if cameras is None else cameras
        root = tmp_path / "nuscenes"
        tables = {name: [] for name in ("sensor", "calibrated_sensor", "sample", "sample_data", "ego_pose")}
        tables["log"] = [{"token": "log", "location": "singapore-onenorth"}]
        tables["scene"] = [{"token": "s", "name": "scene-0007", "description": "Wait, turn left", "log_token": "log"}]
        tables["sample"] = [{"token": f"sample{k}", "scene_token": "s"} for k in range(int(2 * seconds) + 1)]
        tables["sensor"].append({"token": "lidar", "channel": "LIDAR_TOP", "modality": "lidar"})
        tables["calibrated_sensor"].append(
            {"token": "cal", "sensor_token": "lidar", "translation": [0, 0, 2], "rotation": [1, 0, 0, 0]}
            | {"camera_intrinsic": []}
        )
        tables["sample_data"].append(_sample_data("cal", "sample0", "pose", "samples/LIDAR_TOP/0.bin", 0))
        for number, name in enumerate(names):
            mounted = MountedCamera(rig[name].camera.resized(160, 90), rig[name].T_rig_camera)
            _add_camera(tables, name, mounted)
            first = None
            for k in range(int(12 * seconds) + 1):
                time_us = 1_532_402_927_000_000 + 83_333 * k + 5_000 * number
                folder, token = ("samples" if k % 6 == 0 else "sweeps"), f"{name}-{k}"
                file = f"{folder}/{name}/drive__{name}__{time_us}.jpg"
                first = _place(root / file, first, lambda mounted=mounted: world.picture(mounted))
                tables["sample_data"].append(_sample_data(name, f"sample{k // 6}", token, file, time_us))
                T = drive_pose((time_us - 1_532_402_927_000_000) * 1e-6)
                pose = {"token": token, "timestamp": time_us, "translation": T[:3, 3].tolist()}
                tables["ego_pose"].append(pose | {"rotation": quaternion_wxyz(T)})
        if change is not None:
            change(tables)
        for name, rows in tables.items():
            path = root / version / f"{name}.json"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(rows, indent=0))
        return root

    return write


def _place(path, first, draw):
    """Link the first image to where it is wanted, or draw it; returns the first."""
    if first is None:
        write_jpeg(path, draw())
        return path
    path.parent.mkdir(parents=True, exist_ok=True)
    path.hardlink_to(first)
    return first


def _sample_data(calibration, sample, pose, file, time_us):
    return {
        "token": f"data-{file}",
        "sample_token": sample,
        "ego_pose_token": pose,
        "calibrated_sensor_token": calibration,
        "timestamp": time_us,
        "width": 160,
        "height": 90,
        "filename": file,
    }


def _add_camera(tables, name, mounted):
    camera = mounted.camera
    tables["sensor"].append({"token": f"sensor-{name}", "channel": name, "modality": "camera"})
    calibration = {"token": name, "sensor_token": f"sensor-{name}"}
    calibration["translation"] = mounted.T_rig_camera[:3, 3].tolist()
    calibration["rotation"] = quaternion_wxyz(mounted.T_rig_camera)
    calibration["camera_intrinsic"] = [[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]]
    tables["calibrated_sensor"].append(calibration)


@pytest.fixture(scope="session")
def true_motion():
    return drive_pose
