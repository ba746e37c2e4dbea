"""What jitter of the trajectory does to the policy's labels."""

import numpy as np
import pytest

from olt_generator.motion.smoother import SmootherSettings, smooth_trajectory
from olt_generator.poses import make_pose, planar_pose
from olt_generator.trajectory import Trajectory
from olt_generator.twists import exponential
from olt_toolkit.clips.label_noise import measure_label_noise


def drive(seconds=14.0, hertz=10.0):
    """Exact motion with gently changing acceleration and curvature."""
    fine = np.arange(0.0, seconds + 1.0, 1e-3)
    speed = 9.0 + 1.5 * np.sin(0.4 * fine)
    heading = np.cumsum(0.02 * np.sin(0.3 * fine) * speed) * 1e-3
    path = np.cumsum(speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1), axis=0) * 1e-3
    times = np.arange(0.0, seconds + 1e-9, 1.0 / hertz)
    x, y, yaw = (np.interp(times, fine, values) for values in (*path.T, heading))
    return Trajectory(np.rint(times * 1e6).astype(np.int64), planar_pose(x, y, yaw))


def jittered(trajectory, metres, degrees, seed=0):
    sigmas = np.array([*3 * [metres], *3 * [np.radians(degrees)]])
    noise = sigmas * np.random.default_rng(seed).standard_normal((len(trajectory), 6))
    return Trajectory(trajectory.timestamps_us, trajectory.T_world_rig @ exponential(noise))


def budget_of(noisy, true=None, settings=None):
    motion = smooth_trajectory(noisy, settings)
    return measure_label_noise(noisy, motion, smooth_trajectory(motion.trajectory, settings).trajectory, true)


def test_labels_magnify_independent_noise_by_41_per_second_squared():
    true = drive(60.0)
    noisy = jittered(true, 0.01, 0.0)
    budget = budget_of(noisy, true)
    assert budget.raw.acceleration == pytest.approx(0.41, rel=0.1)


@pytest.mark.parametrize(("metres", "degrees"), [(0.02, 0.05), (0.05, 0.1), (0.1, 0.2)])
def test_smoothing_leaves_little_label_noise(metres, degrees):
    true = drive()
    noisy = jittered(true, metres, degrees)
    budget = budget_of(noisy, true)
    assert budget.actual.acceleration < 0.2
    assert budget.actual.acceleration < 0.2 * budget.raw.acceleration
    assert budget.actual.curvature < budget.raw.curvature
    assert budget.taken_out.acceleration == pytest.approx(budget.raw.acceleration, rel=0.2)


def random_drive(seed, jerk_density, angular_acceleration_density):
    """Motion driven by white jerk and white angular acceleration, as the smoother's prior has it."""
    random = np.random.default_rng(seed)
    step = 0.01
    white = random.standard_normal((2, 1400)) / np.sqrt(step)
    speed = 20.0 + np.cumsum(np.cumsum(jerk_density * white[0])) * step**2
    yaw = np.cumsum(np.cumsum(angular_acceleration_density * white[1])) * step**2
    x, y = np.cumsum(speed * np.cos(yaw)) * step, np.cumsum(speed * np.sin(yaw)) * step
    every = slice(None, None, 10)
    return Trajectory(np.arange(140, dtype=np.int64) * 100_000, planar_pose(x[every], y[every], yaw[every]))


def test_expected_noise_is_the_actual_one():
    settings = SmootherSettings(0.1, 0.003, jerk_density=0.15, angular_acceleration_density=0.03)
    budgets = []
    for seed in range(6):
        true = random_drive(seed, 0.15, 0.03)
        noisy = jittered(true, 0.1, np.degrees(0.003), seed)
        budgets.append(budget_of(noisy, true, settings))
    # The fit of the actions smooths curvatures once more, so that less arrives there.
    for name, least in (("acceleration", 0.7), ("curvature", 0.5)):
        expected = np.mean([getattr(budget.expected, name) for budget in budgets])
        actual = np.sqrt(np.mean([getattr(budget.actual, name) ** 2 for budget in budgets]))
        assert least * expected < actual < 1.25 * expected


def test_without_a_reference_nothing_is_said_about_the_truth():
    noisy = jittered(drive(9.0), 0.05, 0.1)
    budget = budget_of(noisy)
    assert (budget.actual, budget.raw) == (None, None)
    assert budget.taken_out.acceleration > budget.expected.acceleration > 0.0


def test_the_frame_and_clock_origin_do_not_matter():
    noisy = jittered(drive(9.0), 0.05, 0.1)
    elsewhere = Trajectory(noisy.timestamps_us + 77_000_000, planar_pose(3e5, 1e5, 2.0, 9.0) @ noisy.T_world_rig)
    budgets = budget_of(noisy), budget_of(elsewhere)
    assert budgets[1].taken_out.acceleration == pytest.approx(budgets[0].taken_out.acceleration, rel=1e-4)
    assert budgets[1].expected.curvature == pytest.approx(budgets[0].expected.curvature, rel=1e-4)


def test_a_parked_vehicle_has_no_curvature_noise():
    times = np.arange(100, dtype=np.int64) * 100_000
    parked = Trajectory(times, make_pose(np.tile(np.eye(3), (100, 1, 1)), np.zeros(3)))
    noisy = jittered(parked, 0.02, 0.05)
    budget = budget_of(noisy, parked)
    assert budget.expected.curvature == 0.0
    assert budget.actual.curvature == pytest.approx(0.0, abs=1e-12)
    assert budget.actual.acceleration == pytest.approx(0.0, abs=1e-9)


def test_clips_that_are_too_short_have_no_labels():
    noisy = jittered(drive(7.8), 0.05, 0.1)
    assert budget_of(noisy) is None
