"""Motion that a data set measured: how noisy its labels are, and what smoothing makes of it."""

from dataclasses import replace

import numpy as np
import pytest

from olt_generator.cameras import PinholeCamera
from olt_generator.errors import InputError
from olt_generator.poses import make_pose, planar_pose
from olt_generator.seeds import make_generator
from olt_generator.trajectory import Trajectory
from olt_generator.twists import exponential
from olt_toolkit.clips.action_errors import measure_action_errors, summarize_action_errors
from olt_toolkit.clips.build_options import describe_build, find_differences
from olt_toolkit.clips.builder import build_clip
from olt_toolkit.clips.clip import EgoMotion
from olt_toolkit.clips.estimators import Estimators
from olt_toolkit.clips.files import describe_clip
from olt_toolkit.clips.given_motion import GivenMotion
from olt_toolkit.clips.label_noise import measure_label_noise
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.summary import summarize_build
from olt_toolkit.clips.views import BuildOptions
from olt_toolkit.policy.action_space import ROUND_TRIP_TOLERANCE
from olt_toolkit.recordings.recording import OpenOptions, Recording, StatedAccuracy
from olt_toolkit.rigs.names import MotionLabels
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE, POLICY_CAMERAS
from olt_toolkit.rigs.rig_files import pav_rig

# Labels of these images look at all of a drive.
SHOWN_US = (-400_000, 6_500_000)
T0_US = (1_700_000, 3_000_000, 5_000_000)


def drive(crab=0.0, seconds=13.0, rate=20):
    """Slower and faster through gentle bends, at 6 to 14 m/s; the heading is `crab` radians off the path."""
    times_us = np.arange(-2 * rate, round(seconds * rate), dtype=np.int64) * (1_000_000 // rate)
    fine = np.linspace(times_us[0], times_us[-1], 20_001) * 1e-6
    speed, yaw = 10.0 + 4.0 * np.sin(0.5 * fine), 0.3 * np.sin(0.4 * fine)
    steps = speed[:, None] * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    path = np.concatenate([np.zeros((1, 2)), np.cumsum(0.5 * (steps[1:] + steps[:-1]), axis=0)]) * (fine[1] - fine[0])
    x, y = (np.interp(times_us * 1e-6, fine, path[:, axis]) for axis in (0, 1))
    return Trajectory(times_us, planar_pose(x, y, np.interp(times_us * 1e-6, fine, yaw) + crab))


def jittered(trajectory, metres, seed=0):
    noise = make_generator("jitter", seed).standard_normal((len(trajectory), 6)) * np.repeat([metres, 0.01 * metres], 3)
    return Trajectory(trajectory.timestamps_us, trajectory.T_world_rig @ exponential(noise))


def with_speed_errors(trajectory, sigma, seconds, seed=0):
    """Positions that wander along the path: errors of speed that go on for so many seconds."""
    random, error, offset = make_generator("speed", seed), 0.0, [0.0]
    for step in np.diff(trajectory.times):
        kept = np.exp(-step / seconds)
        error = kept * error + sigma * np.sqrt(1.0 - kept**2) * random.standard_normal()
        offset.append(offset[-1] + error * step)
    poses = trajectory.T_world_rig
    moved = poses[:, :3, 3] + np.array(offset)[:, None] * poses[:, :3, 0]
    return Trajectory(trajectory.timestamps_us, make_pose(poses[:, :3, :3], moved))


def given(measured, labels=MotionLabels.AS_MEASURED, accuracy=None):
    return GivenMotion.take(measured, SHOWN_US, accuracy, labels)


def actual_noise(measured, true):
    """What the labels of a motion differ by from those of the true one."""
    motion = given(measured, MotionLabels.SMOOTHED).smoothed
    return measure_label_noise(measured, motion, motion.trajectory, true).raw.acceleration


@pytest.mark.parametrize("metres", [0.005, 0.02, 0.1])
@pytest.mark.parametrize("rate", [10, 20, 50])
def test_the_noise_of_jitter_is_estimated_to_an_eighth(metres, rate):
    true = drive(rate=rate)
    measured = jittered(true, metres)
    assert given(measured).acceleration_noise == pytest.approx(actual_noise(measured, true), rel=0.125)
    assert given(measured).noise_basis == "estimated"


@pytest.mark.parametrize(("sigma", "seconds"), [(0.05, 0.2), (0.05, 0.5), (0.1, 1.0)])
def test_the_noise_of_errors_of_speed_is_estimated_within_a_half(sigma, seconds):
    true = drive()
    ratios = []
    for seed in range(4):
        measured = with_speed_errors(true, sigma, seconds, seed)
        ratios.append(given(measured).acceleration_noise / actual_noise(measured, true))
    assert 0.5 < np.mean(ratios) < 1.5


def test_a_motion_without_errors_has_little_noise():
    assert given(drive()).acceleration_noise < 0.05


def test_what_a_source_states_goes_before_an_estimate_of_what_was_measured():
    exact = StatedAccuracy("exact", 0.0)
    motion = given(jittered(drive(), 0.02), accuracy=exact)
    assert (motion.acceleration_noise, motion.noise_basis) == (0.0, "stated")
    assert motion.to_dict()["estimated_acceleration_noise_m_s2"] > 0.5
    smoothed = given(drive(), MotionLabels.SMOOTHED, exact)
    assert smoothed.noise_basis == "estimated" and smoothed.acceleration_noise > 0.0
    silent = given(drive(), accuracy=StatedAccuracy("positions to 0.05 m"))
    assert silent.noise_basis == "estimated" and silent.to_dict()["source_says"] == "positions to 0.05 m"


def test_noise_of_a_short_motion_is_not_measured():
    short = GivenMotion.take(drive(seconds=5.0), (0, 4_900_000), None, MotionLabels.AS_MEASURED)
    assert (short.acceleration_noise, short.noise_basis) == (None, None)


@pytest.mark.parametrize("crab", [-0.012, 0.012])
def test_smoothing_makes_a_crabbing_motion_one_that_actions_drive(crab):
    """A heading 0.7 degrees off the path, as GPS/IMUs are: half a metre that no action drives."""
    measured, path = drive(crab), drive()
    before = measure_action_errors(given(measured).ego_motion, T0_US, ())
    smoothed = given(measured, MotionLabels.SMOOTHED)
    after = measure_action_errors(smoothed.ego_motion, T0_US, ())
    assert min(before) > ROUND_TRIP_TOLERANCE and max(after) < 0.06
    moved = smoothed.to_dict()["moved_by_smoothing"]
    assert moved["rms_m"] < 0.05 and moved["worst_heading_deg"] == pytest.approx(np.degrees(0.012), rel=0.35)
    # The path stays where it was, and labels come closer to those of the true heading.
    noise = [actual_noise(motion, path) for motion in (measured, smoothed.smoothed.trajectory)]
    assert noise[1] < noise[0] + 0.05


def test_smoothing_leaves_what_actions_drive():
    smoothed = given(drive(), MotionLabels.SMOOTHED).to_dict()["moved_by_smoothing"]
    # The heading of the last moments is told by the path alone.
    assert smoothed["rms_m"] < 0.005 and smoothed["worst_m"] < 0.02 and smoothed["worst_heading_deg"] < 0.4


def test_action_errors_are_summed_up():
    assert summarize_action_errors(None) is None and summarize_action_errors(()) is None
    assert summarize_action_errors((0.1, 0.5, 0.3)) == {
        "samples": 3,
        "median_m": 0.3,
        "worst_m": 0.5,
        "tolerance_m": 0.3,
        "beyond_tolerance": 1,
    }


@pytest.fixture(scope="module")
def recording():
    """Grey images over a crabbing drive of 13 s, all cameras true."""
    times_us = np.arange(61, dtype=np.int64) * 100_000
    frames = np.full((61, 36, 64, 3), 128, np.uint8)
    rig = pav_rig().fitted(64, 36)
    return Recording(
        name="crab",
        source="test",
        frames=frames,
        timestamps_us=times_us,
        camera=PinholeCamera.from_field_of_view(64, 36, np.radians(120.0)),
        T_rig_camera=rig[POLICY_CAMERAS[1]].T_rig_camera,
        vehicle=DEFAULT_VEHICLE,
        reference=drive(crab=0.012),
        accuracy=StatedAccuracy("nothing is known"),
        views=dict.fromkeys(POLICY_CAMERAS, frames),
        mounted={name: rig[name] for name in POLICY_CAMERAS},
    )


def test_labels_of_a_built_clip_are_as_measured_or_smoothed(recording, tmp_path):
    options = BuildOptions(width=64, height=36, use_reference_views=True)
    built = {choice: build_clip(recording, replace(options, labels=choice)) for choice in MotionLabels}
    infos = {choice: ClipStore(tmp_path / choice).prepare(each.clip) for choice, each in built.items()}
    measured, smoothed = (summarize_build(built[choice], infos[choice]) for choice in MotionLabels)
    assert measured["action_errors_before_smoothing"] is None
    assert measured["action_errors"]["beyond_tolerance"] > 0.9 * measured["action_errors"]["samples"] > 10
    assert smoothed["action_errors_before_smoothing"] == pytest.approx(measured["action_errors"])
    assert smoothed["action_errors"]["worst_m"] < 0.06
    assert smoothed["given_motion"]["labels"] == "smoothed" and smoothed["label_noise"] is None
    info = infos[MotionLabels.SMOOTHED]
    assert len(info.action_errors) == len(info.sample_t0_us) and info.acceleration_noise_basis == "estimated"


def test_a_clip_with_other_labels_is_not_taken_for_the_one_that_is_wanted(make_clip):
    options = BuildOptions(use_reference_views=True, factors=("rain",), category="nominal")
    texts = [
        describe_build(replace(options, labels=choice), Estimators(), OpenOptions(), takes_reference=True)
        for choice in MotionLabels
    ]
    info = describe_clip(replace(make_clip(), build_options=texts[0]), {})
    assert find_differences(info, options, texts[0]) == []
    assert find_differences(info, options, texts[1]) == ["--labels not given (now smoothed)"]


def test_a_clip_without_samples_has_no_action_errors(make_clip):
    info = describe_clip(make_clip(seconds=5.0), {})
    assert (info.sample_t0_us, info.action_errors) == ((), ())


def test_action_errors_outside_the_motion_are_refused():
    with pytest.raises(InputError, match="ego motion covers"):
        measure_action_errors(EgoMotion.from_trajectory(drive()), (12_000_000,), ())
