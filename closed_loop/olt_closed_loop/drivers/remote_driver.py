"""A driver of AlpaSim's `egodriver` service as a policy: `grpc://HOST:PORT`.

The rig at the first plan is the origin of the local frame in which the driver is told poses and answers. Where the rig
stands in it later is reckoned from what every policy is shown, its own past poses. In every step the driver gets the
new poses with rates that are differences of them, the route, and the new frames; when all are taken it is asked to
drive. What it answers must reach from now over the second that control looks ahead
(`observations.SHORTEST_PLAN`); past its end it goes on as it ended.

The messages that a driver gets are those of the contract, so it may run anywhere and be written in anything. What it
does wrong is what other policies do wrong (`simulation.answers`): a time limit passed is a timeout, a lost connection a
death, `terminate_session` an exit, and a trajectory that no plan can be made of is refused. Opaque bytes of an answer
are not looked at.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cached_property
from typing import Any
from uuid import uuid4

import grpc
import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.drivers import contract
from olt_closed_loop.drivers.addresses import DriverAddress, read_cameras, read_size
from olt_closed_loop.drivers.conversions import (
    encode_image,
    write_camera,
)
from olt_closed_loop.drivers.observations import read_plan, write_egomotion, write_routes
from olt_closed_loop.simulation.answers import PolicyFault, PolicyFaulted
from olt_closed_loop.simulation.reckoning import Reckoning
from olt_generator.errors import InputError
from olt_generator.poses import Array, invert
from olt_toolkit.policy.contract import (
    HISTORY_STEPS,
    IMAGE_FRAMES,
    STEP_US,
    Observation,
    PlannedTrajectory,
)
from olt_toolkit.rigs.contracts import DEFAULT_CONTRACT

DEFAULT_IMAGE_SIZE = (320, 576)
"""Height and width; the drivers of Alpamayo refuse smaller images (docs/formats/alpasim_services.md)."""
CAMERAS_KEY, SIZE_KEY = "openlongtail-cameras", "openlongtail-image-size"
"""Metadata in which a policy served by `olt closed-loop serve` tells what it needs."""
_CONNECTING_SECONDS, _CLOSING_SECONDS = 10.0, 2.0


class RemoteDriver:
    """See the module. One session at the driver for each rollout."""

    def __init__(self, address: DriverAddress, start_seconds: float = 300.0, call_seconds: float = 30.0) -> None:
        self._address = address
        self.limit_time(call_seconds, start_seconds)
        self._channel = grpc.insecure_channel(address.target, options=contract.CHANNEL_OPTIONS)
        self._stub = contract.Stub(self._channel, contract.EGODRIVER)
        self._session: str | None = None

    @cached_property
    def _told(self) -> tuple[str, tuple[str, ...], tuple[int, int]]:
        """Name, cameras and image size that the driver tells, or what it is taken to want.

        Raises:
            PolicyFaulted: it does not answer, or in no known words.
        """
        seconds = min(self._start_seconds, _CONNECTING_SECONDS)
        try:
            grpc.channel_ready_future(self._channel).result(seconds)
        except grpc.FutureTimeoutError as error:
            where = f"could not be reached at {self._address.target} within {seconds:g} s"
            raise PolicyFaulted(PolicyFault("policy_deaths", where)) from error
        with self._faults(self._start_seconds):
            version, call = self._stub.get_version.with_call(contract.Empty(), timeout=self._start_seconds)
        told = {key: value for key, value in call.initial_metadata() if isinstance(value, str)}
        try:
            cameras = read_cameras(told.get(CAMERAS_KEY, DEFAULT_CONTRACT.name), CAMERAS_KEY)
            size = read_size(told[SIZE_KEY], SIZE_KEY) if SIZE_KEY in told else DEFAULT_IMAGE_SIZE
        except InputError as error:
            fault = PolicyFault("wrong_answers", "told what it needs in no known words", str(error))
            raise PolicyFaulted(fault) from error
        return version.version_id or "driver", cameras, size

    @property
    def name(self) -> str:
        """Name and version, as the driver tells."""
        return self._told[0]

    @property
    def cameras(self) -> tuple[str, ...]:
        """What is rendered for the driver."""
        return self._told[1] if self._address.cameras is None else self._address.cameras

    @property
    def image_size(self) -> tuple[int, int]:
        """Height and width of its images."""
        return self._address.image_size or self._told[2]

    def limit_time(self, call_seconds: float, start_seconds: float) -> None:
        """See `simulation.policy_hosts.TimedPolicy`."""
        self._call_seconds, self._start_seconds = call_seconds, start_seconds

    def reset(self, seed: int, scene: str) -> None:
        """Begin a session at the driver.

        Raises:
            PolicyFaulted: it does not take it.
        """
        self._close_session()
        self._reckoning: Reckoning | None = None
        request = contract.DriveSessionRequest(session_uuid=str(uuid4()), random_seed=seed)
        request.debug_info.scene_id = scene
        available = request.rollout_spec.vehicle.available_cameras
        available.extend(write_camera(name, mounted) for name, mounted in self._mounted_cameras())
        with self._faults(self._start_seconds):
            self._stub.start_session(request, timeout=self._start_seconds)
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
        steps, T_local_rig = self._move_to(observation)
        now_us, deadline = observation.time_us, time.monotonic() + self._call_seconds
        with self._faults(self._call_seconds):
            self._tell("submit_egomotion_observation", write_egomotion(observation, steps, T_local_rig), deadline)
            for route in write_routes(observation):
                self._tell("submit_route", route, deadline)
            for frames in self._frames(observation, steps):
                # Those of one moment at once, as images take long to decode at the other end.
                calls = [
                    self._stub.submit_image_observation.future(frame, timeout=max(0.0, deadline - time.monotonic()))
                    for frame in frames
                ]
                for call in calls:
                    call.result()
            request = contract.DriveRequest(time_now_us=now_us, time_query_us=now_us + STEP_US)
            answer = self._tell("drive", request, deadline)
        if answer.terminate_session:
            raise PolicyFaulted(PolicyFault("policy_exits", "asked to end the session"))
        return read_plan(answer.trajectory, now_us, invert(T_local_rig))

    def _move_to(self, observation: Observation) -> tuple[int, Array]:
        """How many steps of the observation are new, and where the rig is now in the local frame."""
        if self._reckoning is None:
            self._reckoning, steps = Reckoning(np.eye(4), observation.time_us), HISTORY_STEPS
        else:
            steps = self._reckoning.move_to(observation)
        return steps, self._reckoning.T_frame_rig

    def _tell(self, method: str, request: Any, deadline: float) -> Any:
        request.session_uuid = self._session
        return getattr(self._stub, method)(request, timeout=max(0.0, deadline - time.monotonic()))

    @contextmanager
    def _faults(self, seconds: float) -> Iterator[None]:
        """What a call that failed says of the driver."""
        try:
            yield
        except grpc.RpcError as error:
            raise PolicyFaulted(_fault_of(error, self._address.target, seconds)) from error

    def _frames(self, observation: Observation, steps: int) -> Iterator[list[Any]]:
        """The new frames of all cameras, the oldest first."""
        if observation.images is None:
            return
        for back in reversed(range(min(steps, IMAGE_FRAMES))):
            time_us, newest = observation.time_us - back * STEP_US, IMAGE_FRAMES - 1
            frames = zip(self.cameras, observation.images[:, newest - back], strict=True)
            yield [self._frame(name, frame, time_us) for name, frame in frames]

    def _frame(self, name: str, frame: NDArray[np.uint8], time_us: int) -> Any:
        message = contract.RolloutCameraImage(session_uuid=self._session)
        image = message.camera_image
        image.frame_start_us = image.frame_end_us = time_us
        image.logical_id, image.image_bytes = name, encode_image(frame, self._address.coding)
        return message

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


def _fault_of(error: grpc.RpcError, target: str, seconds: float) -> PolicyFault:
    """What a failed call says of the driver."""
    assert isinstance(error, grpc.Call)
    code, details = error.code(), " ".join((error.details() or "")[:500].split())
    if code == grpc.StatusCode.DEADLINE_EXCEEDED:
        return PolicyFault("policy_timeouts", f"gave no answer within {seconds:g} s")
    if code in (grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.CANCELLED):
        return PolicyFault("policy_deaths", f"could not be reached at {target}", details)
    return PolicyFault("policy_errors", f"answered with {code.name}", details)


def load_grpc(argument: str | None) -> RemoteDriver:
    """Build the policy `grpc://HOST:PORT` (entry point of the group `olt.policies`).

    Raises:
        InputError: it is no address.
    """
    return RemoteDriver(DriverAddress.parse(argument or ""))
