"""How far a recovered motion may be off: held against motions that were disturbed as the uncertainty says."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_generator.camera_spread import CameraSpread, Spread
from olt_generator.doubts import Doubt
from olt_generator.motion.pose_sources import PoseEstimate
from olt_generator.motion.smoother import ODOMETRY_SETTINGS, smooth_trajectory
from olt_generator.poses import camera_pose_in_rig, invert, make_pose, planar_pose
from olt_generator.trajectory import Trajectory
from olt_generator.twists import cross_matrix, rotation_from_vector, vector_from_rotation
from olt_toolkit.clips.motion_uncertainty import (
    ScaleUncertainty,
    camera_covariance,
    draw_estimates,
    total_covariance,
)
from olt_toolkit.clips.recovered_motion import RecoveredMotion

MOUNTING = camera_pose_in_rig([1.5, 0.3, 1.4], 0.0, 0.03, -0.02)
KNOWN = CameraSpread(Spread(0.0, "calibrated"), Spread(0.0, "calibrated"))


def drive(seconds=14.0, braking=0.0, seed=0):
    """Exact motion at 10 Hz: gentle bends, and a speed that wanders, with a hard braking where one is asked for."""
    random = np.random.default_rng(seed)
    fine = np.arange(0.0, seconds + 1e-9, 1e-2)
    phases, share = random.uniform(0.0, 2.0 * np.pi, 2), random.uniform(0.5, 1.5)
    acceleration = share * 0.5 * np.sin(0.6 * fine + phases[0]) - braking * ((fine > 6.0) & (fine < 8.0))
    speed = 14.0 + np.cumsum(acceleration) * 1e-2
    heading = np.cumsum(0.01 * np.sin(0.3 * fine + phases[1]) * speed) * 1e-2
    path = np.cumsum(speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1), axis=0) * 1e-2
    poses = planar_pose(path[::10, 0], path[::10, 1], heading[::10])
    times_us = 100_000 * np.arange(len(poses), dtype=np.int64)
    return Trajectory(times_us, invert(poses[0]) @ poses)


def drift_covariance(trajectory, speed_density, turn_density=2e-5):
    """Covariances (n, 6, 6) of odometry whose speed errs like white noise, m/s per root Hz, and its turns likewise."""
    covariance = np.zeros((len(trajectory), 6, 6))
    for index, step in enumerate(np.diff(trajectory.positions, axis=0)):
        seconds = trajectory.times[index + 1] - trajectory.times[index]
        carry = np.eye(6)
        carry[:3, 3:] = -cross_matrix(step)
        ahead = trajectory.T_world_rig[index, :3, 0]
        added = np.diag([1e-8, 1e-8, 1e-8, *3 * [turn_density**2 * seconds]])
        added[:3, :3] += speed_density**2 * seconds * np.outer(ahead, ahead)
        covariance[index + 1] = carry @ covariance[index] @ carry.T + added
    return covariance


def estimate(trajectory, covariance=None, scale_sigma=0.01, doubts=()):
    return PoseEstimate(trajectory, MOUNTING, scale_sigma, ODOMETRY_SETTINGS, covariance=covariance, doubts=doubts)


def scaled(trajectory, factor):
    poses = trajectory.T_world_rig.copy()
    poses[:, :3, 3] *= factor
    return replace(trajectory, T_world_rig=poses)


def test_parts_of_the_scale_add_as_variances_and_tell_their_origin():
    spread = CameraSpread(Spread(0.12, "assumed"), Spread(0.04, "estimated"))
    scale = ScaleUncertainty(0.03, spread)
    assert scale.total == pytest.approx(0.13)
    assert scale.to_dict() == {
        "total": scale.total,
        "road": {"relative": 0.03, "origin": "estimated"},
        "height": {"relative": 0.12, "origin": "assumed"},
        "focal_length": {"relative": 0.04, "origin": "estimated"},
    }
    assert ScaleUncertainty(None, spread).total is None


def test_total_covariance_is_that_of_paths_whose_shape_and_scale_err():
    true, random = drive(6.0), np.random.default_rng(0)
    found = estimate(true, drift_covariance(true, 0.1, 1e-3), scale_sigma=0.04)
    scale = ScaleUncertainty(0.04, CameraSpread(Spread(0.03, "given"), Spread(0.0, "given")))
    drawn = [
        scaled(path, 1.0 + scale.total * random.standard_normal()).positions for path in draw_estimates(found, 3000)
    ]
    sample = np.cov(np.stack(drawn)[:, -1].T)
    expected = total_covariance(found, scale)[-1, :3, :3]
    sigmas = np.sqrt(np.diag(expected))
    assert np.abs(sample - expected) == pytest.approx(0.0, abs=0.1 * float(sigmas.max() ** 2))
    assert np.sqrt(np.diag(sample))[:2] == pytest.approx(sigmas[:2], rel=0.05)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(-3.0, 3.0), st.floats(-1.0, 1.0), st.floats(0.2, 3.0))
def test_the_camera_errs_as_the_rig_that_carries_it(seed, x, y, z):
    random, true = np.random.default_rng(seed), drive(3.0, seed=seed % 7)
    mounting = camera_pose_in_rig([x, y, z], 0.1, -0.2, 0.4)
    root = 1e-5 * random.standard_normal((len(true), 6, 6))
    covariance = root @ np.swapaxes(root, -1, -2)
    error = np.einsum("nij,j->ni", root, random.standard_normal(6))
    poses = true.T_world_rig
    off = make_pose(rotation_from_vector(error[:, 3:]) @ poses[:, :3, :3], poses[:, :3, 3] + error[:, :3])
    camera, moved = (invert(mounting) @ each @ mounting for each in (poses, off))
    found = np.concatenate(
        [
            (moved - camera)[:, :3, 3],
            vector_from_rotation(moved[:, :3, :3] @ np.swapaxes(camera[:, :3, :3], -1, -2)),
        ],
        axis=1,
    )
    # The error in the rig's axes is L e of a covariance L L^T: its image lies where the mapped covariance says.
    mapped = camera_covariance(covariance, true, mounting)
    for one, covered in zip(found[1:], mapped[1:], strict=True):
        distance = one @ np.linalg.solve(covered, one)
        assert distance < 60.0
    assert np.trace(mapped[:, 3:, 3:], axis1=1, axis2=2) == pytest.approx(
        np.trace(covariance[:, 3:, 3:], axis1=1, axis2=2)
    )


def test_drawn_paths_spread_as_the_covariance_says():
    true = drive(8.0)
    found = estimate(true, drift_covariance(true, 0.2, 1e-3))
    drawn = np.stack([path.positions for path in draw_estimates(found, 2000)])
    for index in (0, 20, 50, 80):
        sample, expected = np.cov(drawn[:, index].T), found.covariance[index, :3, :3]
        assert np.sqrt(np.diag(sample)) == pytest.approx(np.sqrt(np.diag(expected)), rel=0.08, abs=1e-12)


def test_what_is_not_known_stays_so():
    true = drive(3.0)
    scale = ScaleUncertainty(None, CameraSpread())
    assert total_covariance(estimate(true), ScaleUncertainty(0.1, CameraSpread())) is None
    known = drift_covariance(true, 0.1)
    assert total_covariance(estimate(true, known), scale) is None
    parked = replace(true, T_world_rig=np.tile(np.eye(4), (len(true), 1, 1)))
    assert total_covariance(estimate(parked, known), scale) is known
    with pytest.raises(ValueError, match="not known"):
        draw_estimates(estimate(true), 2)


def recover(found, reference, spread=KNOWN):
    return RecoveredMotion(found, smooth_trajectory(found.trajectory, found.noise), spread, reference)


def label_noise_ratio(speed_density, braking, drives):
    """Actual over expected error of acceleration labels, rms over drives whose speed drifts as the covariance says."""
    ratios = []
    for seed in range(drives):
        true = drive(braking=braking, seed=seed)
        covariance = drift_covariance(true, speed_density)
        measured = draw_estimates(estimate(true, covariance), drives)[seed]
        noise = recover(estimate(measured, covariance, scale_sigma=0.001), true).label_noise
        ratios.append(noise.actual.acceleration / noise.expected.acceleration)
    return np.sqrt(np.mean(np.square(ratios)))


@pytest.mark.parametrize("braking", [0.0, 5.0])
def test_label_noise_of_drifting_speed_is_expected(braking):
    assert 0.7 < label_noise_ratio(0.15, braking, drives=3) < 1.3


@pytest.mark.slow
@pytest.mark.parametrize("speed_density", [0.05, 0.15, 0.5])
@pytest.mark.parametrize("braking", [0.0, 2.0, 5.0])
def test_label_noise_is_expected_in_all_kinds_of_drives(speed_density, braking):
    assert 0.7 < label_noise_ratio(speed_density, braking, drives=8) < 1.3


def test_a_wrong_scale_makes_labels_wrong_by_its_share():
    true = drive(braking=4.0)
    motion = recover(estimate(scaled(true, 1.06), scale_sigma=0.06), true)
    noise = motion.label_noise
    assert noise.estimator is None
    assert noise.scale.acceleration == pytest.approx(0.06 * 1.3, rel=0.5)
    assert noise.expected.acceleration**2 == pytest.approx(noise.smoother.acceleration**2 + noise.scale.acceleration**2)
    numbers = motion.to_dict()
    assert numbers["scale_error"] == pytest.approx(0.06, abs=1e-3)
    assert numbers["scale_z"] == pytest.approx(1.0, abs=0.02)
    assert numbers["ate_sigma_m"] is None
    assert numbers["ate_z"] is None


def test_errors_are_told_in_sigmas():
    true = drive()
    covariance = drift_covariance(true, 0.3, 1e-3)
    motions = [
        recover(estimate(measured, covariance, scale_sigma=0.0), true)
        for measured in draw_estimates(estimate(true, covariance), 30)
    ]
    ratios = [motion.errors.metric.ate_m / motion.ate_sigma for motion in motions]
    assert 0.7 < np.sqrt(np.mean(np.square(ratios))) < 1.3


def test_doubts_of_reader_and_estimator_are_told_once():
    speed, view = Doubt("speed", "two ways differ"), Doubt("view direction", "the name says rear")
    true = drive(3.0)
    found = estimate(true, doubts=(speed,))
    motion = RecoveredMotion(found, smooth_trajectory(true, found.noise), KNOWN, None, (view, speed))
    assert motion.doubts == (view, speed)
    assert motion.to_dict()["doubts"][0] == {"what": "view direction", "why": "the name says rear"}
    assert motion.to_dict()["scale_z"] is None
