"""Where a rig is in a fixed frame, reckoned from what every policy is shown: its past poses as seen from now."""

from olt_generator.errors import InputError
from olt_generator.poses import Array, invert, make_pose
from olt_toolkit.policy.contract import HISTORY_STEPS, STEP_US, Observation


class Reckoning:
    """Adds up the moves between the calls of a policy.

    Attributes:
        T_frame_rig: (4, 4) pose of the rig at the last call.
    """

    def __init__(self, T_frame_rig: Array, time_us: int) -> None:
        self.T_frame_rig, self._time_us = T_frame_rig, time_us

    def move_to(self, observation: Observation) -> int:
        """Take the pose of the rig at an observation; returns how many steps of 0.1 s that is after the last.

        Raises:
            InputError: it is not after the last, or more than 1.5 s after, so that what it shows does not reach back.
        """
        now_us = observation.time_us
        steps, rest = divmod(now_us - self._time_us, STEP_US)
        if rest or not 0 < steps < HISTORY_STEPS:
            raise InputError(
                f"policy asked at {now_us} us after {self._time_us} us; ask it in steps of {STEP_US} us, "
                f"at least every {HISTORY_STEPS - 1} of them"
            )
        before = HISTORY_STEPS - 1 - steps
        T_now_before = make_pose(observation.history_rotation[before], observation.history_xyz[before])
        self.T_frame_rig, self._time_us = self.T_frame_rig @ invert(T_now_before), now_us
        return steps
