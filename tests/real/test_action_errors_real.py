"""How far real futures are from the policy's action space, and what smoothing makes of them."""

import numpy as np

from olt_toolkit import OpenOptions, open_recording
from olt_toolkit.clips.action_errors import measure_action_errors, summarize_action_errors
from olt_toolkit.clips.clip import EgoMotion
from olt_toolkit.clips.given_motion import GivenMotion
from olt_toolkit.policy.action_space import physical_actions, trajectory_to_actions
from olt_toolkit.policy.contract import FUTURE_STEPS, STEP_US
from olt_toolkit.rigs.names import MotionLabels

T0_US = tuple(range(1_700_000, 5_900_001, STEP_US))
FORWARD_ACCELERATION = 14  # field of an OXTS file


def accelerations(motion: EgoMotion):
    """Labels (samples, 64) in m/s2."""
    history, future = motion.around(np.array(T0_US))
    actions = trajectory_to_actions(history[..., :3, 3], history[..., :3, :3], future[..., :3, 3], future[..., :3, :3])
    return physical_actions(actions)[0]


def test_a_real_drive_becomes_one_that_actions_drive(shared_real):
    """The GPS/IMU's heading is up to 0.6 degrees off the path that it measures: a fifth of a metre that is lost.

    The accelerometer, which no label is made from, agrees better with the labels once they are smoothed.
    """
    folder = shared_real / "kitti_raw_2011_09_26_drive_0013"
    recording = open_recording(folder, OpenOptions(width=64, duration=20.0))
    assert recording.accuracy.text.startswith("GPS/IMU: positions to 0.208 m and velocities to 0.0354 m/s")
    shown_us = int(recording.timestamps_us[0]), int(recording.timestamps_us[-1])
    files = sorted((folder / "oxts").glob("*.txt"))
    felt = np.array([float(file.read_text().split()[FORWARD_ACCELERATION]) for file in files])
    times_us = np.array(T0_US)[:, None] + STEP_US * (np.arange(FUTURE_STEPS) + 0.5)
    felt = np.interp(times_us, recording.timestamps_us, felt)

    worst, disagreement = {}, {}
    for labels in MotionLabels:
        given = GivenMotion.take(recording.reference, shown_us, recording.accuracy, labels)
        worst[labels] = summarize_action_errors(measure_action_errors(given.ego_motion, T0_US, ()))["worst_m"]
        disagreement[labels] = np.std(accelerations(given.ego_motion) - felt)
        assert given.noise_basis == "estimated" and 0.05 < given.acceleration_noise < 0.2
    assert 0.15 < worst[MotionLabels.AS_MEASURED] < 0.3 and worst[MotionLabels.SMOOTHED] < 0.03
    assert disagreement[MotionLabels.SMOOTHED] < 0.8 * disagreement[MotionLabels.AS_MEASURED] < 0.1
