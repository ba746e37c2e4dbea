import json

import numpy as np
import pytest

from olt_generator.errors import InputError
from olt_generator.poses import invert
from olt_toolkit.rigs.rig import CAMERA_INDEX, FRONT_TELE, FRONT_WIDE, POLICY_CAMERAS
from olt_toolkit.rigs.rig_files import pav_rig

# The rig's cameras by the names of the measured median calibration.
MEASURED = {
    "cross_left": "camera_cross_left_120fov",
    "cross_right": "camera_cross_right_120fov",
    "front_tele": "camera_front_tele_30fov",
    "rear_left": "camera_rear_left_70fov",
    "rear_right": "camera_rear_right_70fov",
    "rear_tele": "camera_rear_tele_30fov",
}


def yaw_of_axis(T_rig_camera):
    return np.degrees(np.arctan2(T_rig_camera[1, 2], T_rig_camera[0, 2]))


def test_policy_cameras_are_in_the_order_of_their_indices():
    assert [CAMERA_INDEX[name] for name in POLICY_CAMERAS] == [0, 1, 2, 6]
    assert pav_rig().cameras.keys() == CAMERA_INDEX.keys()


def test_cameras_look_where_their_names_say():
    rig = pav_rig()
    yaws = {name: yaw_of_axis(mounted.T_rig_camera) for name, mounted in rig.cameras.items()}
    assert abs(yaws[FRONT_WIDE]) < 2
    assert abs(yaws[FRONT_TELE]) < 2
    assert yaws["camera_cross_left_120fov"] == pytest.approx(66.4, abs=1)
    assert yaws["camera_cross_right_120fov"] == pytest.approx(-66.8, abs=1)
    assert abs(yaws["camera_rear_tele_30fov"]) > 178


def test_horizontal_fields_of_view_are_those_of_the_names():
    for name, mounted in pav_rig().cameras.items():
        camera = mounted.camera
        edges = camera.rays(np.array([[0.0, camera.cy], [camera.width - 1.0, camera.cy]]))
        field = np.degrees(np.arccos(edges[0] @ edges[1]))
        nominal = float(name.rsplit("_", 1)[1].removesuffix("fov"))
        assert field == pytest.approx(nominal, rel=0.05), name


def test_mounting_agrees_with_the_measured_rig(shared_real):
    text = (shared_real / "nvidia_seven_camera_rig_calibration" / "median_calibration.json").read_text()
    measured = json.loads(text)["relative_camera_poses_front_optical_from_camera"]
    rig = pav_rig()
    T_front_rig = invert(rig[FRONT_WIDE].T_rig_camera)
    for name, ours in MEASURED.items():
        T_front_camera = T_front_rig @ rig[ours].T_rig_camera
        reference = np.array(measured[name])
        assert np.linalg.norm(T_front_camera[:3, 3] - reference[:3, 3]) < 0.5, name
        cosine = 0.5 * (np.trace(T_front_camera[:3, :3].T @ reference[:3, :3]) - 1)
        assert np.degrees(np.arccos(min(1.0, cosine))) < 6, name


def test_fitted_rig_sees_the_middle_of_the_same_view():
    rig = pav_rig()
    fitted = rig.fitted(576, 320)
    for name, mounted in fitted.cameras.items():
        assert (mounted.camera.width, mounted.camera.height) == (576, 320)
        rays = rig[name].camera.rays(np.array([[rig[name].camera.cx, rig[name].camera.cy]]))
        pixels, _ = mounted.camera.project(rays)
        np.testing.assert_allclose(pixels[0], [mounted.camera.cx, mounted.camera.cy], atol=1e-6)


def test_unknown_camera_is_named():
    with pytest.raises(InputError, match="no camera 'roof'"):
        pav_rig()["roof"]
