"""Where a driver stands in the world, reckoned from what every policy is shown."""

import numpy as np

from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.simulation.recorded_motion import recorded_motion
from olt_closed_loop.vehicle.state import STATE
from olt_generator.poses import Array, invert, make_pose, planar_pose
from olt_toolkit.policy.contract import STEP_US, Observation


class Reckoning:
    """The pose of the rig, which begins on the recording and adds up its own steps."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._T_world_rig: Array | None = None

    def update(self, observation: Observation) -> Array:
        """T_world_rig (4, 4) at the time of an observation; it must be told of each step."""
        if self._T_world_rig is None:
            self._T_world_rig = self._recorded(observation.time_us)
        else:
            T_rig_before = make_pose(observation.history_rotation[-2], observation.history_xyz[-2])
            self._T_world_rig = self._T_world_rig @ invert(T_rig_before)
        return self._T_world_rig

    def _recorded(self, time_us: int) -> Array:
        """The recorded pose, upright as the simulated vehicle is."""
        start_us = int(self._scene.ego.timestamps_us[0])
        on_grid = start_us + (time_us - start_us) // STEP_US * STEP_US
        states, heights = recorded_motion(self._scene, np.array([on_grid], dtype=np.int64))
        x, y, yaw = states[0, : STATE.speed]
        return planar_pose(x, y, yaw, heights[0])
