"""Visual odometry on rendered drives whose motion is known."""

from functools import lru_cache

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from olt_generator.cameras import FthetaCamera, PinholeCamera, pixel_rays
from olt_generator.errors import InputError
from olt_generator.motion.odometry import choose_keyframes, estimate_odometry
from olt_generator.motion.smoother import ODOMETRY_SETTINGS
from olt_generator.poses import R_FORWARD_CAMERA, camera_pose_in_rig, planar_pose
from olt_generator.trajectory import Trajectory

PINHOLE = PinholeCamera.from_field_of_view(416, 240, np.radians(80.0))
FTHETA = FthetaCamera.equidistant(416, 240, 207.5, 119.5, 416 / np.radians(120.0))
MOUNTING = camera_pose_in_rig([1.5, 0.0, 1.5], 0.0, np.radians(2.0), np.radians(-1.0))
ROUGH_MOUNTING = camera_pose_in_rig([1.5, 0.0, 1.5], 0.0, 0.0, 0.0)
TEXEL = 0.06
# Point and normal of the road, two facades and a far wall.
PLANES = [((0, 0, 0), (0, 0, 1)), ((0, 7, 0), (0, -1, 0)), ((0, -9, 0), (0, 1, 0)), ((90, 0, 0), (-1, 0, 0))]


@lru_cache(maxsize=1)
def texture():
    noise = np.random.default_rng(5).uniform(-1, 1, (2048, 2048)).astype(np.float32)
    coarse = cv2.resize(noise[:256, :256], (2048, 2048), interpolation=cv2.INTER_CUBIC)
    return 55 * cv2.GaussianBlur(noise, (0, 0), 1.5) / 0.1 * 0.3 + 40 * coarse


def render(camera, T_world_camera):
    """Ray-cast the planes; texture fades with distance, so that it does not alias."""
    rays = pixel_rays(camera) @ T_world_camera[:3, :3].T
    nearest, gray = np.full(rays.shape[:2], np.inf), np.full(rays.shape[:2], 200.0)
    for point, normal in PLANES:
        facing = rays @ normal
        distance = np.where(facing < -1e-6, (np.array(point) - T_world_camera[:3, 3]) @ normal / facing, np.inf)
        hit = (distance > 0) & (distance < nearest)
        place = T_world_camera[:3, 3] + np.where(hit, distance, 0.0)[..., None] * rays
        if not np.any(normal[2]):
            hit &= place[..., 2] < 9.0
        along, across = (place[..., 0], place[..., 1]) if normal[2] else (place[..., 0] + place[..., 1], place[..., 2])
        table = [(value / TEXEL + 1000.0).astype(np.float32) % 2047 for value in (along, across)]
        value = cv2.remap(texture(), table[0], table[1], cv2.INTER_LINEAR)
        gray = np.where(hit, 120 + value * np.exp(-np.minimum(distance, 1e3) / 30.0), gray)
        nearest = np.where(hit, distance, nearest)
    noise = np.random.default_rng(int(1e3 * T_world_camera[0, 3])).standard_normal(gray.shape)
    return np.repeat(np.clip(gray + noise, 0, 255).astype(np.uint8)[..., None], 3, axis=-1)


def drive(camera, seconds, speed=8.0, yaw_rate=0.12):
    """Frames, timestamps and true trajectory of a drive with a steady turn."""
    yaw = yaw_rate * seconds
    if yaw_rate:
        x, y = speed / yaw_rate * np.sin(yaw), speed / yaw_rate * (1 - np.cos(yaw))
    else:
        x, y = speed * seconds, 0.0 * seconds
    T_world_rig = planar_pose(x, y, yaw)
    frames = np.stack([render(camera, pose @ MOUNTING) for pose in T_world_rig])
    timestamps_us = np.rint(seconds * 1e6).astype(np.int64)
    return frames, timestamps_us, Trajectory(timestamps_us, T_world_rig)


@lru_cache(maxsize=8)
def ten_hertz_drive(camera, yaw_rate=0.12):
    return drive(camera, np.arange(14) * 0.1, yaw_rate=yaw_rate)


def check_motion(odometry, true, tolerance=0.03):
    """Close to the truth, and as close as is stated."""
    end_error = np.linalg.norm(odometry.trajectory.positions - true.positions, axis=1).max()
    assert end_error < tolerance * true.path_length
    turned = Rotation.from_matrix(odometry.trajectory.T_world_rig[:, :3, :3])
    angles = (Rotation.from_matrix(true.T_world_rig[:, :3, :3]).inv() * turned).magnitude()
    assert np.degrees(angles.max()) < 0.5
    assert odometry.covariance.shape == (len(true), 6, 6)
    assert not odometry.covariance[0, :3].any()
    assert np.linalg.eigvalsh(odometry.covariance).min() > -1e-12


@pytest.mark.parametrize("camera", [PINHOLE, FTHETA], ids=["pinhole", "f-theta"])
def test_metric_motion_and_mounting_from_rough_angles(camera):
    frames, timestamps_us, true = ten_hertz_drive(camera)
    odometry = estimate_odometry(frames, timestamps_us, camera, ROUGH_MOUNTING)
    check_motion(odometry, true)
    assert np.allclose(odometry.trajectory.T_world_rig[0], np.eye(4), atol=1e-12)
    between = Rotation.from_matrix(odometry.T_rig_camera[:3, :3].T @ MOUNTING[:3, :3])
    assert np.degrees(between.magnitude()) < 0.3
    assert np.array_equal(odometry.T_rig_camera[:3, 3], ROUGH_MOUNTING[:3, 3])
    assert 0.0 < odometry.scale_sigma < 0.1
    assert odometry.noise == ODOMETRY_SETTINGS
    assert odometry.inliers.min() > 100
    assert not odometry.standstill.any()
    assert odometry.doubts == ()


def test_scale_follows_the_stated_camera_height():
    frames, timestamps_us, true = ten_hertz_drive(PINHOLE)
    taller = camera_pose_in_rig([1.5, 0.0, 1.8], 0.0, 0.0, 0.0)
    odometry = estimate_odometry(frames, timestamps_us, PINHOLE, taller)
    assert odometry.trajectory.path_length == pytest.approx(1.2 * true.path_length, rel=0.03)


def test_every_frame_of_a_fast_video_has_its_pose():
    frames, timestamps_us, true = drive(PINHOLE, np.arange(20) / 30.0)
    odometry = estimate_odometry(frames, timestamps_us, PINHOLE, MOUNTING)
    check_motion(odometry, true)
    steps = np.linalg.norm(np.diff(odometry.trajectory.positions, axis=0), axis=1)
    assert steps == pytest.approx(8.0 / 30.0, rel=0.1)


def test_five_frames_are_enough():
    frames, timestamps_us, true = drive(PINHOLE, np.arange(5) / 30.0)
    check_motion(estimate_odometry(frames, timestamps_us, PINHOLE, MOUNTING), true, tolerance=0.06)


def cover(frames, bonnet=0, bar=0):
    """The frames with a bonnet of so many rows, in which the surroundings do not move, and a bar across the road."""
    frames = frames.copy()
    if bonnet:
        frames[:, -bonnet:] = np.clip(120 + 4 * texture()[:bonnet, : frames.shape[2], None], 0, 255).astype(np.uint8)
    frames[:, 150 : 150 + bar] = 230
    return frames


@pytest.mark.parametrize("rows", [30, 60])
def test_a_bonnet_is_not_taken_for_road(rows):
    """Its texture is the strongest in the picture, and at 60 rows most of what is near."""
    frames, timestamps_us, true = ten_hertz_drive(PINHOLE, yaw_rate=0.0)
    odometry = estimate_odometry(cover(frames, bonnet=rows), timestamps_us, PINHOLE, ROUGH_MOUNTING)
    check_motion(odometry, true)
    assert odometry.doubts == ()


def test_a_bar_across_the_road_leaves_the_scale_as_good_as_it_says():
    frames, timestamps_us, true = ten_hertz_drive(PINHOLE, yaw_rate=0.0)
    odometry = estimate_odometry(cover(frames, bar=4), timestamps_us, PINHOLE, ROUGH_MOUNTING)
    error = np.log(odometry.trajectory.path_length / true.path_length)
    assert abs(error) < 3.0 * odometry.scale_sigma < 0.2


def test_a_drive_with_the_road_covered_is_no_standstill_without_a_doubt():
    frames, timestamps_us, _ = ten_hertz_drive(PINHOLE, yaw_rate=0.0)
    odometry = estimate_odometry(cover(frames, bonnet=60, bar=4), timestamps_us, PINHOLE, ROUGH_MOUNTING)
    assert odometry.standstill.all()
    assert [doubt.what for doubt in odometry.doubts] == ["standstill"]


def test_reversing_moves_backward():
    frames, timestamps_us, true = ten_hertz_drive(PINHOLE)
    backward = Trajectory(timestamps_us, true.T_world_rig[::-1].copy()).in_first_frame()
    odometry = estimate_odometry(frames[::-1].copy(), timestamps_us, PINHOLE, MOUNTING)
    check_motion(odometry, backward)
    assert odometry.trajectory.positions[-1, 0] < -8.0
    # At 8 m/s it is rather the camera that looks back.
    assert [doubt.what for doubt in odometry.doubts] == ["view direction"]
    assert odometry.scale_sigma > 0.5


def test_reversing_as_one_parks_is_no_doubt():
    frames, timestamps_us, true = drive(PINHOLE, np.arange(20) * 0.1, speed=2.0, yaw_rate=0.0)
    backward = Trajectory(timestamps_us, true.T_world_rig[::-1].copy()).in_first_frame()
    odometry = estimate_odometry(frames[::-1].copy(), timestamps_us, PINHOLE, MOUNTING)
    check_motion(odometry, backward)
    assert odometry.doubts == ()


def test_standstill_is_exact_and_has_no_scale():
    frame = ten_hertz_drive(PINHOLE)[0][0].astype(np.int16)
    noise = np.random.default_rng(0).integers(-2, 3, (6, *frame.shape))
    frames = np.clip(frame + noise, 0, 255).astype(np.uint8)
    odometry = estimate_odometry(frames, np.arange(6, dtype=np.int64) * 100_000, PINHOLE, MOUNTING)
    assert np.allclose(odometry.trajectory.T_world_rig, np.eye(4), atol=1e-12)
    assert odometry.standstill.all()
    assert odometry.scale_sigma is None
    assert odometry.doubts == ()
    # It may roll unseen, along the way that it looks.
    assert np.diag(odometry.covariance[-1])[:3] == pytest.approx([0.015**2, 0.0, 0.0], abs=1e-6)


@pytest.mark.parametrize("rate", [0.1, 0.6])
def test_turning_on_the_spot_is_no_travel(rate):
    yaw = 0.1 * rate * np.arange(8)
    T_world_camera = np.tile(MOUNTING, (8, 1, 1))
    T_world_camera[:, :3, :3] = planar_pose(0.0, 0.0, yaw)[:, :3, :3] @ MOUNTING[:3, :3]
    frames = np.stack([render(PINHOLE, pose) for pose in T_world_camera])
    odometry = estimate_odometry(frames, np.arange(8, dtype=np.int64) * 100_000, PINHOLE, MOUNTING)
    camera_path = (odometry.trajectory.T_world_rig @ odometry.T_rig_camera)[:, :3, 3]
    assert np.ptp(camera_path, axis=0).max() < 1e-9
    turned = Rotation.from_matrix(odometry.trajectory.T_world_rig[-1, :3, :3]).as_rotvec()
    assert turned == pytest.approx([0.0, 0.0, yaw[-1]], abs=0.003)
    assert odometry.scale_sigma is None


@pytest.mark.parametrize("change", ["times that jitter", "gaps", "late clock", "saturated"])
def test_rough_input_still_gives_the_motion(change):
    frames, timestamps_us, true = ten_hertz_drive(PINHOLE)
    kept = np.arange(len(frames))
    if change == "times that jitter":
        # Only positions are compared, so the stamps may be wrong by a quarter of a step.
        timestamps_us = timestamps_us + np.random.default_rng(1).integers(-25_000, 25_000, len(timestamps_us))
    elif change == "gaps":
        kept = np.delete(kept, [3, 4, 8])
    elif change == "late clock":
        timestamps_us = timestamps_us + 4 * 10**15
    else:
        frames = np.clip(6 * frames.astype(np.int16) - 400, 0, 255).astype(np.uint8)
    odometry = estimate_odometry(frames[kept], timestamps_us[kept], PINHOLE, MOUNTING)
    expected = Trajectory(timestamps_us[kept], true.T_world_rig[kept])
    check_motion(odometry, expected, 0.05)


def test_stopping_and_starting():
    seconds = np.arange(26) * 0.1
    # Brake from 3 m/s to 0 in the first second, stand half a second, start again.
    x = 3.0 * np.minimum(seconds, 1.0) - 1.5 * np.minimum(seconds, 1.0) ** 2 + 1.5 * np.maximum(seconds - 1.5, 0.0) ** 2
    true = Trajectory(np.rint(seconds * 1e6).astype(np.int64), planar_pose(x, 0.0, 0.0))
    frames = np.stack([render(PINHOLE, pose @ MOUNTING) for pose in true.T_world_rig])
    odometry = estimate_odometry(frames, true.timestamps_us, PINHOLE, MOUNTING)
    assert odometry.standstill[10:15].all()
    assert not odometry.standstill[:9].any()
    assert not odometry.standstill[16:].any()
    check_motion(odometry, true, tolerance=0.05)


def test_same_input_gives_same_bytes():
    frames, timestamps_us, _ = ten_hertz_drive(PINHOLE)
    runs = [estimate_odometry(frames[:6], timestamps_us[:6], PINHOLE, MOUNTING) for _ in range(2)]
    assert runs[0].trajectory.T_world_rig.tobytes() == runs[1].trajectory.T_world_rig.tobytes()


def test_progress_runs_from_nothing_to_all():
    frames, timestamps_us, _ = ten_hertz_drive(PINHOLE)
    shares = []
    estimate_odometry(frames[:4], timestamps_us[:4], PINHOLE, MOUNTING, shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_a_black_frame_is_named():
    frames, timestamps_us, _ = ten_hertz_drive(PINHOLE)
    frames = frames.copy()
    frames[5] = 0
    with pytest.raises(InputError, match="frame 5 shares only 0"):
        estimate_odometry(frames, timestamps_us, PINHOLE, MOUNTING)


@pytest.mark.parametrize("value", [0, 255])
def test_blank_video_is_refused(value):
    frames = np.full((4, 240, 416, 3), value, dtype=np.uint8)
    with pytest.raises(InputError, match="frame 1 shares only 0"):
        estimate_odometry(frames, np.arange(4, dtype=np.int64) * 100_000, PINHOLE, MOUNTING)


def test_what_cannot_be_measured_is_refused():
    frames, timestamps_us, _ = ten_hertz_drive(PINHOLE)
    with pytest.raises(InputError, match="at least 2"):
        estimate_odometry(frames[:1], timestamps_us[:1], PINHOLE, MOUNTING)
    with pytest.raises(InputError, match=r"frames 1 and 2 are 0\.90 s apart"):
        estimate_odometry(frames[[0, 1, 10]], timestamps_us[[0, 1, 10]], PINHOLE, MOUNTING)
    with pytest.raises(InputError, match="true height"):
        estimate_odometry(frames, timestamps_us, PINHOLE, camera_pose_in_rig([1.5, 0, 0], 0, 0, 0))


def test_a_view_without_road_is_refused():
    camera = PINHOLE.cropped(0, 0, 416, 116)
    frames, timestamps_us, _ = ten_hertz_drive(PINHOLE)
    with pytest.raises(InputError, match="no road"):
        estimate_odometry(frames[:4, :116].copy(), timestamps_us[:4], camera, MOUNTING)


def test_keyframes_are_a_tenth_of_a_second_apart():
    assert choose_keyframes(np.arange(10, dtype=np.int64) * 33_333) == [0, 3, 6, 9]
    assert choose_keyframes(np.arange(5, dtype=np.int64) * 103_500) == [0, 1, 2, 3, 4]
    assert choose_keyframes(np.array([0, 40_000])) == [0, 1]


def test_forward_camera_convention_of_the_renderer():
    assert np.allclose(MOUNTING[:3, :3] @ R_FORWARD_CAMERA.T @ [1, 0, 0], [1, 0, 0], atol=0.06)
