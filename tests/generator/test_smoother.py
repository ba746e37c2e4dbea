"""The Kalman filter and the Rauch-Tung-Striebel smoother."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from olt_generator.pose_metrics import measure_smoothness
from olt_generator.poses import make_pose
from olt_generator.smoother import MotionModel, SmootherSettings, filter_forward, smooth, smooth_trajectory
from olt_generator.trajectory import Trajectory

MODEL = SmootherSettings().position_model


def drive(count=120, noise=0.05, seed=0, turn_rate=0.2, spacing=(0.08, 0.13)):
    """A noisy drive on a circle at irregular times, and the true one."""
    random = np.random.default_rng(seed)
    times_us = np.cumsum(random.uniform(*spacing, count) * 1e6).astype(np.int64)
    seconds = (times_us - times_us[0]) * 1e-6
    yaw, radius = turn_rate * seconds, 8.0 / turn_rate
    positions = np.stack([radius * np.sin(yaw), radius * (1 - np.cos(yaw)), 0.0 * yaw], axis=-1)
    rotations = Rotation.from_rotvec(yaw[:, None] * [0.0, 0.0, 1.0])
    jitter = Rotation.from_rotvec(5e-4 * random.standard_normal((count, 3)))
    noisy = make_pose((rotations * jitter).as_matrix(), positions + noise * random.standard_normal((count, 3)))
    return Trajectory(times_us, noisy), Trajectory(times_us, make_pose(rotations.as_matrix(), positions))


def solve_batch(times, measurements, model):
    """The same least-squares problem, all states at once."""
    n, s = len(times), model.states
    rows, right = [np.zeros((s, n * s))], [np.zeros((s, measurements.shape[1]))]
    rows[0][:, :s] = np.linalg.inv(np.sqrt(model.initial_covariance()))
    right[0][0] = measurements[0] / model.measurement_sigma
    for k, seconds in enumerate(np.diff(times), start=1):
        whiten = np.linalg.inv(np.linalg.cholesky(model.process_noise(np.array([seconds]))[0]))
        block = np.zeros((s + 1, n * s))
        block[:s, (k - 1) * s : k * s] = -whiten @ model.transition(np.array([seconds]))[0]
        block[:s, k * s : (k + 1) * s] = whiten
        block[s, k * s] = 1.0 / model.measurement_sigma
        rows.append(block)
        right.append(
            np.vstack([np.zeros((s, measurements.shape[1])), measurements[k : k + 1] / model.measurement_sigma])
        )
    Q, R = np.linalg.qr(np.vstack(rows))
    return np.linalg.solve(R, Q.T @ np.vstack(right)).reshape(n, s, -1)


@settings(max_examples=25, deadline=None)
@given(
    steps=hnp.arrays(np.float64, st.integers(1, 30), elements=st.floats(0.02, 0.5)),
    seed=st.integers(0, 1000),
    density=st.floats(0.1, 5.0),
    order=st.integers(1, 2),
)
def test_equals_the_batch_solution(steps, seed, density, order):
    model = MotionModel(density, 0.05, (10.0, 5.0)[:order])
    times = np.concatenate([[0.0], np.cumsum(steps)])
    measurements = np.random.default_rng(seed).standard_normal((len(times), 2))
    assert np.allclose(smooth(times, measurements, model), solve_batch(times, measurements, model), rtol=0, atol=1e-8)


def test_process_noise_adds_up_over_steps():
    short, long = np.array([0.1]), np.array([0.2])
    F, Q = MODEL.transition(short)[0], MODEL.process_noise(short)[0]
    assert np.allclose(MODEL.transition(long)[0], F @ F)
    assert np.allclose(MODEL.process_noise(long)[0], F @ Q @ F.T + Q)


def test_filter_covariance_is_consistent():
    random = np.random.default_rng(4)
    model, times = MotionModel(1.0, 0.1, (1.0, 1.0)), np.linspace(0.0, 6.0, 61)
    runs, state = 300, None
    truth = np.zeros((len(times), 3, runs))
    state = np.stack([np.zeros(runs), random.standard_normal(runs), random.standard_normal(runs)])
    noise = np.linalg.cholesky(model.process_noise(np.array([0.1]))[0])
    for k in range(len(times)):
        truth[k] = state
        state = model.transition(np.array([0.1]))[0] @ state + noise @ random.standard_normal((3, runs))
    forward = filter_forward(times, truth[:, 0] + 0.1 * random.standard_normal((len(times), runs)), model)
    error = forward.filtered[-1] - truth[-1]
    squared = np.einsum("ir,ij,jr->r", error, np.linalg.inv(forward.filtered_covariance[-1]), error)
    assert squared.mean() == pytest.approx(3.0, abs=0.5)


def test_smoothing_brings_poses_closer_to_the_truth_and_takes_jerk_out():
    noisy, true = drive()
    motion = smooth_trajectory(noisy)
    before = np.linalg.norm(noisy.positions - true.positions, axis=1)
    after = np.linalg.norm(motion.trajectory.positions - true.positions, axis=1)
    assert np.sqrt(np.mean(after**2)) < 0.6 * np.sqrt(np.mean(before**2))
    assert measure_smoothness(motion.trajectory).jerk_rms_m_s3 < 0.05 * measure_smoothness(noisy).jerk_rms_m_s3


def test_derivatives_and_curvature_of_a_circle():
    noisy, true = drive(noise=0.01, turn_rate=0.2)
    motion = smooth_trajectory(noisy)
    inner = slice(10, -10)
    assert np.linalg.norm(motion.velocity[inner], axis=1) == pytest.approx(8.0, abs=0.15)
    assert np.linalg.norm(motion.acceleration[inner], axis=1) == pytest.approx(1.6, abs=0.5)
    assert motion.curvature[inner] == pytest.approx(0.2 / 8.0, abs=0.004)
    assert np.allclose(motion.trajectory.T_world_rig[:, :3, :3], true.T_world_rig[:, :3, :3], atol=3e-3)


def test_full_turns_are_no_obstacle():
    noisy, true = drive(count=300, turn_rate=0.9)
    turned = smooth_trajectory(noisy).trajectory.T_world_rig[:, :3, :3]
    angle = (Rotation.from_matrix(true.T_world_rig[:, :3, :3]).inv() * Rotation.from_matrix(turned)).magnitude()
    assert angle.max() < 3e-3


def test_far_coordinates_cost_nothing():
    noisy, _ = drive()
    far_poses = noisy.T_world_rig.copy()
    far_poses[:, :3, 3] += 5e6
    far = smooth_trajectory(Trajectory(noisy.timestamps_us, far_poses))
    near = smooth_trajectory(noisy)
    assert np.allclose(far.trajectory.positions - 5e6, near.trajectory.positions, atol=1e-8)
    assert np.allclose(far.velocity, near.velocity, atol=1e-6)


def test_standstill_has_no_curvature():
    times = np.arange(20, dtype=np.int64) * 100_000
    motion = smooth_trajectory(Trajectory(times, np.tile(np.eye(4), (20, 1, 1))))
    assert np.all(motion.curvature == 0.0)
    assert np.allclose(motion.velocity, 0.0)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_short_trajectories_stay_finite(count):
    noisy, _ = drive(count=count)
    motion = smooth_trajectory(noisy)
    assert len(motion.trajectory) == count
    assert np.all(np.isfinite(motion.acceleration))


def test_gap_is_bridged():
    noisy, true = drive(count=100)
    keep = np.r_[0:40, 55:100]
    motion = smooth_trajectory(Trajectory(noisy.timestamps_us[keep], noisy.T_world_rig[keep]))
    assert np.linalg.norm(motion.trajectory.positions - true.positions[keep], axis=1).max() < 0.15
