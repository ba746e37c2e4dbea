"""A velocity in the wrong frame is found on a nearly straight drive; what cannot be shown is not said to be right."""

from dataclasses import replace

import numpy as np

from olt_generator.poses import planar_pose
from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.clip import EgoMotion
from olt_toolkit.clips.verification.findings import Verdict
from olt_toolkit.clips.verification.motion_table import check_columns


def drive(turn):
    """8 m/s for 6 s, with so many radians of turn to the left and back, and 1 cm of noise that is smooth in time."""
    seconds = np.arange(0.0, 6.05, 0.1)
    yaw = turn * np.sin(np.pi * seconds / 6.0) ** 2
    step = 0.8 * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    way = np.concatenate([[[0.0, 0.0]], np.cumsum(step[:-1], axis=0)])
    way += 0.01 * np.sin(2.0 * seconds)[:, None]
    poses = planar_pose(way[:, 0], way[:, 1], yaw)
    return EgoMotion.from_trajectory(Trajectory(np.round(seconds * 1e6).astype(np.int64), poses))


def verdicts(motion):
    return {finding.check: finding.verdict for finding in check_columns(motion, "here")}


def in_rig_frame(motion):
    rotations = motion.trajectory.T_world_rig[:, :3, :3]
    return replace(motion, velocity=np.einsum("nji,nj->ni", rotations, motion.velocity))


def test_a_velocity_in_the_rig_frame_is_found_though_the_drive_hardly_turns():
    for turn in (0.05, 0.1, 0.5):
        assert verdicts(drive(turn))["velocity column"] is Verdict.PASSED
        assert verdicts(in_rig_frame(drive(turn)))["velocity column"] is Verdict.FAILED


def test_a_velocity_column_on_a_straight_drive_is_the_same_in_both_frames():
    assert verdicts(in_rig_frame(drive(0.0)))["velocity column"] is Verdict.PASSED


def test_turns_too_small_to_show_a_wrong_unit_are_not_compared():
    gentle = drive(0.03)
    wrong = replace(gentle, curvature=gentle.curvature / 3.281)
    assert verdicts(gentle)["curvature column"] is Verdict.NOT_COMPARED
    assert verdicts(wrong)["curvature column"] is Verdict.NOT_COMPARED
    turning = drive(0.5)
    assert verdicts(turning)["curvature column"] is Verdict.PASSED
    assert verdicts(replace(turning, curvature=turning.curvature / 3.281))["curvature column"] is Verdict.FAILED
