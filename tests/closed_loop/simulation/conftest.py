"""A policy that knows the recording: proof that the loop is closed."""

import numpy as np
import pytest

from olt_closed_loop.scenes.scene import Scene
from olt_generator.poses import invert
from olt_toolkit.policy.contract import FUTURE_STEPS, STEP_US, Observation, PlannedTrajectory


class ReplayPolicy:
    """Drives back to and along the recording of the scene.

    It keeps track of its pose in the world by the observed history, from the recorded pose at which it is first asked;
    so it serves one rollout after the other, not two at once.
    """

    name = "replay"
    cameras: tuple[str, ...] = ()
    image_size: tuple[int, int] = (0, 0)

    def __init__(self, scene: Scene) -> None:
        self._recording = scene.ego
        self._T_world_rig = np.eye(4)
        self._time_us: int | None = None

    def plan(self, observation: Observation) -> PlannedTrajectory:
        """See `Policy.plan`; after the recording's end the plan goes straight on at the last recorded speed."""
        now = observation.time_us
        if self._time_us is not None and now == self._time_us + STEP_US:
            before = np.eye(4)
            before[:3, :3], before[:3, 3] = observation.history_rotation[-2], observation.history_xyz[-2]
            self._T_world_rig = self._T_world_rig @ invert(before)
        else:
            self._T_world_rig = self._recording.interpolate(np.array([now]))[0]
        self._time_us = now
        known_us, positions = self._recording.timestamps_us[-2:], self._recording.positions[-2:]
        velocity = (positions[1] - positions[0]) / (known_us[1] - known_us[0])
        future_us = now + STEP_US * np.arange(1, FUTURE_STEPS + 1, dtype=np.int64)
        poses = self._recording.interpolate(np.minimum(future_us, known_us[1]))
        poses[:, :3, 3] += np.maximum(future_us - known_us[1], 0)[:, None] * velocity
        in_rig = invert(self._T_world_rig) @ poses
        return PlannedTrajectory(in_rig[:, :3, 3], in_rig[:, :3, :3])


@pytest.fixture(scope="session")
def replay_policy() -> type[ReplayPolicy]:
    """The policy that drives along the recording of a scene."""
    return ReplayPolicy
