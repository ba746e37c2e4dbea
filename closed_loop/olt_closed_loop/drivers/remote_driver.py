"""A driver of AlpaSim's `egodriver` service as a policy: `grpc://HOST:PORT`.

The rig at the first plan is the origin of the local frame in which the driver is told poses and answers. Where the rig
stands in it later is reckoned from what every policy is shown, its own past poses. In every step the driver gets the
new frames, the new poses with rates that are differences of them, and the route, at once and in no certain order; when
all are taken it is asked to drive. What it answers must reach from now over the second that control looks ahead
(`SHORTEST_PLAN`); past its end it goes on as it ended.

The messages that a driver gets are those of the contract, so it may run anywhere and be written in anything. What it
does wrong is what other policies do wrong (`simulation.answers`): a time limit passed is a timeout, a lost connection a
death, `terminate_session` an exit, and a trajectory that no plan can be made of is refused. Opaque bytes of an answer
are not looked at.
"""

import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, get_args
from urllib.parse import parse_qsl, urlsplit
from uuid import uuid4

import grpc
import numpy as np

from olt_closed_loop.control.plans import PlanRefused
from olt_closed_loop.drivers import contract
from olt_closed_loop.drivers.conversions import (
    ImageFormat,
    encode_image,
    read_trajectory,
    write_camera,
    write_trajectory,
    write_vector,
)
from olt_closed_loop.simulation.answers import PolicyFault, PolicyFaulted
from olt_generator.errors import InputError
from olt_generator.poses import Array, invert, make_pose
from olt_generator.trajectory import Trajectory
from olt_toolkit.policy.contract import (
    FUTURE_STEPS,
    HISTORY_STEPS,
    IMAGE_FRAMES,
    STEP_SECONDS,
    STEP_US,
    Observation,
    PlannedTrajectory,
)
from olt_toolkit.rigs.contracts import CONTRACTS, DEFAULT_CONTRACT
from olt_toolkit.rigs.rig import CAMERA_INDEX

SHORTEST_PLAN = 10
"""Steps of 0.1 s that an answer must cover: as many as the controller looks ahead."""
DEFAULT_IMAGE_SIZE = (320, 576)
"""Height and width; the drivers of Alpamayo refuse smaller images (docs/formats/alpasim_services.md)."""
CAMERAS_KEY, SIZE_KEY = "openlongtail-cameras", "openlongtail-image-size"
"""Metadata in which a policy served by `olt closed-loop serve` tells what it needs."""
_CLOSING_SECONDS = 2.0


@dataclass(frozen=True)
class DriverAddress:
    """Where a driver is, and what it is shown.

    Attributes:
        target: HOST:PORT, or the path of a Unix socket as `unix:PATH`.
        cameras: None for what the driver itself tells, or else those of `alpamayo-r1`.
        image_size: height and width, or None likewise.
        coding: of the images.
    """

    target: str
    cameras: tuple[str, ...] | None = None
    image_size: tuple[int, int] | None = None
    coding: ImageFormat = "jpeg"

    @classmethod
    def parse(cls, text: str) -> "DriverAddress":
        """The address in `//HOST:PORT?cameras=NAMES&size=HEIGHTxWIDTH&images=jpeg`, all options optional.

        NAMES is a camera contract such as `alpamayo-r1`, names of cameras with commas between, or `none`.

        Raises:
            InputError: it is none, or an option is not known.
        """
        where = f"policy grpc:{text}"
        try:
            parts = urlsplit(text)
            port = parts.port
        except ValueError as error:
            raise InputError(f"{where}: {error}; give grpc://HOST:PORT") from error
        if not parts.hostname or not port or parts.path.strip("/") or parts.username:
            raise InputError(f"{where}: give grpc://HOST:PORT, for example grpc://127.0.0.1:6789?cameras=alpamayo-r1")
        options = dict(parse_qsl(parts.query, keep_blank_values=True))
        unknown = set(options) - {"cameras", "size", "images"}
        if unknown:
            raise InputError(f"{where}: no option {', '.join(sorted(unknown))}; there are cameras, size and images")
        coding = options.get("images", "jpeg")
        if coding not in get_args(ImageFormat):
            raise InputError(f"{where}: images are coded as jpeg or png, not {coding!r}")
        cameras = _read_cameras(options["cameras"], where) if "cameras" in options else None
        size = _read_size(options["size"], where) if "size" in options else None
        return cls(f"{parts.netloc}", cameras, size, "png" if coding == "png" else "jpeg")


def _read_cameras(text: str, where: str) -> tuple[str, ...]:
    if text in CONTRACTS:
        return CONTRACTS[text].cameras
    names = [] if text == "none" else text.split(",")
    unknown = [name for name in names if name not in CAMERA_INDEX]
    if unknown:
        known = f"none, {', '.join(CONTRACTS)}, or of {', '.join(CAMERA_INDEX)}"
        raise InputError(f"{where}: no cameras {', '.join(map(repr, unknown))}; give {known}")
    return tuple(sorted(set(names), key=lambda name: CAMERA_INDEX[name]))


def _read_size(text: str, where: str) -> tuple[int, int]:
    height, _, width = text.partition("x")
    if not (height.isdecimal() and width.isdecimal() and 0 < int(height) <= 4320 and 0 < int(width) <= 7680):
        raise InputError(f"{where}: size {text!r}; give HEIGHTxWIDTH in pixels, for example 320x576")
    return int(height), int(width)


class RemoteDriver:
    """See the module. One session at the driver for each rollout."""

    def __init__(self, address: DriverAddress, start_seconds: float = 30.0, call_seconds: float = 30.0) -> None:
        """Wait for the driver and ask who it is.

        Raises:
            PolicyFaulted: it does not answer.
        """
        self._address = address
        self.limit_time(call_seconds, start_seconds)
        self._channel = grpc.insecure_channel(address.target, options=contract.CHANNEL_OPTIONS)
        self._stub = contract.Stub(self._channel, contract.EGODRIVER)
        self._session: str | None = None
        version, told = self._ask_version()
        self.name = version.version_id or "driver"
        cameras, size = address.cameras, address.image_size
        if cameras is None:
            told_cameras = told.get(CAMERAS_KEY)
            cameras = DEFAULT_CONTRACT.cameras if told_cameras is None else _read_told(told_cameras)
        self.cameras = cameras
        self.image_size = size or (_read_size(told[SIZE_KEY], "driver") if SIZE_KEY in told else DEFAULT_IMAGE_SIZE)

    def _ask_version(self) -> tuple[Any, dict[str, str]]:
        # A driver that still loads its model is waited for.
        wait = {"timeout": self._start_seconds, "wait_for_ready": True}
        try:
            version, call = self._stub.get_version.with_call(contract.Empty(), **wait)
        except grpc.RpcError as error:
            self._channel.close()
            raise PolicyFaulted(_fault_of(error, self._address.target, self._start_seconds)) from error
        return version, {key: value for key, value in call.initial_metadata() if isinstance(value, str)}

    def limit_time(self, call_seconds: float, start_seconds: float) -> None:
        """See `simulation.policy_hosts.TimedPolicy`."""
        self._call_seconds, self._start_seconds = call_seconds, start_seconds

    def reset(self, seed: int, scene: str) -> None:
        """Begin a session at the driver.

        Raises:
            PolicyFaulted: it does not take it.
        """
        self._close_session()
        self._T_local_rig: Array | None = None
        self._time_us = 0
        request = contract.DriveSessionRequest(session_uuid=str(uuid4()), random_seed=seed)
        request.debug_info.scene_id = scene
        available = request.rollout_spec.vehicle.available_cameras
        available.extend(write_camera(name, mounted) for name, mounted in self._mounted_cameras())
        self._wait(self._stub.start_session.future(request, timeout=self._start_seconds), self._start_seconds)
        self._session = request.session_uuid

    def _mounted_cameras(self) -> list[tuple[str, Any]]:
        if not self.cameras:
            return []
        from olt_toolkit.rigs.rig_files import pav_rig

        height, width = self.image_size
        rig = pav_rig().fitted(width, height)
        return [(name, rig[name]) for name in self.cameras]

    def plan(self, observation: Observation) -> PlannedTrajectory:
        """Tell the driver what is new, and ask it.

        Raises:
            PlanRefused: no plan can be made of its answer.
            PolicyFaulted: it gave none.
        """
        if self._session is None:
            self.reset(observation.seed, "")
        steps = self._move_to(observation)
        deadline = time.monotonic() + self._call_seconds
        for call in [
            self._send("submit_egomotion_observation", self._egomotion(observation, steps)),
            *(self._send("submit_image_observation", image) for image in self._images(observation, steps)),
            *(self._send("submit_route", route) for route in self._route(observation)),
        ]:
            self._wait(call, deadline - time.monotonic())
        now_us = observation.time_us
        request = contract.DriveRequest(time_now_us=now_us, time_query_us=now_us + STEP_US)
        answer = self._wait(self._send("drive", request), deadline - time.monotonic())
        if answer.terminate_session:
            self._session = None
            raise PolicyFaulted(PolicyFault("policy_exits", "asked to end the session"))
        return read_plan(answer.trajectory, now_us, self._T_rig_local)

    @property
    def _T_rig_local(self) -> Array:
        assert self._T_local_rig is not None
        return invert(self._T_local_rig)

    def _move_to(self, observation: Observation) -> int:
        """Reckon where the rig is now; returns how many steps of the observation are new."""
        now_us = observation.time_us
        if self._T_local_rig is None:
            self._T_local_rig, self._time_us = np.eye(4), now_us
            return HISTORY_STEPS
        steps = (now_us - self._time_us) // STEP_US
        if not 0 < steps < HISTORY_STEPS:
            raise InputError(f"driver asked at {now_us} us after {self._time_us} us; ask it every step of {STEP_US} us")
        before = HISTORY_STEPS - 1 - steps
        T_now_before = make_pose(observation.history_rotation[before], observation.history_xyz[before])
        self._T_local_rig, self._time_us = self._T_local_rig @ invert(T_now_before), now_us
        return steps

    def _send(self, method: str, request: Any) -> Any:
        request.session_uuid = self._session
        return getattr(self._stub, method).future(request, timeout=self._call_seconds)

    def _wait(self, call: Any, seconds: float) -> Any:
        try:
            return call.result(max(seconds, 0.0))
        except grpc.RpcError as error:
            raise PolicyFaulted(_fault_of(error, self._address.target, self._call_seconds)) from error
        except grpc.FutureTimeoutError as error:
            call.cancel()
            raise PolicyFaulted(_timeout(self._call_seconds)) from error

    def _egomotion(self, observation: Observation, steps: int) -> Any:
        poses = make_pose(observation.history_rotation, observation.history_xyz)
        times = observation.time_us - STEP_US * np.arange(HISTORY_STEPS - 1, -1, -1)
        states = _dynamic_states(poses)
        new = np.arange(HISTORY_STEPS) >= HISTORY_STEPS - steps
        new &= times >= 0  # times before 0 do not exist on the wire
        message = contract.RolloutEgoTrajectory()
        message.trajectory.CopyFrom(write_trajectory(times[new].tolist(), self._T_local_rig @ poses[new]))
        for index in np.flatnonzero(new):
            state = message.dynamic_states.add()
            for field, values in zip(_RATES, states, strict=True):
                getattr(state, field).CopyFrom(write_vector(values[index]))
        return message

    def _images(self, observation: Observation, steps: int) -> list[Any]:
        messages = []
        if observation.images is not None:
            for name, frames in zip(self.cameras, observation.images, strict=True):
                for back in range(min(steps, IMAGE_FRAMES) - 1, -1, -1):
                    time_us = observation.time_us - back * STEP_US
                    message = contract.RolloutCameraImage()
                    image = message.camera_image
                    image.frame_start_us = image.frame_end_us = time_us
                    image.logical_id = name
                    image.image_bytes = encode_image(frames[IMAGE_FRAMES - 1 - back], self._address.coding)
                    messages.append(message)
        return messages

    def _route(self, observation: Observation) -> list[Any]:
        if not len(observation.route_xy):
            return []
        message = contract.RouteRequest()
        message.route.timestamp_us = observation.time_us
        message.route.waypoints.extend(contract.Vec3(x=x, y=y) for x, y in observation.route_xy.tolist())
        return [message]

    def close(self) -> None:
        """End the session and the connection."""
        self._close_session()
        self._channel.close()

    def _close_session(self) -> None:
        if self._session is None:
            return
        request = contract.DriveSessionCloseRequest(session_uuid=self._session)
        self._session = None
        with suppress(grpc.RpcError):  # a driver that is gone has no session
            self._stub.close_session(request, timeout=_CLOSING_SECONDS)


_RATES = ("linear_velocity", "angular_velocity", "linear_acceleration", "angular_acceleration")


def _dynamic_states(poses: Array) -> tuple[Array, Array, Array, Array]:
    """Velocities and accelerations (n, 3), linear and angular, in the rig of each of the poses (n, 4, 4).

    Differences of second order, one-sided at the ends; accelerations are the differences of the velocities.
    """
    rotation = poses[:, :3, :3]
    slope = np.gradient(poses[:, :3, :], STEP_SECONDS, axis=0, edge_order=2)
    accelerated = np.gradient(slope[:, :, 3], STEP_SECONDS, axis=0, edge_order=2)
    spin = np.einsum("nji,njk->nik", rotation, slope[:, :, :3])
    angular = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=-1)
    in_rig = np.einsum("nji,njk->nik", rotation, np.stack([slope[:, :, 3], accelerated], axis=-1))
    return in_rig[..., 0], angular, in_rig[..., 1], np.gradient(angular, STEP_SECONDS, axis=0, edge_order=2)


def read_plan(trajectory: Any, now_us: int, T_rig_local: Array) -> PlannedTrajectory:
    """The plan of an answer: a message `Trajectory` of rig poses in the local frame.

    Poses before now are passed over; where the first is later than now, the way leads there from where the rig is.

    Raises:
        PlanRefused: it does not cover `SHORTEST_PLAN` from now, begins only after that, its times do not rise, or its
            poses are none.
    """
    try:
        times, poses = read_trajectory(trajectory, "plan")
    except InputError as error:
        raise PlanRefused(str(error)) from error
    if len(times) == 0:
        raise PlanRefused("plan of no poses")
    if np.any(np.diff(times) <= 0):
        raise PlanRefused("times of the plan do not increase")
    first, last = (int(times[0]) - now_us) * 1e-6, (int(times[-1]) - now_us) * 1e-6
    shortest = SHORTEST_PLAN * STEP_SECONDS
    if last < shortest or first > shortest:
        raise PlanRefused(
            f"plan of {len(times)} poses from {first:.1f} s to {last:.1f} s from now; control looks {shortest:g} s ahead"
        )
    poses = T_rig_local @ poses
    if first > 0.0:
        times, poses = np.concatenate([[now_us], times]), np.concatenate([np.eye(4)[None], poses])
    wanted = now_us + STEP_US * np.arange(1, FUTURE_STEPS + 1, dtype=np.int64)
    planned = Trajectory(times, poses).interpolate(np.minimum(wanted, times[-1]))
    seconds_beyond = np.maximum(wanted - times[-1], 0) * 1e-6
    velocity = (poses[-1, :3, 3] - poses[-2, :3, 3]) / ((times[-1] - times[-2]) * 1e-6)
    planned[:, :3, 3] += seconds_beyond[:, None] * velocity
    return PlannedTrajectory(planned[:, :3, 3], planned[:, :3, :3])


def _read_told(text: str) -> tuple[str, ...]:
    return _read_cameras(text, "driver")


def _timeout(seconds: float) -> PolicyFault:
    return PolicyFault("policy_timeouts", f"gave no answer within {seconds:g} s")


def _fault_of(error: grpc.RpcError, target: str, seconds: float) -> PolicyFault:
    """What a failed call says of the driver."""
    assert isinstance(error, grpc.Call)
    code, details = error.code(), " ".join((error.details() or "")[:500].split())
    if code == grpc.StatusCode.DEADLINE_EXCEEDED:
        return _timeout(seconds)
    if code in (grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.CANCELLED):
        return PolicyFault("policy_deaths", f"could not be reached at {target}", details)
    return PolicyFault("policy_errors", f"answered with {code.name}", details)


def load_grpc(argument: str | None) -> RemoteDriver:
    """Build the policy `grpc://HOST:PORT` (entry point of the group `olt.policies`).

    Raises:
        InputError: it is no address.
        PolicyFaulted: nobody answers there.
    """
    return RemoteDriver(DriverAddress.parse(argument or ""))
