"""Verification of real motions and rigs: they pass as they are, and faults planted into them are found."""

import numpy as np
import pytest

from olt_generator.poses import invert
from olt_generator.trajectory import Trajectory
from olt_toolkit import OpenOptions, open_recording
from olt_toolkit.clips.clip import EgoMotion
from olt_toolkit.clips.verification.calibration_checks import check_mounting
from olt_toolkit.clips.verification.drivability import check_poses, check_repeated_poses
from olt_toolkit.clips.verification.findings import Verdict
from olt_toolkit.clips.verification.motion_table import check_anchor, check_columns
from olt_toolkit.rigs.rig import CROSS_LEFT, CROSS_RIGHT, DEFAULT_VEHICLE, FRONT_WIDE, REAR_LEFT, REAR_RIGHT

KITTI_DRIVE = "kitti_raw_2011_09_26_drive_0013"


@pytest.fixture(scope="module", params=["kitti_raw", "kitti_odometry", "kitti_slow", "nvidia"])
def trajectory(request, shared_real):
    """GPS/IMU, LiDAR odometry in traffic, and poses of a PhysicalAI-AV vehicle."""
    if request.param == "nvidia":
        poses = np.load(shared_real / "nvidia_clip_map_and_ego_poses" / "vehicle_pose.npy", allow_pickle=False)
        times_us = np.round(np.arange(len(poses)) * (1e6 / 30.0)).astype(np.int64)
        return Trajectory(times_us, poses.astype(np.float64))
    folder = {
        "kitti_raw": KITTI_DRIVE,
        "kitti_odometry": "kitti_odometry_06_first51_gray",
        "kitti_slow": "kitti_slow_traffic_lidar_poses",
    }[request.param]
    reference = open_recording(shared_real / folder, OpenOptions(width=64)).reference
    assert reference is not None
    return reference


def failed(motion):
    found = [*check_poses(motion, ""), *check_columns(motion, ""), *check_anchor(motion, "")]
    found.append(check_repeated_poses(motion, ""))
    return {each.check for each in found if each.verdict is Verdict.FAILED}


def test_nothing_is_said_of_real_motion(trajectory):
    assert failed(EgoMotion.from_trajectory(trajectory)) == set()


def test_units_and_directions_are_found_in_real_motion(trajectory):
    poses, times_us = trajectory.T_world_rig, trajectory.timestamps_us
    centimetres = poses.copy()
    centimetres[:, :3, 3] *= 100.0
    assert failed(EgoMotion.from_trajectory(Trajectory(times_us, centimetres)))
    about = EgoMotion.from_trajectory(Trajectory(times_us, poses @ np.diag([-1.0, -1.0, 1.0, 1.0])))
    verdicts = {each.check: each.verdict for each in check_poses(about, "")}
    # In slow traffic it is for images to tell.
    assert verdicts["drives forward"] in (Verdict.FAILED, Verdict.NOT_COMPARED)
    motion = EgoMotion.from_trajectory(trajectory)
    late = Trajectory(times_us - 500_000, motion.trajectory.T_world_rig)
    assert failed(EgoMotion(late, motion.velocity, motion.acceleration, motion.curvature)) >= {"anchor position"}


def test_the_nvidia_rig_looks_where_its_names_say(nvidia_rig):
    for name, mounted in nvidia_rig.items():
        assert all(each.verdict is Verdict.PASSED for each in check_mounting(name, mounted, DEFAULT_VEHICLE, ""))
    for name, other in ((CROSS_LEFT, CROSS_RIGHT), (REAR_LEFT, REAR_RIGHT), (FRONT_WIDE, CROSS_LEFT)):
        found = check_mounting(name, nvidia_rig[other], DEFAULT_VEHICLE, "")
        assert "looks where its name says" in {each.check for each in found if each.verdict is Verdict.FAILED}


def test_mountings_told_the_other_way_round_are_found(nvidia_rig):
    for name, mounted in nvidia_rig.items():
        turned = type(mounted)(mounted.camera, invert(mounted.T_rig_camera))
        assert any(each.verdict is Verdict.FAILED for each in check_mounting(name, turned, DEFAULT_VEHICLE, ""))
