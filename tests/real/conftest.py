"""The six-camera recording: three instants, a second apart, each camera with its own pose, and a LiDAR scan."""

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from olt_generator.cameras import FthetaCamera, PinholeCamera
from olt_generator.poses import invert, pose_from_quaternion, transform
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig import CAMERA_INDEX, FRONT_WIDE, MountedCamera, short_name
from olt_toolkit.rigs.rig_files import pav_rig

FOLDER = "six_camera_surround_three_steps"
NAMES = {"front": "CAMERA_01", "front left": "CAMERA_05", "front right": "CAMERA_06"}
WIDTH, HEIGHT = 832, 522


@dataclass(frozen=True)
class CameraRecord:
    """Frames (3, H, W, 3), the camera, its poses in the world (3, 4, 4) and in the rig (4, 4)."""

    frames: np.ndarray
    camera: PinholeCamera
    T_world_camera: np.ndarray
    T_rig_camera: np.ndarray

    @property
    def trajectory(self) -> Trajectory:
        """Rig poses at this camera's own times, taken as a second apart."""
        return Trajectory(1_000_000 * np.arange(3), self.T_world_camera @ invert(self.T_rig_camera))


class SixCameras:
    """Reads cameras by what they look at, and the scan."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._records = json.loads((folder / "scene.json").read_text())["data"]

    def camera(self, name: str) -> CameraRecord:
        """One camera at 832 x 522 pixels."""
        calibration = json.loads((self._folder / "calibration.json").read_text())
        index = calibration["names"].index(NAMES[name])
        intrinsics = calibration["intrinsics"][index]
        full = PinholeCamera(1936, 1216, *(intrinsics[key] for key in ("fx", "fy", "cx", "cy")))
        images = sorted((datum["image"] for datum in self._data(NAMES[name])), key=lambda image: image["filename"])
        frames = [cv2.imread(str(self._folder / image["filename"]))[..., ::-1] for image in images]
        return CameraRecord(
            np.stack([cv2.resize(frame, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA) for frame in frames]),
            full.resized(WIDTH, HEIGHT),
            np.stack([_pose(image["pose"]) for image in images]),
            _pose(calibration["extrinsics"][index]),
        )

    def lidar(self) -> np.ndarray:
        """Points (n, 3) in the world of the first instant's scan."""
        scan = self._data("LIDAR")[0]["point_cloud"]
        points = np.load(self._folder / scan["filename"])["data"][:, :3]
        return transform(_pose(scan["pose"]), points)

    def _data(self, name: str) -> list[dict]:
        return [record["datum"] for record in self._records if record["id"]["name"] == name]


def _pose(record: dict) -> np.ndarray:
    rotation, translation = record["rotation"], record["translation"]
    return pose_from_quaternion([rotation[f"q{axis}"] for axis in "xyzw"], [translation[axis] for axis in "xyz"])


@pytest.fixture(scope="session")
def six_cameras(shared_real) -> SixCameras:
    return SixCameras(shared_real / FOLDER)


@pytest.fixture
def nvidia_rig(shared_real) -> dict[str, MountedCamera]:
    """NVIDIA's median calibration of the target rig; the front camera, which it places nowhere, is the nominal one."""
    path = shared_real / "nvidia_seven_camera_rig_calibration" / "median_calibration.json"
    content = json.loads(path.read_text())
    poses = {"front": np.eye(4), **content["relative_camera_poses_front_optical_from_camera"]}
    cameras = {}
    for name in CAMERA_INDEX:
        called = "front" if name == FRONT_WIDE else short_name(name)
        lens = content["ftheta_intrinsics"][called]
        camera = FthetaCamera.from_radius_to_angle(
            lens["width"], lens["height"], *lens["principal_point_px"], tuple(lens["pixel_radius_to_angle_poly"])
        )
        cameras[name] = MountedCamera(camera, pav_rig()[FRONT_WIDE].T_rig_camera @ np.array(poses[called]))
    return cameras
