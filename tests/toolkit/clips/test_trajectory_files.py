"""Files of poses, read back without the code that wrote them."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from olt_generator.camera_spread import CameraSpread, Spread
from olt_generator.doubts import Doubt
from olt_generator.motion.pose_sources import PoseEstimate
from olt_generator.motion.smoother import ODOMETRY_SETTINGS, smooth_trajectory
from olt_generator.poses import camera_pose_in_rig, invert, planar_pose
from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.motion_uncertainty import camera_covariance
from olt_toolkit.clips.pose_choices import PoseFormat, PoseOf
from olt_toolkit.clips.recovered_motion import RecoveredMotion
from olt_toolkit.clips.trajectory_files import describe_poses, write_poses

MOUNTING = camera_pose_in_rig([1.5, 0.3, 1.4], 0.0, 0.03, -0.02)


def recover(seed=0, covariance=True, poses=30):
    random = np.random.default_rng(seed)
    turn, speed = random.uniform(-0.3, 0.3), random.uniform(0.0, 20.0)
    times_us = np.cumsum(random.integers(60_000, 140_000, poses)).astype(np.int64)
    seconds = (times_us - times_us[0]) * 1e-6
    path = Trajectory(times_us, planar_pose(speed * seconds, 0.5 * speed * turn * seconds**2, turn * seconds))
    root = random.standard_normal((poses, 6, 6)) * 0.01
    found = PoseEstimate(
        path,
        MOUNTING,
        0.03,
        ODOMETRY_SETTINGS,
        covariance=root @ np.swapaxes(root, -1, -2) if covariance else None,
        doubts=(Doubt("speed", "two ways differ"),),
    )
    spread = CameraSpread(Spread(0.04, "given"), Spread(0.0, "calibrated"))
    return RecoveredMotion(found, smooth_trajectory(path, ODOMETRY_SETTINGS), spread, None)


def read(path, format_):
    """Poses (n, 4, 4) as the format is documented."""
    poses = np.tile(np.eye(4), (30, 1, 1))
    if format_ is PoseFormat.KITTI:
        poses[:, :3] = np.loadtxt(path).reshape(30, 3, 4)
        return poses
    if format_ is PoseFormat.TUM:
        values = np.loadtxt(path, comments="#")[:, 1:]
    else:
        table = pq.read_table(path)
        values = np.stack([table[name].to_numpy() for name in ("x", "y", "z", "qx", "qy", "qz", "qw")], axis=1)
    poses[:, :3, 3] = values[:, :3]
    poses[:, :3, :3] = Rotation.from_quat(values[:, 3:]).as_matrix()
    return poses


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(PoseFormat), st.sampled_from(PoseOf))
def test_poses_come_back(tmp_path_factory, seed, format_, of):
    motion, path = recover(seed, covariance=False), tmp_path_factory.mktemp("poses") / "poses"
    write_poses(path, format_, describe_poses(motion, of, "drive"))
    rig = motion.smoothed.trajectory.in_first_frame().T_world_rig
    expected = rig if of is PoseOf.RIG else invert(MOUNTING) @ rig @ MOUNTING
    assert np.abs(read(path, format_) - expected).max() < 2e-8


@pytest.mark.parametrize("of", PoseOf)
def test_parquet_holds_the_total_covariance_and_what_is_known(tmp_path, of):
    motion, path = recover(), tmp_path / "poses.parquet"
    write_poses(path, PoseFormat.PARQUET, describe_poses(motion, of, "drive"))
    table = pq.read_table(path)
    stored = np.array(table["covariance"].to_pylist()).reshape(-1, 6, 6)
    expected = motion.covariance
    if of is PoseOf.CAMERA:
        expected = camera_covariance(expected, motion.smoothed.trajectory, MOUNTING)
    assert stored == pytest.approx(expected)
    assert table["timestamp_us"].to_pylist() == motion.smoothed.trajectory.timestamps_us.tolist()
    told = json.loads(table.schema.metadata[b"olt_trajectory"])
    assert told["covariance"].startswith("6 x 6, row by row")
    assert told["scale_sigma"]["total"] == pytest.approx(0.05)
    assert told["doubts"] == [{"what": "speed", "why": "two ways differ"}]
    assert np.array(told["T_rig_camera"]) == pytest.approx(MOUNTING)


def test_an_unknown_covariance_is_no_column_and_said(tmp_path):
    path = tmp_path / "poses.parquet"
    write_poses(path, PoseFormat.PARQUET, describe_poses(recover(covariance=False), PoseOf.RIG, "drive"))
    table = pq.read_table(path)
    assert "covariance" not in table.column_names
    assert json.loads(table.schema.metadata[b"olt_trajectory"])["covariance"] == "not known"


def test_a_write_that_fails_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "poses.kitti"
    path.write_text("old")
    monkeypatch.setattr(np, "savetxt", lambda *_, **__: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write_poses(path, PoseFormat.KITTI, describe_poses(recover(), PoseOf.CAMERA, "drive"))
    assert [each.name for each in tmp_path.iterdir()] == ["poses.kitti"]
    assert path.read_text() == "old"
