"""What one session of AlpaSim has told a policy so far, and what the policy sees of it.

The messages of a step may come in any order: each is kept under its own time, and what the policy sees is put together
when it is asked. Its past poses are interpolated at 0.1 s. Before the first one that is known the rig is taken to have
come straight at its first speed, as in our own rollouts.
"""

from collections.abc import Collection
from typing import Any

import grpc
import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.drivers.contract import CallRefused
from olt_closed_loop.drivers.conversions import LATEST_TIME_US, decode_image, poses_at, read_trajectory, read_vector
from olt_closed_loop.simulation.policy_hosts import PolicyTraits
from olt_generator.errors import InputError
from olt_generator.poses import Array, invert, planar_pose, transform
from olt_generator.seeds import derive_seed
from olt_toolkit.policy.contract import HISTORY_STEPS, IMAGE_FRAMES, STEP_US, Observation
from olt_toolkit.rigs.rig import CAMERA_INDEX

KEPT_US = 3_000_000
"""Poses and frames older than this, seen from the newest, are forgotten; a policy sees 1.5 s."""
MOST_KEPT = 4096
"""Poses, and frames of a camera; more within `KEPT_US` are refused."""
MOST_WAYPOINTS = 1000
_FRAME_TOLERANCE_US = STEP_US // 2


class DriveSession:
    """One rollout, as its messages tell it. Not for several threads at once."""

    def __init__(self, seed: int, scene: str, cameras: Collection[str], traits: PolicyTraits) -> None:
        """Begin.

        Raises:
            CallRefused: the policy needs cameras that the session does not have.
        """
        missing = [camera for camera in traits.cameras if camera not in cameras]
        if missing:
            raise CallRefused(
                grpc.StatusCode.FAILED_PRECONDITION,
                f"policy {traits.name} needs the cameras {', '.join(missing)}; "
                f"the session has {', '.join(sorted(cameras)) or 'none'}",
            )
        self._seed, self._scene, self._cameras, self._traits = seed, scene, set(cameras), traits
        self._poses: dict[int, Array] = {}
        self._speeds: dict[int, float] = {}
        self._frames: dict[str, dict[int, NDArray[np.uint8]]] = {camera: {} for camera in traits.cameras}
        self._route: tuple[int, Array] | None = None
        self._asked = 0

    def add_image(self, image: Any) -> None:
        """Keep a frame (message `CameraImage`), if the policy looks at its camera.

        Raises:
            InputError: the camera was not declared, its times are none, or the file is no image.
        """
        name, end_us = image.logical_id, image.frame_end_us
        if name not in self._cameras:
            raise InputError(
                f"camera {name!r} was not declared; there are {', '.join(sorted(self._cameras)) or 'none'}"
            )
        if image.frame_start_us > end_us or end_us >= LATEST_TIME_US:
            raise InputError(f"camera {name}: a frame from {image.frame_start_us} to {end_us} us")
        if name in self._frames:
            frames = self._frames[name]
            frames[end_us] = decode_image(image.image_bytes, self._traits.image_size, f"camera {name} at {end_us} us")
            _forget(frames, IMAGE_FRAMES * STEP_US)

    def add_egomotion(self, message: Any) -> None:
        """Keep poses (message `RolloutEgoTrajectory`); one of a time that is known replaces it.

        Raises:
            InputError: a pose is none, or the states are not as many as the poses.
        """
        if len(message.trajectory.poses) > MOST_KEPT:
            raise InputError(f"egomotion: {len(message.trajectory.poses)} poses at once; at most {MOST_KEPT}")
        times, poses = read_trajectory(message.trajectory, "egomotion")
        states = message.dynamic_states
        if len(states) not in (0, len(times)):
            raise InputError(f"egomotion: {len(states)} dynamic states of {len(times)} poses; give one each, or none")
        speeds = [float(read_vector(state.linear_velocity, "egomotion: a velocity")[0]) for state in states]
        self._poses.update(zip(times.tolist(), poses, strict=True))
        self._speeds.update(zip(times.tolist(), speeds, strict=False))
        _forget(self._poses, KEPT_US)
        _forget(self._speeds, KEPT_US)

    def set_route(self, route: Any) -> None:
        """Keep the route (message `Route`); waypoints that are NaN fill it up and are left out.

        Raises:
            InputError: a waypoint is infinite, there are too many, or the time is none.
        """
        if len(route.waypoints) > MOST_WAYPOINTS or route.timestamp_us >= LATEST_TIME_US:
            raise InputError(f"route of {len(route.waypoints)} waypoints at {route.timestamp_us} us")
        points = np.array([(point.x, point.y, point.z) for point in route.waypoints]).reshape(-1, 3)
        points = points[~np.isnan(points).any(axis=1)]
        if not np.isfinite(points).all():
            raise InputError("route: a waypoint is infinite")
        if self._route is None or route.timestamp_us >= self._route[0]:
            self._route = route.timestamp_us, points

    def observe(self, now_us: int) -> tuple[Observation | None, Array]:
        """What the policy sees at a time, and the pose (4, 4) of the rig then in the local frame.

        No observation where its cameras do not have four frames yet, each within half a step of its time.

        Raises:
            CallRefused: no pose is known at that time.
            InputError: the time is none.
        """
        if now_us >= LATEST_TIME_US:
            raise InputError(f"drive at {now_us} us; give microseconds below 2^62")
        if now_us not in self._poses and not (self._poses and min(self._poses) <= now_us <= max(self._poses)):
            raise CallRefused(
                grpc.StatusCode.FAILED_PRECONDITION, f"drive at {now_us} us: no egomotion was submitted for that time"
            )
        back_us = STEP_US * np.arange(HISTORY_STEPS - 1, -1, -1, dtype=np.int64)
        past = self._poses_at(now_us - back_us)
        T_local_rig = past[-1]
        images = self._images_at(now_us)
        if self._frames and images is None:
            return None, T_local_rig
        history = invert(T_local_rig) @ past
        observation = Observation(
            images=images,
            camera_indices=np.array([CAMERA_INDEX[camera] for camera in self._traits.cameras], dtype=np.int64),
            history_xyz=history[:, :3, 3],
            history_rotation=history[:, :3, :3],
            route_xy=self._route_at(T_local_rig),
            time_us=now_us,
            seed=derive_seed(self._seed, self._scene, self._asked),
        )
        self._asked += 1
        return observation, T_local_rig

    def _poses_at(self, times_us: NDArray[np.int64]) -> Array:
        known = np.array(sorted(self._poses), dtype=np.int64)
        first_us = int(known[0])
        stacked = np.stack([self._poses[time_us] for time_us in known.tolist()])
        poses = poses_at(known, stacked, np.maximum(times_us, first_us))
        earlier = times_us < first_us
        if earlier.any():
            seconds = (times_us[earlier] - first_us) * 1e-6
            poses[earlier] = poses[earlier] @ planar_pose(seconds * self._first_speed(known), 0.0, 0.0)
        return poses

    def _first_speed(self, known: NDArray[np.int64]) -> float:
        """Speed ahead, m/s, at the first pose: as told, or the difference to the second pose, or 0 if there is none."""
        first_us = int(known[0])
        if first_us in self._speeds:
            return self._speeds[first_us]
        if len(known) == 1:
            return 0.0
        second_us = int(known[1])
        moved = invert(self._poses[first_us]) @ self._poses[second_us]
        return float(moved[0, 3]) / ((second_us - first_us) * 1e-6)

    def _images_at(self, now_us: int) -> NDArray[np.uint8] | None:
        """Images (cameras, 4, 3, H, W), or None where one is missing."""
        cameras = []
        for frames in self._frames.values():
            if not frames:
                return None
            times = np.array(list(frames))
            wanted = now_us - STEP_US * np.arange(IMAGE_FRAMES - 1, -1, -1)
            away = np.abs(times - wanted[:, None])
            if (away.min(axis=1) > _FRAME_TOLERANCE_US).any():
                return None
            cameras.append(np.stack([frames[int(times[index])] for index in away.argmin(axis=1)]))
        return np.stack(cameras) if cameras else None

    def _route_at(self, T_local_rig: Array) -> Array:
        """The route (n, 2) in the rig now; it was given in the rig of its own time, which must be known."""
        if self._route is None:
            return np.zeros((0, 2))
        time_us, points = self._route
        if not min(self._poses) <= time_us <= max(self._poses):
            raise CallRefused(
                grpc.StatusCode.FAILED_PRECONDITION, f"route of {time_us} us: no egomotion was submitted for that time"
            )
        T_local_then = self._poses_at(np.array([time_us], dtype=np.int64))[0]
        return transform(invert(T_local_rig) @ T_local_then, points)[:, :2]


def _forget(by_time: dict[int, Any], kept_us: int) -> None:
    """Leave out what is too old, and what is more than can be kept, the oldest first."""
    newest = max(by_time, default=0)
    old = [time_us for time_us in by_time if time_us < newest - kept_us]
    for time_us in (*old, *sorted(set(by_time) - set(old))[: max(0, len(by_time) - len(old) - MOST_KEPT)]):
        del by_time[time_us]
