"""The paper's pose metrics."""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from olt_generator.errors import InputError
from olt_generator.motion.pose_metrics import align_similarity, compare_trajectories, measure_smoothness
from olt_generator.poses import make_pose, planar_pose
from olt_generator.trajectory import Trajectory

angles = st.floats(-3.0, 3.0)
vectors = st.tuples(angles, angles, angles).map(np.array)


def curve(count=30, step_us=100_000):
    seconds = np.arange(count) * step_us * 1e-6
    poses = planar_pose(8.0 * seconds, 0.5 * seconds**2, 0.1 * seconds, 0.02 * seconds**2)
    return Trajectory(np.arange(count, dtype=np.int64) * step_us, poses)


def transformed(trajectory, rotation, translation, scale=1.0):
    poses = trajectory.T_world_rig.copy()
    poses[:, :3, 3] *= scale
    return Trajectory(trajectory.timestamps_us, make_pose(rotation.as_matrix(), translation) @ poses)


@settings(max_examples=25, deadline=None)
@given(vectors, vectors)
def test_the_same_motion_elsewhere_has_no_error(turn, shift):
    errors = compare_trajectories(transformed(curve(), Rotation.from_rotvec(turn), 1e3 * shift), curve())
    assert errors.metric.ate_m < 1e-8
    assert errors.metric.rotation_to_first_deg < 1e-5
    assert errors.metric.step_rotation_deg < 1e-5
    assert errors.metric.step_translation_percent < 1e-6
    assert errors.metric.drift_percent < 1e-6
    assert errors.sim3.scale == pytest.approx(1.0)


@settings(max_examples=25, deadline=None)
@given(vectors, vectors, st.floats(0.1, 10.0))
def test_similarity_does_not_count_after_alignment(turn, shift, scale):
    moved = transformed(curve(), Rotation.from_rotvec(turn), shift, scale)
    errors = compare_trajectories(moved, curve())
    assert errors.sim3.ate_m < 1e-8
    assert errors.sim3.scale == pytest.approx(1.0 / scale)
    assert errors.sim3.step_translation_percent < 1e-6


def test_scale_error_shows_in_the_metric_protocol():
    errors = compare_trajectories(transformed(curve(), Rotation.identity(), np.zeros(3), 1.05), curve())
    assert errors.metric.step_translation_percent == pytest.approx(5.0)
    end = np.linalg.norm(curve().positions[-1])
    assert errors.metric.drift_percent == pytest.approx(5.0 * end / curve().path_length)


def test_constant_turn_rate_error():
    count = 21
    drift = Rotation.from_rotvec(np.radians(0.1) * np.arange(count)[:, None] * [0.0, 0.0, 1.0]).as_matrix()
    reference = Trajectory(np.arange(count, dtype=np.int64) * 100_000, np.tile(np.eye(4), (count, 1, 1)))
    errors = compare_trajectories(Trajectory(reference.timestamps_us, make_pose(drift, np.zeros(3))), reference)
    assert errors.metric.step_rotation_deg == pytest.approx(0.1)
    assert errors.metric.rotation_to_first_deg == pytest.approx(0.1 * np.arange(1, count).mean())
    assert errors.metric.step_translation_percent is None
    assert errors.sim3 is None


def test_smoothness_of_a_known_polynomial():
    seconds = np.arange(50) * 0.1
    poses = planar_pose(2.0 * seconds**3, 0.0, 0.0)
    smoothness = measure_smoothness(Trajectory(np.arange(50, dtype=np.int64) * 100_000, poses))
    assert smoothness.jerk_rms_m_s3 == pytest.approx(12.0)
    accelerations = 12.0 * seconds[1:-1]
    assert smoothness.acceleration_variance_m2_s4 == pytest.approx(accelerations.var())
    peak_speed = (poses[-1, 0, 3] - poses[-2, 0, 3]) / 0.1
    assert smoothness.log_dimensionless_jerk == pytest.approx(-np.log(144.0 * 4.9**4 / peak_speed**2))


def test_dimensionless_jerk_does_not_depend_on_size_or_speed():
    base = curve()
    larger = transformed(base, Rotation.identity(), np.zeros(3), 7.0)
    slower = Trajectory(base.timestamps_us * 3, base.T_world_rig)
    noise = np.random.default_rng(0).standard_normal((len(base), 3))
    values = []
    for trajectory, scale in ((base, 1.0), (larger, 7.0), (slower, 1.0)):
        poses = trajectory.T_world_rig.copy()
        poses[:, :3, 3] += 0.1 * scale * noise
        values.append(measure_smoothness(Trajectory(trajectory.timestamps_us, poses)).log_dimensionless_jerk)
    assert values == pytest.approx([values[0]] * 3)


def test_too_few_poses_are_not_measured_rather_than_zero():
    smoothness = measure_smoothness(curve(count=3))
    assert smoothness.jerk_rms_m_s3 is None
    assert smoothness.log_dimensionless_jerk is None
    assert measure_smoothness(curve(count=1)).acceleration_variance_m2_s4 is None


def test_reference_is_interpolated_to_the_estimate():
    dense = curve(count=300, step_us=10_000)
    shifted = Trajectory(dense.timestamps_us[5::10], dense.T_world_rig[5::10])
    errors = compare_trajectories(shifted, curve())
    assert errors.poses == 29
    assert errors.metric.ate_m < 0.01


def test_no_common_time_is_an_error():
    late = Trajectory(curve().timestamps_us + 10_000_000, curve().T_world_rig)
    with pytest.raises(InputError, match="one clock"):
        compare_trajectories(late, curve())


def test_dictionary_holds_plain_values():
    result = compare_trajectories(curve(), curve()).to_dict()
    assert set(result) == {"poses", "metric", "sim3"}
    assert result["metric"]["ate_m"] == pytest.approx(0.0, abs=1e-9)


def test_mirrored_points_are_not_aligned_by_a_reflection():
    points = np.random.default_rng(1).standard_normal((20, 3))
    _, rotation, _ = align_similarity(points, points * [1.0, 1.0, -1.0])
    assert np.linalg.det(rotation) == pytest.approx(1.0)


# evo is under the GPL: an outside program beside Python's, never imported.
PROGRAMS = Path(sys.executable).parent


def write_tum(path, trajectory):
    """Times in seconds, positions and quaternions, one pose a line."""
    quaternions = Rotation.from_matrix(trajectory.T_world_rig[:, :3, :3]).as_quat()
    np.savetxt(path, np.column_stack([trajectory.times, trajectory.positions, quaternions]), fmt="%.12f")


def ask_evo(folder, program, *options):
    """Mean and root mean square of what evo's program says about the two trajectories in the folder."""
    result = folder / f"{len(list(folder.iterdir()))}.zip"
    files = [str(folder / name) for name in ("reference.tum", "estimate.tum")]
    environment = os.environ | {"HOME": str(folder)}
    command = [PROGRAMS / program, "tum", *files, *options, "--save_results", str(result), "--no_warnings"]
    subprocess.run(command, check=True, capture_output=True, env=environment, timeout=120)
    with zipfile.ZipFile(result) as archive:
        statistics = json.loads(archive.read("stats.json"))
    return statistics["mean"], statistics["rmse"]


def test_both_protocols_share_what_no_alignment_changes():
    random = np.random.default_rng(3)
    poses = curve().T_world_rig.copy()
    poses[:, :3, 3] += 0.1 * random.standard_normal((len(poses), 3))
    errors = compare_trajectories(Trajectory(curve().timestamps_us, poses), curve())
    metric, sim3 = errors.metric, errors.sim3
    assert (metric.rotation_to_first_deg, metric.step_rotation_deg) == pytest.approx(
        (sim3.rotation_to_first_deg, sim3.step_rotation_deg)
    )
    assert metric.smoothness.squared_jerk == pytest.approx(metric.smoothness.jerk_rms_m_s3**2)


@pytest.mark.slow
@pytest.mark.skipif(not (PROGRAMS / "evo_ape").exists(), reason="evo is not installed (pip install evo)")
def test_errors_are_those_of_evo(tmp_path):
    # Steps of equal length turn evo's metres into our percent.
    count, step = 60, 0.8
    yaw = 0.03 * np.arange(count)
    radius = 0.5 * step / np.sin(0.015)
    positions = planar_pose(radius * np.sin(yaw), radius * (1.0 - np.cos(yaw)), yaw)
    reference = Trajectory(np.arange(count, dtype=np.int64) * 100_000, positions)
    random = np.random.default_rng(2)
    wander = np.cumsum(0.02 * random.standard_normal((count, 3)), axis=0)
    turn = Rotation.from_rotvec(np.cumsum(0.003 * random.standard_normal((count, 3)), axis=0)).as_matrix()
    estimate = Trajectory(
        reference.timestamps_us,
        make_pose(turn @ positions[:, :3, :3], 1.04 * positions[:, :3, 3] + wander + [5.0, -3.0, 1.0]),
    )
    write_tum(tmp_path / "reference.tum", reference)
    write_tum(tmp_path / "estimate.tum", estimate)
    ours = compare_trajectories(estimate, reference)
    step_by_step = ("--delta", "1", "--delta_unit", "f")

    def evo(program, relation, *options):
        return ask_evo(tmp_path, program, "--pose_relation", relation, *options)

    assert ours.metric.ate_m == pytest.approx(evo("evo_ape", "trans_part", "--align_origin")[1], rel=1e-6)
    assert ours.sim3.ate_m == pytest.approx(evo("evo_ape", "trans_part", "-as")[1], rel=1e-6)
    # evo counts the first pose, which has no error to itself.
    to_first = evo("evo_ape", "angle_deg", "--align_origin")[0] * count / (count - 1)
    assert ours.metric.rotation_to_first_deg == pytest.approx(to_first, rel=1e-6)
    step_angle = evo("evo_rpe", "angle_deg", *step_by_step)[0]
    assert ours.metric.step_rotation_deg == pytest.approx(step_angle, rel=1e-6)
    for errors, options in ((ours.metric, ()), (ours.sim3, ("-as",))):
        metres = evo("evo_rpe", "trans_part", *step_by_step, *options)[0]
        assert errors.step_translation_percent == pytest.approx(100.0 * metres / step, rel=1e-6)
