"""Poses that a vehicle can drive pass at any pace, and what no vehicle does fails."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from olt_generator.poses import planar_pose
from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.clip import EgoMotion
from olt_toolkit.clips.verification.drivability import check_poses, check_repeated_poses
from olt_toolkit.clips.verification.findings import Verdict
from olt_toolkit.clips.verification.motion_table import check_anchor, check_columns


def drive(speed, curvature, seconds=8.0, rate=20.0):
    """Along a circle, or straight on, at an even pace (negative: backward)."""
    times_us = np.round(np.arange(int(seconds * rate) + 1) * (1e6 / rate)).astype(np.int64)
    way = speed * times_us * 1e-6
    yaw = curvature * way
    x, y = (way, 0.0 * way) if curvature == 0.0 else (np.sin(yaw) / curvature, (1.0 - np.cos(yaw)) / curvature)
    return Trajectory(times_us, planar_pose(x, y, yaw))


def findings(trajectory):
    motion = EgoMotion.from_trajectory(trajectory)
    found = [*check_poses(motion, "here"), *check_columns(motion, "here"), *check_anchor(motion, "here")]
    return {each.check: each for each in [*found, check_repeated_poses(motion, "here")]}


def failed(trajectory):
    return {name for name, each in findings(trajectory).items() if each.verdict is Verdict.FAILED}


@example(speed=0.25, side=1.0, rate=10.0)
@example(speed=0.25, side=1.0, rate=25.0)
@example(speed=0.25, side=1.0, rate=100.0)
@given(speed=st.floats(0.0, 60.0), side=st.floats(-1.0, 1.0), rate=st.sampled_from([10.0, 25.0, 100.0]))
def test_every_even_drive_passes(speed, side, rate):
    # As sharp as tyres and steering allow at this speed.
    curvature = side * min(0.25, 8.0 / max(speed, 0.1) ** 2)
    assert failed(drive(speed, curvature, rate=rate)) == set()


@given(speed=st.floats(3.0, 30.0), sign=st.sampled_from([-1.0, 1.0]))
def test_a_mirrored_way_is_told_from_a_true_one(speed, sign):
    trajectory = drive(speed, sign * 0.25 / speed)
    mirrored = trajectory.T_world_rig.copy()
    mirrored[:, 1, 3] *= -1.0
    assert "turns with its way" in failed(Trajectory(trajectory.timestamps_us, mirrored))
    transposed = trajectory.T_world_rig.copy()
    transposed[:, :3, :3] = transposed[:, :3, :3].transpose(0, 2, 1)
    assert "turns with its way" in failed(Trajectory(trajectory.timestamps_us, transposed))


def test_straight_on_has_no_left_and_right():
    found = findings(drive(10.0, 0.0))
    assert found["turns with its way"].verdict is Verdict.NOT_COMPARED
    assert found["curvature column"].verdict is Verdict.NOT_COMPARED
    assert found["velocity column"].verdict is Verdict.PASSED


def test_standing_still_is_no_fault_and_compares_little():
    found = findings(drive(0.0, 0.0))
    assert not any(each.verdict is Verdict.FAILED for each in found.values())
    for check in ("along the heading", "turns with its way", "velocity column", "acceleration column"):
        assert found[check].verdict is Verdict.NOT_COMPARED and found[check].detail


@pytest.mark.parametrize(
    ("speed", "seconds", "verdict"),
    [(-2.0, 4.0, Verdict.NOT_COMPARED), (-5.0, 8.0, Verdict.FAILED), (-9.0, 2.0, Verdict.FAILED)],
)
def test_driving_backward_is_for_images_to_tell_unless_it_is_long_or_fast(speed, seconds, verdict):
    assert findings(drive(speed, 0.0, seconds))["drives forward"].verdict is verdict


@pytest.mark.parametrize(
    ("change", "check"),
    [
        (lambda poses: poses @ np.diag([1.0, -1.0, -1.0, 1.0]), "upright"),
        (lambda poses: _with_jump(poses, 2.0), "jerk"),
        (lambda poses: _turned_about(poses, np.pi / 2), "along the heading"),
        (lambda poses: _scaled(poses, 100.0), "speed"),
    ],
)
def test_what_no_vehicle_does_fails(change, check):
    trajectory = drive(10.0, 0.02)
    assert check in failed(Trajectory(trajectory.timestamps_us, change(trajectory.T_world_rig.copy())))


def test_curvature_of_a_vehicle_that_creeps_is_a_convention_and_not_compared():
    assert findings(drive(0.2, 0.25))["curvature column"].verdict is Verdict.NOT_COMPARED


def test_spinning_on_the_spot_fails():
    times_us = np.arange(0, 5_000_001, 100_000)
    trajectory = Trajectory(times_us, planar_pose(0.0 * times_us, 0.0, 0.5e-6 * times_us))
    assert "curvature of the way" in failed(trajectory)


def test_a_late_motion_has_another_anchor():
    trajectory = drive(5.0, 0.0)
    late = EgoMotion.from_trajectory(trajectory)
    shifted = EgoMotion(
        Trajectory(trajectory.timestamps_us - 100_000, late.trajectory.T_world_rig),
        late.velocity,
        late.acceleration,
        late.curvature,
    )
    position, heading = check_anchor(shifted, "here")
    assert (position.verdict, heading.verdict) == (Verdict.FAILED, Verdict.PASSED)
    assert position.measured == pytest.approx(0.5)


def test_a_repeated_row_is_told_with_its_number():
    motion = EgoMotion.from_trajectory(drive(5.0, 0.0))
    poses = motion.trajectory.T_world_rig.copy()
    poses[40] = poses[39]
    repeated = EgoMotion(
        Trajectory(motion.trajectory.timestamps_us, poses), motion.velocity, motion.acceleration, motion.curvature
    )
    finding = check_repeated_poses(repeated, "here")
    assert finding.verdict is Verdict.FAILED and "row 40" in finding.detail


def _with_jump(poses, metres):
    poses[len(poses) // 2 :, 1, 3] += metres
    return poses


def _turned_about(poses, yaw):
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("z", yaw).as_matrix()
    return poses @ turn


def _scaled(poses, factor):
    poses[:, :3, 3] *= factor
    return poses
