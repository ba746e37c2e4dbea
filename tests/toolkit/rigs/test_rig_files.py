"""Rigs as data: their figures, their lenses, and what is refused."""

import numpy as np
import pytest
import yaml

from olt_generator.cameras import BrownConradyCamera, FthetaCamera, KannalaBrandtCamera, PinholeCamera, pixel_rays
from olt_generator.errors import InputError
from olt_toolkit.rigs.rig_files import load_rig, read_rig, rig_names

CAMERA = {
    "size": [640, 480],
    "lens": {"model": "pinhole", "focal": [500.0, 500.0], "centre": [319.5, 239.5]},
    "position": [1.5, 0.0, 1.4],
    "roll_pitch_yaw_degrees": [0.0, 0.0, 90.0],
}
RIG = {
    "name": "mine",
    "assumed": ["The track width is a guess."],
    "vehicle": {
        "length": 4.5,
        "width": 1.8,
        "height": 1.5,
        "rear_axle_to_bbox_center": 1.4,
        "wheelbase": 2.7,
        "track_width": 1.55,
    },
    "cameras": {"left": CAMERA},
}


def write(tmp_path, rig):
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(rig))
    return path


def yaw_of_axis(mounted):
    return np.degrees(np.arctan2(mounted.T_rig_camera[1, 2], mounted.T_rig_camera[0, 2]))


def test_the_rigs_of_the_package():
    assert rig_names() == ["argoverse2", "dashcam", "kitti", "nuscenes", "pandaset", "pav"]


@pytest.mark.parametrize("name", ["argoverse2", "dashcam", "kitti", "nuscenes", "pandaset", "pav"])
def test_every_rig_is_sound_and_says_what_it_assumes(name):
    rig = load_rig(name)
    assert rig.name == name
    assert rig.assumptions
    for camera_name, mounted in rig.cameras.items():
        R, position = mounted.T_rig_camera[:3, :3], mounted.T_rig_camera[:3, 3]
        assert np.allclose(R @ R.T, np.eye(3), atol=1e-6) and np.linalg.det(R) > 0.0
        assert R[2, 1] < -0.99, f"{camera_name} stands upright"
        assert -1.0 < position[0] < 3.0 and abs(position[1]) < 1.1 and 0.8 < position[2] < 2.0
        rays = pixel_rays(mounted.camera.resized(64, 48))
        assert np.isfinite(rays).all(axis=-1).mean() > 0.98
    assert rig.fitted(64, 48).assumptions == rig.assumptions


@pytest.mark.parametrize(
    ("rig", "camera", "yaw"),
    [
        ("pandaset", "left_camera", 90.0),
        ("pandaset", "front_right_camera", -59.6),
        ("nuscenes", "CAM_BACK", 179.9),
        ("nuscenes", "CAM_FRONT_LEFT", 55.2),
        ("argoverse2", "ring_side_right", -98.9),
        ("kitti", "image_02", 0.0),
        ("pav", "camera_cross_left_120fov", 66.4),
        ("dashcam", "front", 0.0),
    ],
)
def test_cameras_look_where_they_should(rig, camera, yaw):
    assert yaw_of_axis(load_rig(rig)[camera]) == pytest.approx(yaw, abs=0.6)


def test_unknown_rigs_and_cameras_are_named_with_the_known_ones():
    with pytest.raises(InputError, match="no rig 'tesla'; there are argoverse2, dashcam, kitti, nuscenes"):
        load_rig("tesla")
    with pytest.raises(InputError, match="rig kitti has no camera 'CAM_FRONT'; it has image_00, image_01"):
        load_rig("kitti")["CAM_FRONT"]


def test_a_rig_of_ones_own(tmp_path):
    rig = read_rig(write(tmp_path, RIG))
    assert rig["left"].camera == PinholeCamera(640, 480, 500.0, 500.0, 319.5, 239.5)
    assert rig["left"].T_rig_camera[:3, 2] == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)
    assert rig.assumptions == ("The track width is a guess.",)
    assert rig.vehicle.wheelbase == 2.7


@pytest.mark.parametrize(
    ("lens", "expected"),
    [
        (
            {"model": "brown_conrady", "focal": [500, 501], "centre": [1, 2], "distortion": [-0.1, 0.2, 1e-3, 2e-3, 3]},
            BrownConradyCamera(640, 480, 500.0, 501.0, 1.0, 2.0, -0.1, 0.2, 1e-3, 2e-3, 3.0),
        ),
        (
            {"model": "kannala_brandt", "focal": [300, 301], "centre": [1, 2], "distortion": [0.1, 0.2, 0.3, 0.4]},
            KannalaBrandtCamera(640, 480, 300.0, 301.0, 1.0, 2.0, 0.1, 0.2, 0.3, 0.4),
        ),
        (
            {"model": "equidistant", "centre": [1, 2], "pixels_per_radian": 300},
            FthetaCamera.equidistant(640, 480, 1.0, 2.0, 300.0),
        ),
        (
            {"model": "ftheta", "centre": [1, 2], "radius_to_angle": [0, 3e-3, 0, 1e-10]},
            FthetaCamera.from_radius_to_angle(640, 480, 1.0, 2.0, (0.0, 3e-3, 0.0, 1e-10)),
        ),
        (
            {
                "model": "ftheta",
                "centre": [1, 2],
                "radius_to_angle": [0, 3e-3],
                "angle_to_radius": [0, 333.0],
                "primary": "backward",
            },
            FthetaCamera(640, 480, 1.0, 2.0, (0.0, 333.0), (0.0, 3e-3), primary="backward"),
        ),
        (
            {"model": "perspective", "horizontal_field_of_view_degrees": 70},
            PinholeCamera.from_field_of_view(640, 480, float(np.radians(70.0))),
        ),
    ],
)
def test_every_lens_can_be_written(tmp_path, lens, expected):
    rig = {**RIG, "cameras": {"left": {**CAMERA, "lens": lens}}}
    assert read_rig(write(tmp_path, rig))["left"].camera == expected


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"vehicle": {**RIG["vehicle"], "wheelbase": None}}, "vehicle.wheelbase"),
        ({"vehicle": {k: v for k, v in RIG["vehicle"].items() if k != "track_width"}}, "vehicle.track_width"),
        ({"assumed": None}, "assumed"),
        ({"colour": "red"}, "colour"),
        ({"cameras": {}}, "cameras"),
        ({"cameras": {"left": {**CAMERA, "lens": {"model": "plenoptic"}}}}, "cameras.left.lens"),
        ({"cameras": {"left": {**CAMERA, "position": [1.0, 2.0]}}}, "cameras.left.position"),
        ({"cameras": {"left": {**CAMERA, "position": [1.0, 2.0, float("nan")]}}}, "cameras.left.position"),
        ({"cameras": {"left": {**CAMERA, "quaternion_xyzw": [0, 0, 0, 1]}}}, "exactly one of"),
        (
            {
                "cameras": {
                    "left": {
                        **CAMERA,
                        "lens": {"model": "ftheta", "centre": [1, 2], "radius_to_angle": [0, 3e-3, 0, -1e-8]},
                    }
                }
            },
            "does not rise to the corner",
        ),
    ],
)
def test_wrong_files_are_refused_with_the_field(tmp_path, change, message):
    with pytest.raises(InputError, match=message) as caught:
        read_rig(write(tmp_path, {**RIG, **change}))
    assert "mine.yaml" in str(caught.value) and "\n" not in str(caught.value)
