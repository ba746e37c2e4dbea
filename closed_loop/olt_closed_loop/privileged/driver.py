"""A driver that sees the truth of a scene: it shows that the scene can be driven, and what a perfect eye is worth.

It knows the map, the route, who will be where, and which lines are held by red lights or by somebody's hand; it knows
nothing of the recorded drive but its first pose and its highest speed, which stands for the speed limit. It plans a
path and a progress (`privileged.plan`), follows them, and plans anew where it has come off them.
"""

import numpy as np

from olt_closed_loop.privileged.holds import holds_of
from olt_closed_loop.privileged.plan import Drive, plan_drive
from olt_closed_loop.privileged.truth import Truth, area_of
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.simulation.reckoning import Reckoning
from olt_closed_loop.simulation.recorded_motion import recorded_motion
from olt_closed_loop.vehicle.state import STATE
from olt_generator.errors import InputError
from olt_generator.poses import Array, invert, planar_pose
from olt_toolkit.policy.contract import FUTURE_STEPS, STEP_SECONDS, STEP_US, Observation, PlannedTrajectory

OFF_PLAN = 0.5
"""Metres off its plan at which the driver plans anew."""
BEYOND_US = 3_000_000
"""How far beyond the recording it plans; nobody is known to be there then."""


class PrivilegedDriver:
    """Drives one rollout of one scene; see the module.

    Raises:
        InputError: the scene gives no route.
    """

    name = "privileged"
    cameras: tuple[str, ...] = ()
    image_size: tuple[int, int] = (0, 0)

    def __init__(self, scene: Scene) -> None:
        if len(scene.route) < 2:
            raise InputError(f"policy {self.name}: scene {scene.name} gives no route; choose another policy or scene")
        self._truth = truth_of(scene)
        self._scene = scene
        self._reckoning: Reckoning | None = None
        self._drive: Drive | None = None

    def plan(self, observation: Observation) -> PlannedTrajectory:
        """See `Policy.plan`."""
        self._reckoning = reckon(self._scene, self._reckoning, observation)
        T_world_rig = self._reckoning.T_frame_rig
        drive = self._current_drive(T_world_rig, observation)
        times = observation.time_us + STEP_US * np.arange(1, FUTURE_STEPS + 1, dtype=np.int64)
        x, y, yaw = drive.poses(times)
        planned = invert(T_world_rig) @ planar_pose(x, y, yaw, T_world_rig[2, 3])
        return PlannedTrajectory(planned[:, :3, 3], planned[:, :3, :3])

    def _current_drive(self, T_world_rig: Array, observation: Observation) -> Drive:
        x, y = T_world_rig[:2, 3]
        now_us = observation.time_us
        if self._drive is not None:
            planned_x, planned_y, _ = self._drive.poses(np.array([now_us], dtype=np.int64))
            if np.hypot(x - planned_x[0], y - planned_y[0]) < OFF_PLAN:
                return self._drive
        before, last, now = observation.history_xyz[-3:, 0]
        speed = max((3.0 * now - 4.0 * last + before) / (2.0 * STEP_SECONDS), 0.0)
        self._drive = plan_drive(self._truth, now_us, float(x), float(y), float(speed))
        return self._drive


def reckon(scene: Scene, reckoning: Reckoning | None, observation: Observation) -> Reckoning:
    """Where the rig of a rollout of a scene is at an observation; at the first, without a reckoning, as recorded."""
    if reckoning is None:
        return Reckoning(_recorded_pose(scene, observation.time_us), observation.time_us)
    reckoning.move_to(observation)
    return reckoning


def _recorded_pose(scene: Scene, time_us: int) -> Array:
    """The recorded pose (4, 4) at a time, upright as the simulated vehicle is."""
    states, heights = recorded_motion(scene, np.array([time_us], dtype=np.int64))
    x, y, yaw = states[0, : STATE.speed]
    return planar_pose(x, y, yaw, heights[0])


def truth_of(scene: Scene) -> Truth:
    """What the driver knows of a scene."""
    velocity = np.gradient(scene.ego.positions[:, :2], scene.ego.times, axis=0)
    end_us = int(scene.ego.timestamps_us[-1]) + BEYOND_US
    return Truth(
        route=scene.route[:, :2],
        drivable=area_of(scene.drivable),
        agents=scene.agents,
        holds=holds_of(scene.lanes, scene.lights, scene.route, end_us),
        vehicle=scene.vehicle,
        cruise=float(np.hypot(velocity[:, 0], velocity[:, 1]).max()),
        end_us=end_us,
    )
