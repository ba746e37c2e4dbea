"""What the recording says of the ego vehicle, in the terms of the vehicle model."""

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.vehicle.state import STATE, STATE_SIZE, steering_for
from olt_generator.errors import InputError
from olt_generator.poses import Array, yaw_of


def recorded_motion(scene: Scene, timestamps_us: NDArray[np.int64]) -> tuple[Array, Array]:
    """Vehicle states (n, 6) and heights (n,) of the rig in metres of the recorded ego at times (n,) in the recording.

    Speed, steering and acceleration come from central differences of the recording. Pitch and roll are left out: the
    simulated vehicle stands upright.

    Raises:
        InputError: the recording has fewer than three poses, or a time lies outside it.
    """
    ego = scene.ego
    if len(ego) < 3:
        raise InputError(f"scene {scene.name}: its ego recording has {len(ego)} poses; a closed loop needs at least 3")
    yaw = np.unwrap(yaw_of(ego.T_world_rig))
    velocity = np.gradient(ego.positions[:, :2], ego.times, axis=0)
    speed = velocity[:, 0] * np.cos(yaw) + velocity[:, 1] * np.sin(yaw)
    steering = steering_for(np.gradient(yaw, ego.times), speed, scene.vehicle.wheelbase)
    acceleration = np.gradient(speed, ego.times)

    poses = ego.interpolate(timestamps_us)
    states = np.zeros((len(poses), STATE_SIZE))
    states[:, : STATE.yaw] = poses[:, :2, 3]
    states[:, STATE.yaw] = np.unwrap(yaw_of(poses))
    known, asked = ego.timestamps_us - ego.timestamps_us[0], timestamps_us - ego.timestamps_us[0]
    for index, values in ((STATE.speed, speed), (STATE.steering, steering), (STATE.acceleration, acceleration)):
        states[:, index] = np.interp(asked, known, values)
    return states, poses[:, 2, 3]
