"""A policy of ours as a driver of AlpaSim: the service `egodriver.EgodriverService`.

Every session has a policy of its own in a known state; foreign ones run in processes of their own (`PolicyLimits`),
side by side. Policies of ended sessions are used again, because checkpoints load slowly.
"""

import copy
import threading
from contextlib import nullcontext
from dataclasses import dataclass, replace
from multiprocessing import get_all_start_methods, get_context
from typing import Any

import grpc
import numpy as np

from olt_closed_loop.control.plans import PlanRefused
from olt_closed_loop.drivers import contract
from olt_closed_loop.drivers.contract import CallRefused
from olt_closed_loop.drivers.conversions import write_trajectory
from olt_closed_loop.drivers.open_sessions import IDLE_SECONDS, MOST_SESSIONS, OpenSessions
from olt_closed_loop.drivers.remote_driver import CAMERAS_KEY, SIZE_KEY
from olt_closed_loop.drivers.sessions import DriveSession
from olt_closed_loop.simulation.answers import Answer, PolicyFault, word_error
from olt_closed_loop.simulation.policy_hosts import PolicyHost, PolicyLimits, PolicySource, is_of_package
from olt_closed_loop.simulation.policy_process import PolicyNotStarted, host_policy
from olt_generator.errors import InputError
from olt_generator.poses import make_pose
from olt_toolkit.policy.contract import FUTURE_STEPS, STEP_US, Observation, Resettable


@dataclass
class _Driven:
    """A session with its policy, and what ended that."""

    session: DriveSession
    policy: PolicyHost
    fault: PolicyFault | None = None


class DriverService:
    """See the module. Its methods are those of the service, for any number of threads."""

    service = contract.EGODRIVER

    def __init__(
        self,
        policy: PolicySource,
        sessions: int = MOST_SESSIONS,
        limits: PolicyLimits | None = None,
        idle_seconds: float = IDLE_SECONDS,
    ) -> None:
        """Build the first policy; "auto" in the limits gives all but the policies of this package a process each.

        Raises:
            InputError: the policy is not known, does not keep the contract, cannot be copied or cannot be built.
        """
        limits, trusted = limits or PolicyLimits(), is_of_package(policy)
        apart = limits.isolate == "process" or (limits.isolate == "auto" and not trusted)
        self._limits = replace(limits, isolate="process" if apart else "none")
        self._source = policy if apart else _separately(policy)
        # What foreign policies do to the state of this process is watched, which takes them one after another.
        self._turn = nullcontext() if apart or trusted else threading.Lock()
        try:
            first = self._build()
        except PolicyNotStarted as error:
            raise InputError(f"the policy {_word(error.fault)}") from error
        self._idle, self.traits = [first], first.traits
        self._lock = threading.Lock()
        self._sessions: OpenSessions[_Driven] = OpenSessions(sessions, idle_seconds, self._keep)

    def _build(self) -> PolicyHost:
        return host_policy(self._source, self._limits, context=_context_of(self._source))

    def get_version(self, request: Any, context: grpc.ServicerContext) -> Any:
        """Name and version, and in metadata what the policy needs to be shown."""
        height, width = self.traits.image_size
        told = ((CAMERAS_KEY, ",".join(self.traits.cameras) or "none"),)
        context.send_initial_metadata(told + (((SIZE_KEY, f"{height}x{width}"),) if self.traits.cameras else ()))
        return contract.version_of(self.traits.name)

    def start_session(self, request: Any, context: grpc.ServicerContext) -> Any:
        """Begin a session, unless its policy lacks a camera or cannot begin."""
        self._sessions.open(request.session_uuid, lambda: self._begin(request))
        return contract.SessionRequestStatus()

    def _begin(self, request: Any) -> _Driven:
        scene, seed = request.debug_info.scene_id, request.random_seed
        cameras = [camera.logical_id for camera in request.rollout_spec.vehicle.available_cameras]
        driven = _Driven(DriveSession(seed, scene, cameras, self.traits), self._take_policy())
        with self._turn:
            fault = driven.policy.begin(seed, scene)
        if fault:
            self._keep(driven)
            raise CallRefused(grpc.StatusCode.FAILED_PRECONDITION, f"the policy {_word(fault)}")
        return driven

    def _take_policy(self) -> PolicyHost:
        with self._lock:
            if self._idle:
                return self._idle.pop()
        try:
            return self._build()
        except PolicyNotStarted as error:
            raise CallRefused(grpc.StatusCode.FAILED_PRECONDITION, f"the policy {_word(error.fault)}") from error

    def _keep(self, driven: _Driven) -> None:
        with self._lock:
            self._idle.append(driven.policy)

    def close_session(self, request: Any, context: grpc.ServicerContext) -> Any:
        """End a session; one that is not open has ended."""
        self._sessions.end(request.session_uuid)
        return contract.Empty()

    def close(self) -> None:
        """End all sessions, and their policies."""
        self._sessions.close()
        with self._lock:
            for policy in self._idle:
                policy.close()
            self._idle.clear()

    def submit_image_observation(self, request: Any, context: grpc.ServicerContext) -> Any:
        """Keep a frame."""
        with self._sessions.using(request.session_uuid) as driven:
            driven.session.add_image(request.camera_image)
        return contract.Empty()

    def submit_egomotion_observation(self, request: Any, context: grpc.ServicerContext) -> Any:
        """Keep poses."""
        with self._sessions.using(request.session_uuid) as driven:
            driven.session.add_egomotion(request)
        return contract.Empty()

    def submit_route(self, request: Any, context: grpc.ServicerContext) -> Any:
        """Keep the route."""
        with self._sessions.using(request.session_uuid) as driven:
            driven.session.set_route(request.route)
        return contract.Empty()

    def submit_recording_ground_truth(self, request: Any, context: grpc.ServicerContext) -> Any:
        """Nothing: policies are not shown where the recording went."""
        with self._sessions.using(request.session_uuid):
            return contract.Empty()

    def drive(self, request: Any, context: grpc.ServicerContext) -> Any:
        """The pose now and the 64 of the plan after it; no poses where the cameras have too few frames yet.

        What a policy does wrong ends its session: it is not asked again, and every later call is answered the same.
        """
        now_us = request.time_now_us
        with self._sessions.using(request.session_uuid) as driven:
            if request.time_query_us < now_us:
                raise CallRefused(
                    grpc.StatusCode.INVALID_ARGUMENT, f"drive at {now_us} us until {request.time_query_us} us"
                )
            observation, T_local_rig = driven.session.observe(now_us)
            if observation is None:
                return contract.DriveResponse()
            answer = driven.fault or self._ask(driven.policy, observation)
            if isinstance(answer, PolicyFault):
                driven.fault = answer
                raise CallRefused(grpc.StatusCode.INTERNAL, f"the policy {_word(answer)}")
        if isinstance(answer, PlanRefused):
            raise CallRefused(grpc.StatusCode.INTERNAL, f"the policy's plan is refused: {answer}")
        planned = T_local_rig @ make_pose(answer.rotation, answer.xyz)
        times = range(now_us, now_us + (FUTURE_STEPS + 1) * STEP_US, STEP_US)
        response = contract.DriveResponse()
        response.trajectory.CopyFrom(write_trajectory(times, np.concatenate([T_local_rig[None], planned])))
        return response

    def _ask(self, policy: PolicyHost, observation: Observation) -> Answer:
        with self._turn:
            return policy.plan(observation)


def _word(fault: PolicyFault) -> str:
    return f"{fault.what}: {fault.detail}" if fault.detail else fault.what


def _context_of(source: PolicySource) -> Any:
    """How processes of policies are started: for those known by name by a process that has no threads.

    A fork of this one, whose threads may hold any lock, is left to objects, which cannot be brought elsewhere.
    """
    if not isinstance(source, str) or "forkserver" not in get_all_start_methods():
        return None
    context = get_context("forkserver")
    context.set_forkserver_preload([host_policy.__module__])
    return context


def _separately(policy: PolicySource) -> PolicySource:
    """The same, of which every session gets one of its own: an object that resets itself would be that of them all.

    Raises:
        InputError: it cannot be copied.
    """
    if isinstance(policy, str | type) or not isinstance(policy, Resettable):
        return policy
    try:
        given = copy.deepcopy(policy)
    except Exception as error:
        name = type(policy).__name__
        raise InputError(
            f"policy {name} cannot be copied for every session ({word_error(error)}); give a factory"
        ) from error
    return lambda: copy.deepcopy(given)  # pyright: ignore[reportReturnType]
