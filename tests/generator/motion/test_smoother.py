"""Smoothing of trajectories: accuracy, certainty, robustness, and what it costs to do many."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from olt_generator.errors import InputError
from olt_generator.motion import smoother
from olt_generator.motion.car_motion import CarMotion
from olt_generator.motion.pose_metrics import compare_trajectories, measure_smoothness
from olt_generator.motion.smoother import SmootherSettings, smooth_trajectories, smooth_trajectory
from olt_generator.poses import camera_pose_in_rig, invert, make_pose, planar_pose
from olt_generator.trajectory import Trajectory
from olt_generator.twists import exponential, logarithm


def drive(count=120, seed=0, hertz=10.0, stop=False):
    """A drive through bends with changing speed, at irregular times; with a stop of some seconds if wanted."""
    random = np.random.default_rng(seed)
    spacing = random.uniform(0.8, 1.2, count) / hertz
    times_us = np.rint(np.cumsum(spacing) * 1e6).astype(np.int64)
    fine = np.arange(0.0, times_us[-1] * 1e-6 + 0.01, 0.005)
    speed = 9.0 + 2.0 * np.sin(0.5 * fine + seed)
    if stop:
        middle = fine[-1] / 2.0
        away = np.clip((np.abs(fine - middle) - 2.0) / 4.0, 0.0, 1.0)
        speed = 8.0 * away**3 * (10.0 - 15.0 * away + 6.0 * away**2)
    heading = np.cumsum(0.02 * np.sin(0.3 * fine) * speed) * 0.005
    path = np.cumsum(speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1), axis=0) * 0.005
    at = [np.interp(times_us * 1e-6, fine, values) for values in (*path.T, heading)]
    return Trajectory(times_us, planar_pose(*at))


def jittered(trajectory, metres, degrees, seed=1):
    sigmas = np.array([*3 * [metres], *3 * [np.radians(degrees)]])
    noise = sigmas * np.random.default_rng(seed).standard_normal((len(trajectory), 6))
    return Trajectory(trajectory.timestamps_us, trajectory.T_world_rig @ exponential(noise))


def worst_distance(first, second):
    return np.linalg.norm(first.positions - second.positions, axis=1).max()


def worst_angle(first, second):
    return np.linalg.norm(logarithm(invert(first.T_world_rig) @ second.T_world_rig)[:, 3:], axis=1).max()


@pytest.mark.parametrize(("metres", "degrees"), [(0.02, 0.05), (0.05, 0.1), (0.1, 0.2)])
@pytest.mark.parametrize("hertz", [10.0, 30.0])
def test_jitter_goes_and_the_path_gets_closer_to_the_truth(metres, degrees, hertz):
    true = drive(hertz=hertz)
    noisy = jittered(true, metres, degrees)
    smooth = smooth_trajectory(noisy).trajectory
    before, after = measure_smoothness(noisy), measure_smoothness(smooth)
    assert before.jerk_rms_m_s3**2 > 16.7 * after.jerk_rms_m_s3**2
    assert before.acceleration_variance_m2_s4 > 8.9 * after.acceleration_variance_m2_s4
    raw, errors = compare_trajectories(noisy, true).metric, compare_trajectories(smooth, true).metric
    assert errors.ate_m < 0.6 * raw.ate_m
    assert errors.step_rotation_deg < 0.6 * raw.step_rotation_deg


def test_derivatives_of_a_circle():
    times = np.arange(100, dtype=np.int64) * 100_000
    yaw = 0.2 * times * 1e-6
    circle = Trajectory(times, planar_pose(40.0 * np.sin(yaw), 40.0 * (1.0 - np.cos(yaw)), yaw))
    motion = smooth_trajectory(jittered(circle, 0.01, 0.02))
    inner = slice(10, -10)
    assert np.linalg.norm(motion.velocity[inner], axis=1) == pytest.approx(8.0, abs=0.1)
    assert np.linalg.norm(motion.acceleration[inner], axis=1) == pytest.approx(1.6, abs=0.2)
    assert motion.curvature[inner] == pytest.approx(1.0 / 40.0, abs=0.001)


@pytest.mark.parametrize("metres", [0.02, 0.1, 0.4])
def test_noise_levels_are_found(metres):
    noisy = jittered(drive(count=200), metres, 10.0 * metres)
    motion = smooth_trajectory(noisy, SmootherSettings(least_position_sigma=0.0))
    assert motion.position_sigma == pytest.approx(metres, rel=0.5)
    assert motion.rotation_sigma == pytest.approx(np.radians(10.0 * metres), rel=0.5)


SIGMAS = np.array([*3 * [0.08], *3 * [0.004]])
KNOWN = SmootherSettings(position_sigma=0.08, rotation_sigma=0.004, jerk_density=0.8, angular_acceleration_density=0.1)


def simulate(runs, count, seed):
    """Poses (count, runs, 4, 4) and rates (count, runs, 7) of cars that move exactly as the prior says."""
    random = np.random.default_rng(seed)
    car = CarMotion(np.full(runs, 0.8), np.full(runs, 0.1), 0.1, 1.0, np.ones(13))
    seconds = np.tile(random.uniform(0.05, 0.3, (count - 1, 1)), (1, runs))
    roots = np.linalg.cholesky(car.process_noise(seconds))
    poses, rates = np.tile(np.eye(4), (count, runs, 1, 1)), np.zeros((count, runs, 7))
    rates[0] = [10.0, 0.0, 0.0, 0.0, 0.0, 0.1, 0.5]
    rates[0, :, 1:3] = 0.1 * random.standard_normal((runs, 2))
    for k, h in enumerate(seconds[:, 0]):
        noise = (roots[k] @ random.standard_normal((runs, 13, 1)))[..., 0]
        way, decay = np.array([h, 1.0 - np.exp(-h), 1.0 - np.exp(-h)]), np.exp(-h)
        twist = np.concatenate([rates[k, :, :3] * way, rates[k, :, 3:6] * h], axis=-1)
        twist[:, 0] += 0.5 * rates[k, :, 6] * h**2
        poses[k + 1] = poses[k] @ exponential(twist) @ exponential(noise[:, :6])
        rates[k + 1] = rates[k] * [1.0, decay, decay, 1.0, 1.0, 1.0, 1.0] + noise[:, 6:]
        rates[k + 1, :, 0] += rates[k, :, 6] * h
    times = np.concatenate([[0], np.rint(np.cumsum(seconds[:, 0]) * 1e6)]).astype(np.int64)
    return times, poses, rates


def test_covariances_are_consistent():
    runs, count = 80, 24
    times, poses, rates = simulate(runs, count, seed=3)
    noise = SIGMAS * np.random.default_rng(4).standard_normal((count, runs, 6))
    measured = poses @ exponential(noise)
    motions = smooth_trajectories([Trajectory(times, measured[:, run]) for run in range(runs)], KNOWN)
    for k in (0, count // 2, count - 1):
        squared = np.zeros((2, runs))
        for run, motion in enumerate(motions):
            error = logarithm(invert(motion.trajectory.T_world_rig[k]) @ poses[k, run])
            squared[0, run] = error @ np.linalg.solve(motion.covariance[k], error)
            R_rig_world = motion.trajectory.T_world_rig[k, :3, :3].T
            turned = R_rig_world @ motion.velocity[k]
            error = (turned - rates[k, run, :3])[:1]
            squared[1, run] = error @ np.linalg.solve(motion.rate_covariance[k, :1, :1], error)
        for freedoms, total in zip((6, 1), squared.sum(axis=1), strict=True):
            lowest, highest = chi2.ppf([0.0005, 0.9995], freedoms * runs)
            assert lowest < total < highest


@settings(max_examples=15)
@given(
    steps=st.lists(st.sampled_from([1e-6, 1e-4, 0.03, 0.1, 0.11, 0.5, 8.0]), min_size=1, max_size=25),
    speed=st.sampled_from([0.0, -3.0, 20.0]),
    turn_rate=st.sampled_from([0.0, 0.7]),
)
def test_any_spacing_in_time_will_do(steps, speed, turn_rate):
    assume(turn_rate * max(steps) < np.pi)  # a longer turn is taken for the shorter one the other way round
    times_us = np.concatenate([[0], np.cumsum(np.rint(np.array(steps) * 1e6))]).astype(np.int64)
    twists = np.zeros((len(times_us), 6))
    twists[:, 0], twists[:, 5] = speed * times_us * 1e-6, turn_rate * times_us * 1e-6
    true = Trajectory(times_us, exponential(twists))
    motion = smooth_trajectory(jittered(true, 0.02, 0.1))
    assert worst_distance(motion.trajectory, true) < 0.25
    assert np.all(np.linalg.eigvalsh(motion.covariance) > 0.0)
    assert np.all(np.isfinite(motion.acceleration))


def with_outliers(trajectory, share, seed=5, metres=5.0, radians=0.5):
    random = np.random.default_rng(seed)
    bad = random.random(len(trajectory)) < share
    noise = np.array([*3 * [metres], *3 * [radians]]) * random.standard_normal((len(trajectory), 6))
    return Trajectory(trajectory.timestamps_us, trajectory.T_world_rig @ exponential(noise * bad[:, None])), bad


@pytest.mark.parametrize("radians", [0.2, 2.0])
def test_a_quarter_of_outliers_breaks_nothing(radians):
    true = drive(count=150)
    noisy, bad = with_outliers(jittered(true, 0.05, 0.1), 0.25, radians=radians)
    motion = smooth_trajectory(noisy)
    assert worst_distance(motion.trajectory, true) < 0.3
    assert worst_angle(motion.trajectory, true) < np.radians(0.6)
    assert np.mean(motion.outliers == bad) > 0.97


@pytest.mark.parametrize("where", [slice(0, 2), slice(60, 70), slice(-2, None)])
def test_a_burst_of_wrong_poses_is_recognised(where):
    true = drive(count=120)
    noisy = jittered(true, 0.05, 0.1)
    poses = noisy.T_world_rig.copy()
    poses[where] = poses[where] @ exponential(np.array([0.0, 4.0, 0.0, 0.0, 0.0, 0.4]))
    motion = smooth_trajectory(Trajectory(noisy.timestamps_us, poses))
    assert np.all(motion.outliers == np.isin(np.arange(120), np.arange(120)[where]))
    assert worst_distance(motion.trajectory, true) < 0.3


def test_without_outliers_none_are_found():
    assert not smooth_trajectory(jittered(drive(count=300), 0.05, 0.1)).outliers.any()


def test_a_gap_of_seconds_is_bridged_and_known_to_be_uncertain():
    true = drive(count=120)
    keep = np.r_[0:50, 80:120]
    noisy = jittered(true, 0.05, 0.1)
    motion = smooth_trajectory(Trajectory(noisy.timestamps_us[keep], noisy.T_world_rig[keep]))
    kept = Trajectory(true.timestamps_us[keep], true.T_world_rig[keep])
    assert worst_distance(motion.trajectory, kept) < 0.2
    assert motion.rate_covariance[49, 6, 6] > 1.1 * motion.rate_covariance[25, 6, 6]


def test_a_standstill_is_exact():
    true = drive(count=200, stop=True)
    motion = smooth_trajectory(jittered(true, 0.05, 0.1))
    stands = np.flatnonzero(motion.standing)
    assert 3.0 < (true.timestamps_us[stands[-1]] - true.timestamps_us[stands[0]]) * 1e-6 < 6.0
    assert np.all(motion.trajectory.T_world_rig[stands] == motion.trajectory.T_world_rig[stands[0]])
    for values in (motion.velocity, motion.acceleration, motion.curvature):
        assert np.all(values[stands] == 0.0)
    assert worst_distance(motion.trajectory, true) < 0.2


def test_a_vehicle_that_never_moves_stands_throughout():
    times = np.arange(40, dtype=np.int64) * 100_000
    parked = Trajectory(times, np.tile(planar_pose(3.0, 4.0, 0.5), (40, 1, 1)))
    motion = smooth_trajectory(parked)
    assert motion.standing.all()
    np.testing.assert_allclose(motion.trajectory.T_world_rig, parked.T_world_rig, atol=1e-9)


def test_turning_on_the_spot():
    times = np.arange(80, dtype=np.int64) * 100_000
    spin = Trajectory(times, planar_pose(1.0, 2.0, 0.5 * times * 1e-6))
    motion = smooth_trajectory(jittered(spin, 0.01, 0.1))
    assert worst_distance(motion.trajectory, spin) < 0.05
    assert worst_angle(motion.trajectory, spin) < np.radians(0.3)


def test_many_full_turns_and_any_attitude():
    times = np.arange(200, dtype=np.int64) * 100_000
    yaw = 0.9 * times * 1e-6
    circle = planar_pose(8.0 * np.sin(yaw), 8.0 * (1.0 - np.cos(yaw)), yaw)
    tilt = make_pose(Rotation.from_euler("xyz", [3.1, -0.7, 3.14]).as_matrix(), [1.0, 2.0, 3.0])
    true = Trajectory(times, tilt @ circle)
    motion = smooth_trajectory(jittered(true, 0.02, 0.1))
    assert worst_angle(motion.trajectory, true) < np.radians(0.4)
    assert worst_distance(motion.trajectory, true) < 0.1


def test_far_coordinates_cost_nothing():
    noisy = jittered(drive(), 0.05, 0.1)
    poses = noisy.T_world_rig.copy()
    poses[:, :3, 3] += 5e6
    near, far = smooth_trajectory(noisy), smooth_trajectory(Trajectory(noisy.timestamps_us, poses))
    np.testing.assert_allclose(far.trajectory.positions - 5e6, near.trajectory.positions, atol=1e-8)
    np.testing.assert_allclose(far.velocity, near.velocity, atol=1e-6)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_short_trajectories_stay_finite(count):
    noisy = jittered(drive(count=count), 0.05, 0.1)
    motion = smooth_trajectory(noisy)
    assert len(motion.trajectory) == count
    assert worst_distance(motion.trajectory, noisy) < 0.2
    for values in (motion.velocity, motion.acceleration, motion.curvature, motion.covariance):
        assert np.all(np.isfinite(values))


def test_many_trajectories_give_the_bytes_of_each():
    lengths = (41, 1, 90, 41)
    clips = [jittered(drive(count, seed, stop=count == 90), 0.05, 0.1) for seed, count in enumerate(lengths)]
    clips.append(with_outliers(clips[0], 0.25)[0])
    for clip, together in zip(clips, smooth_trajectories(clips), strict=True):
        alone = smooth_trajectory(clip)
        assert alone.trajectory.T_world_rig.tobytes() == together.trajectory.T_world_rig.tobytes()
        for name, value in vars(alone).items():
            if name != "trajectory":
                assert np.asarray(value).tobytes() == np.asarray(getattr(together, name)).tobytes()


def test_no_trajectories_give_none():
    assert smooth_trajectories([]) == []


@pytest.mark.parametrize("wrong", [{"position_sigma": 0.0}, {"jerk_density": -1.0}, {"rotation_sigma": float("nan")}])
def test_noise_must_be_positive(wrong):
    with pytest.raises(InputError, match=f"{next(iter(wrong))} is .*; give a positive number"):
        SmootherSettings(**wrong)


def test_windows_do_not_show(monkeypatch):
    noisy = jittered(drive(count=300), 0.05, 0.1)
    whole = smooth_trajectory(noisy, KNOWN)
    monkeypatch.setattr(smoother, "WINDOW", 100)
    monkeypatch.setattr(smoother, "OVERLAP", 100)
    cut = smooth_trajectory(noisy, KNOWN)
    assert worst_distance(whole.trajectory, cut.trajectory) < 1e-6
    np.testing.assert_allclose(cut.acceleration, whole.acceleration, atol=1e-5)


@pytest.mark.slow
def test_a_hundred_thousand_poses():
    true = drive(count=100_000, hertz=20.0)
    motion = smooth_trajectory(jittered(true, 0.05, 0.1))
    assert np.sqrt(np.mean(np.sum((motion.trajectory.positions - true.positions) ** 2, axis=1))) < 0.05


def test_derivatives_of_a_banked_climbing_turn_are_in_world_axes():
    """With constant rates in body axes, v = R (v, 0, 0) and a = R (w x (v, 0, 0)), roll and pitch included."""
    times = 0.1 * np.arange(60)
    rates = np.array([8.0, 0.0, 0.0, 0.04, -0.07, 0.12])
    start = camera_pose_in_rig([3.0, -2.0, 1.0], 0.1, -0.15, 0.4)
    poses = start @ exponential(times[:, None] * rates)
    settings = SmootherSettings(
        position_sigma=0.01, rotation_sigma=1e-4, jerk_density=1.0, angular_acceleration_density=0.1
    )
    smoothed = smooth_trajectory(Trajectory((times * 1e6).round().astype(np.int64), poses), settings)
    R, inner = poses[:, :3, :3], slice(10, -10)
    np.testing.assert_allclose(smoothed.velocity[inner], (R @ rates[:3])[inner], atol=5e-3)
    np.testing.assert_allclose(
        smoothed.acceleration[inner], (R @ np.cross(rates[3:], rates[:3]))[inner], rtol=0.0, atol=2e-2
    )
    np.testing.assert_allclose(smoothed.curvature[inner], rates[5] / rates[0], rtol=0.0, atol=2e-4)
