"""A driver that wants to go where the recording went: what control and vehicle make of the recorded motion.

It plans in the rig frame like any policy, from the recorded poses of the times to come. Where it stands in the world it
reckons from what every policy is shown: it begins on the recording, and adds up its own steps.
"""

import numpy as np

from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.simulation.recorded_motion import recorded_motion
from olt_closed_loop.vehicle.state import STATE
from olt_generator.poses import Array, invert, make_pose, planar_pose
from olt_toolkit.policy.contract import FUTURE_STEPS, STEP_US, Observation, PlannedTrajectory


class RecordedDriver:
    """Drives one rollout of one scene along its recording; beyond its end, straight on at its last speed."""

    name = "recorded"
    cameras: tuple[str, ...] = ()
    image_size: tuple[int, int] = (0, 0)

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._T_world_rig: Array | None = None

    def plan(self, observation: Observation) -> PlannedTrajectory:
        """See `Policy.plan`."""
        if self._T_world_rig is None:
            self._T_world_rig = self._recorded(np.array([observation.time_us]))[0]
        else:
            T_rig_before = make_pose(observation.history_rotation[-2], observation.history_xyz[-2])
            self._T_world_rig = self._T_world_rig @ invert(T_rig_before)
        times_us = observation.time_us + STEP_US * np.arange(1, FUTURE_STEPS + 1, dtype=np.int64)
        planned = invert(self._T_world_rig) @ self._recorded(times_us)
        return PlannedTrajectory(planned[:, :3, 3], planned[:, :3, :3])

    def _recorded(self, times_us: Array) -> Array:
        """Recorded poses (n, 4, 4), upright as the simulated vehicle is."""
        end_us = int(self._scene.ego.timestamps_us[-1])
        states, heights = recorded_motion(self._scene, np.minimum(times_us, end_us).astype(np.int64))
        x, y, yaw, speed = states[:, : STATE.steering].T
        beyond = speed * np.maximum(times_us - end_us, 0) * 1e-6
        return planar_pose(x + beyond * np.cos(yaw), y + beyond * np.sin(yaw), yaw, heights)
