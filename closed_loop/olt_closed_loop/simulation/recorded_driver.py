"""A driver that wants to go where the recording went: what control and vehicle make of the recorded motion.

It plans in the rig frame like any policy, from the recorded poses of the times to come. Where it stands in the world it
reckons from what every policy is shown: it begins on the recording, and adds up its own steps.
"""

import numpy as np

from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.simulation.reckoning import Reckoning
from olt_closed_loop.simulation.recorded_motion import recorded_motion
from olt_closed_loop.vehicle.state import STATE
from olt_generator.errors import InputError
from olt_generator.poses import Array, invert, planar_pose
from olt_toolkit.policy.contract import FUTURE_STEPS, STEP_SECONDS, STEP_US, Observation, PlannedTrajectory


class RecordedDriver:
    """Drives one rollout of one scene along its recording; beyond its end, straight on at its last speed."""

    name = "recorded"
    cameras: tuple[str, ...] = ()
    image_size: tuple[int, int] = (0, 0)

    def __init__(self, scene: Scene) -> None:
        self._start_us = int(scene.ego.timestamps_us[0])
        self._recorded = _upright_poses(scene)
        self._reckoning: Reckoning | None = None

    def plan(self, observation: Observation) -> PlannedTrajectory:
        """See `Policy.plan`.

        Raises:
            InputError: it is asked before the recording begins or after it has ended, or see `Reckoning.move_to`.
        """
        step = (observation.time_us - self._start_us) // STEP_US
        if not 0 <= step < len(self._recorded) - FUTURE_STEPS:
            raise InputError(
                f"policy recorded: asked at {observation.time_us} us; the recording is there from {self._start_us} us "
                f"for {(len(self._recorded) - FUTURE_STEPS) * STEP_SECONDS:.1f} s"
            )
        if self._reckoning is None:
            self._reckoning = Reckoning(self._recorded[step], observation.time_us)
        else:
            self._reckoning.move_to(observation)
        planned = invert(self._reckoning.T_frame_rig) @ self._recorded[step + 1 : step + 1 + FUTURE_STEPS]
        return PlannedTrajectory(planned[:, :3, 3], planned[:, :3, :3])


def _upright_poses(scene: Scene) -> Array:
    """Poses (n, 4, 4) at all steps of a recording and FUTURE_STEPS beyond, upright as the simulated vehicle is."""
    start_us, end_us = int(scene.ego.timestamps_us[0]), int(scene.ego.timestamps_us[-1])
    states, heights = recorded_motion(scene, np.arange(start_us, end_us + 1, STEP_US, dtype=np.int64))
    beyond = np.concatenate([np.zeros(len(states)), STEP_SECONDS * np.arange(1, FUTURE_STEPS + 1)])
    x, y, yaw, speed = np.pad(states[:, : STATE.steering], ((0, FUTURE_STEPS), (0, 0)), mode="edge").T
    way = speed * beyond
    return planar_pose(x + way * np.cos(yaw), y + way * np.sin(yaw), yaw, np.pad(heights, (0, FUTURE_STEPS), "edge"))
