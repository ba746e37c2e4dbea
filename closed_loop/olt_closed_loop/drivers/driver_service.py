"""A policy of ours as a driver of AlpaSim: the service `egodriver.EgodriverService`.

Every session has a policy of its own in a known state. Policies of ended sessions are used again, because checkpoints
load slowly; they are asked one after another, because what they do to the state of the process is watched.
"""

import threading
import time
from dataclasses import dataclass, field
from typing import Any

import grpc
import numpy as np

from olt_closed_loop.control.plans import PlanRefused
from olt_closed_loop.drivers import contract
from olt_closed_loop.drivers.contract import CallRefused
from olt_closed_loop.drivers.conversions import write_trajectory
from olt_closed_loop.drivers.remote_driver import CAMERAS_KEY, SIZE_KEY
from olt_closed_loop.drivers.sessions import DriveSession
from olt_closed_loop.simulation.answers import PolicyFault, PolicyFaulted
from olt_closed_loop.simulation.policy_hosts import LocalPolicy, PolicySource
from olt_generator.errors import InputError
from olt_generator.poses import make_pose
from olt_toolkit.policy.contract import FUTURE_STEPS, STEP_US

IDLE_SECONDS = 600.0
"""A session of which nothing was heard for so long makes room where there are too many."""


@dataclass
class _Open:
    """A session, its policy, and when something was last heard of it."""

    session: DriveSession
    policy: LocalPolicy
    lock: threading.Lock = field(default_factory=threading.Lock)
    heard: float = field(default_factory=time.monotonic)


class DriverService:
    """See the module. Its methods are those of the service, for any number of threads."""

    service = contract.EGODRIVER

    def __init__(self, policy: PolicySource, sessions: int = 64) -> None:
        """Build the first policy.

        Raises:
            InputError: the policy is not known, does not keep the contract, or cannot be copied.
        """
        self._source, self._most = policy, sessions
        first = _build(policy)
        self._idle, self.traits = [first], first.traits
        self._open: dict[str, _Open] = {}
        self._lock, self._calls = threading.Lock(), threading.Lock()

    def get_version(self, request: Any, context: grpc.ServicerContext) -> Any:
        """Name and version, and in metadata what the policy needs to be shown."""
        height, width = self.traits.image_size
        told = ((CAMERAS_KEY, ",".join(self.traits.cameras) or "none"),)
        context.send_initial_metadata(told + (((SIZE_KEY, f"{height}x{width}"),) if self.traits.cameras else ()))
        return contract.version_of(self.traits.name)

    def start_session(self, request: Any, context: grpc.ServicerContext) -> Any:
        """Begin a session, unless its policy lacks a camera or cannot begin."""
        name, scene = request.session_uuid, request.debug_info.scene_id
        if not name:
            raise CallRefused(grpc.StatusCode.INVALID_ARGUMENT, "session without a session_uuid")
        cameras = [camera.logical_id for camera in request.rollout_spec.vehicle.available_cameras]
        session = DriveSession(request.random_seed, scene, cameras, self.traits)
        opened = _Open(session, self._take_policy())
        try:
            self._add(name, opened)
            with self._calls:
                fault = opened.policy.begin(request.random_seed, scene)
        except CallRefused:
            self._idle.append(opened.policy)
            raise
        if fault:
            self._close(name)
            raise CallRefused(grpc.StatusCode.FAILED_PRECONDITION, f"the policy {fault.what}: {fault.detail}")
        return contract.SessionRequestStatus()

    def _take_policy(self) -> LocalPolicy:
        with self._lock:
            if self._idle:
                return self._idle.pop()
        return _build(self._source)

    def _add(self, name: str, opened: _Open) -> None:
        with self._lock:
            if name in self._open:
                raise CallRefused(grpc.StatusCode.ALREADY_EXISTS, f"session {name!r} is open")
            if len(self._open) >= self._most:
                self._forget_idle()
            if len(self._open) >= self._most:
                raise CallRefused(grpc.StatusCode.RESOURCE_EXHAUSTED, f"{self._most} sessions are open; close one")
            self._open[name] = opened

    def _forget_idle(self) -> None:
        forgotten = time.monotonic() - IDLE_SECONDS
        for name in [name for name, each in self._open.items() if each.heard < forgotten]:
            self._idle.append(self._open.pop(name).policy)

    def close_session(self, request: Any, context: grpc.ServicerContext) -> Any:
        """End a session; one that is not open has ended."""
        self._close(request.session_uuid)
        return contract.Empty()

    def _close(self, name: str) -> None:
        with self._lock:
            if name in self._open:
                self._idle.append(self._open.pop(name).policy)

    def submit_image_observation(self, request: Any, context: grpc.ServicerContext) -> Any:
        """Keep a frame."""
        opened = self._find(request)
        with opened.lock:
            opened.session.add_image(request.camera_image)
        return contract.Empty()

    def submit_egomotion_observation(self, request: Any, context: grpc.ServicerContext) -> Any:
        """Keep poses."""
        opened = self._find(request)
        with opened.lock:
            opened.session.add_egomotion(request)
        return contract.Empty()

    def submit_route(self, request: Any, context: grpc.ServicerContext) -> Any:
        """Keep the route."""
        opened = self._find(request)
        with opened.lock:
            opened.session.set_route(request.route)
        return contract.Empty()

    def submit_recording_ground_truth(self, request: Any, context: grpc.ServicerContext) -> Any:
        """Nothing: policies are not shown where the recording went."""
        self._find(request)
        return contract.Empty()

    def drive(self, request: Any, context: grpc.ServicerContext) -> Any:
        """The pose now and the 64 of the plan after it; no poses where the cameras have too few frames yet."""
        opened, now_us = self._find(request), request.time_now_us
        if request.time_query_us < now_us:
            raise CallRefused(
                grpc.StatusCode.INVALID_ARGUMENT, f"drive at {now_us} us until {request.time_query_us} us"
            )
        with opened.lock:
            observation, T_local_rig = opened.session.observe(now_us)
            if observation is None:
                return contract.DriveResponse()
            with self._calls:
                answer = opened.policy.plan(observation)
        if isinstance(answer, PolicyFault):
            raise CallRefused(grpc.StatusCode.INTERNAL, f"the policy {answer.what}: {answer.detail}")
        if isinstance(answer, PlanRefused):
            raise CallRefused(grpc.StatusCode.INTERNAL, f"the policy's plan is refused: {answer}")
        planned = T_local_rig @ make_pose(answer.rotation, answer.xyz)
        times = range(now_us, now_us + (FUTURE_STEPS + 1) * STEP_US, STEP_US)
        response = contract.DriveResponse()
        response.trajectory.CopyFrom(write_trajectory(times, np.concatenate([T_local_rig[None], planned])))
        return response

    def _find(self, request: Any) -> _Open:
        opened = self._open.get(request.session_uuid)
        if opened is None:
            raise CallRefused(grpc.StatusCode.NOT_FOUND, f"session {request.session_uuid!r} is not open")
        opened.heard = time.monotonic()
        return opened


def _build(source: PolicySource) -> LocalPolicy:
    try:
        return LocalPolicy(source)
    except PolicyFaulted as error:
        raise InputError(str(error)) from error
