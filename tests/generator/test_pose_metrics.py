"""The paper's pose metrics."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from olt_generator.errors import InputError
from olt_generator.pose_metrics import align_similarity, compare_trajectories, measure_smoothness
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
