"""Mosaics of real cameras: a nuScenes tree made of the six real images, and where two cameras see the same."""

import json
import shutil

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from olt_datasets.sources.mosaic import Mosaic, coverage
from olt_generator.cameras import PinholeCamera
from olt_generator.lenses.remap import Remapper
from olt_generator.poses import make_pose, pose_from_quaternion
from olt_toolkit.recordings.drives import open_dataset
from olt_toolkit.recordings.recording import OpenOptions
from olt_toolkit.rigs.rig import (
    CAMERA_INDEX,
    CROSS_LEFT,
    CROSS_RIGHT,
    FRONT_TELE,
    FRONT_WIDE,
    POLICY_CAMERAS,
    MountedCamera,
)
from olt_toolkit.rigs.rig_files import pav_rig

FOLDER = "nuscenes_scene_0061_six_cameras"
STEP_US = 83_333


@pytest.fixture(scope="module")
def real_cameras(shared_real):
    """Records of the six cameras, and the vehicle's pose."""
    content = json.loads((shared_real / FOLDER / "calibration_and_boxes.json").read_text())
    return content["cameras"], np.array(content["ego2global"])


@pytest.fixture(scope="module")
def tree(shared_real, real_cameras, tmp_path_factory):
    """The instant twice, a twelfth of a second apart, as a scene in which the vehicle stands."""
    root = tmp_path_factory.mktemp("nuscenes")
    cameras, T_global_ego = real_cameras
    place = T_global_ego[:3, 3].tolist()
    tables = {
        "log": [{"token": "log", "location": "singapore-onenorth"}],
        "scene": [{"token": "s", "name": "scene-0061", "description": "Parked truck", "log_token": "log"}],
        "sample": [{"token": "sample", "scene_token": "s"}],
        "sensor": [{"token": name, "channel": name, "modality": "camera"} for name in cameras],
        "calibrated_sensor": [_calibration(name, record) for name, record in cameras.items()],
        "ego_pose": [],
        "sample_data": [],
    }
    for name, record in cameras.items():
        for step, folder in enumerate(("samples", "sweeps")):
            time_us = round(record["timestamp_s"] * 1e6) + STEP_US * step
            file = f"{folder}/{name}/scene__{name}__{time_us}.jpg"
            (root / file).parent.mkdir(parents=True)
            shutil.copy(shared_real / FOLDER / record["file"], root / file)
            token = f"{name}{step}"
            tables["ego_pose"].append({"token": token, "translation": place, "rotation": _wxyz(T_global_ego)})
            tables["sample_data"].append(
                {"sample_token": "sample", "ego_pose_token": token, "calibrated_sensor_token": name}
                | {"filename": file, "timestamp": time_us, "width": 1600, "height": 900}
            )
    (root / "v1.0-mini").mkdir()
    for name, rows in tables.items():
        (root / "v1.0-mini" / f"{name}.json").write_text(json.dumps(rows))
    return root


def _calibration(name, record):
    pose = np.array(record["cam2ego"])
    row = {"token": name, "sensor_token": name, "translation": pose[:3, 3].tolist(), "rotation": _wxyz(pose)}
    return row | {"camera_intrinsic": record["cam2img"]}


def _wxyz(pose):
    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
    return [w, x, y, z]


@pytest.fixture(scope="module")
def recording(tree, tmp_path_factory):
    dataset = open_dataset(tree, tmp_path_factory.mktemp("cache"))
    drive = dataset.drive("scene-0061")
    assert set(drive.true_views) == set(CAMERA_INDEX)
    assert drive.front_us.tolist() == [0, STEP_US]
    return dataset.open("scene-0061", (0, STEP_US), OpenOptions(width=832))


def alike(one, other, where):
    """Correlation of two pictures' brightness, without fine detail, over a mask."""
    values = [cv2.GaussianBlur(image, (0, 0), 2).mean(axis=-1)[where] for image in (one, other)]
    return float(np.corrcoef(*values)[0, 1])


def test_the_six_cameras_give_the_four_views(recording):
    assert recording.frames.shape == (2, 468, 832, 3)
    shares = {name: float(mask.mean()) for name, mask in recording.observed.items()}
    for name in (FRONT_WIDE, CROSS_LEFT, CROSS_RIGHT):
        assert shares[name] == pytest.approx(0.61, abs=0.01)
    assert shares[FRONT_TELE] == 1.0
    assert np.ptp(recording.reference.positions, axis=0).max() < 1e-9


@pytest.mark.parametrize("name", [FRONT_WIDE, FRONT_TELE])
def test_the_middle_of_the_front_views_is_the_front_image(recording, name):
    """The front frames were scaled on another way, straight from the stored image."""
    target = recording.mounted[name]
    rotation = recording.T_rig_camera[:3, :3].T @ target.T_rig_camera[:3, :3]
    remapper = Remapper(recording.camera, target.camera, rotation)
    middle = np.zeros(remapper.seen.shape, bool)
    middle[:, 300:532] = True
    assert alike(remapper.remap(recording.frames[0]), recording.views[name][0], remapper.seen & middle) > 0.99


# Correlations as measured, less 0.1; neighbours see things 5 to 30 m away from places up to a metre apart.
@pytest.mark.parametrize(
    ("name", "pair", "least"),
    [
        (CROSS_LEFT, ("CAM_FRONT_LEFT", "CAM_BACK_LEFT"), 0.6),
        (CROSS_LEFT, ("CAM_FRONT_LEFT", "CAM_FRONT"), 0.59),
        (CROSS_RIGHT, ("CAM_FRONT_RIGHT", "CAM_BACK_RIGHT"), 0.8),
        (CROSS_RIGHT, ("CAM_FRONT_RIGHT", "CAM_FRONT"), 0.76),
    ],
)
def test_neighbours_agree_where_both_look(shared_real, real_cameras, name, pair, least):
    """And would not, were a camera turned by 5 degrees."""
    target = pav_rig().fitted(832, 468)[name]
    records = {camera: real_cameras[0][camera] for camera in pair}
    images = {camera: read_rgb(shared_real / FOLDER / record["file"]) for camera, record in records.items()}
    right, turned = (overlap(target, records, images, degrees) for degrees in (0.0, 5.0))
    assert right > least
    assert turned < right - 0.1


def overlap(target, records, images, degrees):
    """How alike two cameras show what both see, the second turned about the vehicle's upright axis."""
    mosaics = [
        Mosaic(target, {name: mounted(record, degrees * number)})
        for number, (name, record) in enumerate(records.items())
    ]
    views = [mosaic.compose({name: images[name] for name in mosaic.cameras}) for mosaic in mosaics]
    return alike(*views, mosaics[0].observed & mosaics[1].observed)


def mounted(record, degrees=0.0):
    matrix, pose = np.array(record["cam2img"]), np.array(record["cam2ego"])
    camera = PinholeCamera(1600, 900, matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2])
    turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    return MountedCamera(camera, make_pose(turn @ pose[:3, :3], pose[:3, 3]))


def read_rgb(path):
    return np.ascontiguousarray(cv2.imread(str(path))[..., ::-1])


def test_the_measured_rig_is_covered_as_far_as_the_nominal_one(nvidia_rig, real_cameras):
    """The median calibration of the target rig, whose lenses look higher up than they look down."""
    sources = {name: mounted(record) for name, record in real_cameras[0].items()}
    for name in POLICY_CAMERAS:
        assert coverage(nvidia_rig[name], sources) == pytest.approx(coverage(pav_rig()[name], sources), abs=0.08)


def test_another_vehicle_with_other_lenses(shared_real):
    """Seven cameras of Argoverse 2, the front one portrait: nearly all across is seen, and neighbours agree."""
    folder = shared_real / "surround_view_stills" / "argoverse2_4612f4a4"
    records = json.loads((folder / "cameras.json").read_text())["cameras"]
    rig, images = {}, {}
    for name, record in records.items():
        images[name] = read_rgb(folder / f"{name}.webp")
        height, width = images[name].shape[:2]
        matrix = np.array(record["intrinsics"]) * [[width], [height], [1.0]]
        w, x, y, z = record["quaternion_wxyz"]
        lens = PinholeCamera(width, height, matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2])
        rig[name] = MountedCamera(lens, pose_from_quaternion([x, y, z, w], record["translation"]))
    target = pav_rig().fitted(832, 468)[CROSS_LEFT]
    mosaic = Mosaic(target, rig)
    assert mosaic.cameras == ("ring_front_center", "ring_front_left", "ring_rear_left", "ring_side_left")
    assert mosaic.observed.any(axis=0).all()
    one, other = (Mosaic(target, {name: rig[name]}) for name in ("ring_front_left", "ring_side_left"))
    assert alike(one.compose(images), other.compose(images), one.observed & other.observed) > 0.8
