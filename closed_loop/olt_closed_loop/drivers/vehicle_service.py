"""Our vehicle and controller in AlpaSim: the service `controller.VDCService`."""

from collections.abc import Callable
from typing import Any

import grpc
import numpy as np

from olt_closed_loop.control.plans import PlanRefused
from olt_closed_loop.drivers import contract
from olt_closed_loop.drivers.contract import CallRefused
from olt_closed_loop.drivers.conversions import (
    LATEST_TIME_US,
    read_pose,
    read_trajectory,
    read_vector,
    write_pose,
    write_vector,
)
from olt_closed_loop.drivers.driven_vehicle import DrivenVehicle, MovedVehicle, Rates
from olt_closed_loop.drivers.open_sessions import IDLE_SECONDS, MOST_SESSIONS, OpenSessions
from olt_generator.errors import InputError

LONGEST_RUN_US = 60_000_000
MOST_STATES = 10_000
MOST_POSES = 4096
FASTEST = 100.0
"""m/s and rad/s; what is faster is no vehicle."""
_WHERE = "run_controller_and_vehicle"


class VehicleService:
    """Every session drives a vehicle of its own. Its methods are those of the service, for any number of threads."""

    service = contract.VEHICLE

    def __init__(
        self,
        make_vehicle: Callable[[], DrivenVehicle],
        name: str,
        sessions: int = MOST_SESSIONS,
        idle_seconds: float = IDLE_SECONDS,
    ) -> None:
        self._make, self._name = make_vehicle, name
        self._sessions: OpenSessions[DrivenVehicle] = OpenSessions(sessions, idle_seconds)

    def get_version(self, request: Any, context: grpc.ServicerContext) -> Any:
        """Name and version."""
        return contract.version_of(self._name)

    def start_session(self, request: Any, context: grpc.ServicerContext) -> Any:
        """Begin a session with a vehicle of its own."""
        given = request.vehicle_and_controller_params
        if given.rig_file or given.amend_files:
            raise CallRefused(
                grpc.StatusCode.FAILED_PRECONDITION,
                "rig_file and amend_files are not read here; choose the vehicle by the options of serve-vehicle",
            )
        self._sessions.open(request.session_uuid, self._make)
        return contract.SessionRequestStatus()

    def close_session(self, request: Any, context: grpc.ServicerContext) -> Any:
        """End a session; one that is not open has ended."""
        self._sessions.end(request.session_uuid)
        return contract.Empty()

    def close(self) -> None:
        """End all sessions."""
        self._sessions.close()

    def run_controller_and_vehicle(self, request: Any, context: grpc.ServicerContext) -> Any:
        """Drive to the future time; the states on the way come at the reporting interval, and the last one always."""
        with self._sessions.using(request.session_uuid) as vehicle:
            return _run(vehicle, request)


def _run(vehicle: DrivenVehicle, request: Any) -> Any:
    now_us = request.state.timestamp_us
    stops_us = _stops(now_us, request.future_time_us, request.pose_reporting_interval_us)
    if vehicle.time_us not in (None, now_us):
        raise CallRefused(
            grpc.StatusCode.FAILED_PRECONDITION, f"{_WHERE}: the state is of {now_us} us; {vehicle.time_us} us is due"
        )
    T_local_rig, rates = read_pose(request.state.pose, f"{_WHERE}: state"), _read_rates(request.state.state)
    if len(request.planned_trajectory_in_rig.poses) > MOST_POSES:
        raise InputError(f"{_WHERE}: a plan of more than {MOST_POSES} poses")
    times_us, plan_rig = read_trajectory(request.planned_trajectory_in_rig, f"{_WHERE}: plan")
    if len(times_us) == 0 or times_us[0] > now_us:
        begins = f"begins at {times_us[0]} us" if len(times_us) else "has no poses"
        raise InputError(f"{_WHERE}: the plan {begins}; it must begin with the state, at {now_us} us, or before")
    if request.coerce_dynamic_state or vehicle.time_us is None:
        vehicle.take_over(rates)
    try:
        states = list(vehicle.run(now_us, T_local_rig, times_us, plan_rig, stops_us))
    except PlanRefused as refusal:
        raise InputError(f"{_WHERE}: {refusal}") from refusal
    return _write_states(states)


def _stops(now_us: int, future_us: int, interval_us: int) -> list[int]:
    """The times that are to be told.

    Raises:
        InputError: they are not after now, too far ahead, or too many.
    """
    if not (now_us < future_us <= now_us + LONGEST_RUN_US and future_us < LATEST_TIME_US):
        raise InputError(f"{_WHERE}: from {now_us} to {future_us} us; at most {LONGEST_RUN_US} us ahead are driven")
    if interval_us < 0 or (interval_us and (future_us - now_us) // interval_us > MOST_STATES):
        raise InputError(f"{_WHERE}: a reporting interval of {interval_us} us; give 0, or at most {MOST_STATES} states")
    return [*(range(now_us + interval_us, future_us, interval_us) if interval_us else ()), future_us]


def _read_rates(state: Any) -> Rates:
    vectors = {
        "velocity": state.linear_velocity,
        "angular_velocity": state.angular_velocity,
        "acceleration": state.linear_acceleration,
        "angular_acceleration": state.angular_acceleration,
    }
    rates = Rates(**{name: read_vector(vector, f"{_WHERE}: {name}") for name, vector in vectors.items()})
    fastest = max(np.abs(rates.velocity).max(), np.abs(rates.angular_velocity).max())
    if fastest > FASTEST:
        raise InputError(f"{_WHERE}: a rate of {fastest:.3g}; no vehicle moves at more than {FASTEST:g} m/s or rad/s")
    return rates


def _write_states(states: list[MovedVehicle]) -> Any:
    response = contract.RunResponse()
    for moved in states:
        state = response.states.add(timestamp_us=moved.time_us)
        pose, rates = write_pose(moved.T_local_rig), _write_rates(moved.rates)
        state.pose_local_to_rig.CopyFrom(pose)
        state.pose_local_to_rig_estimated.CopyFrom(pose)
        state.dynamic_state.CopyFrom(rates)
        state.dynamic_state_estimated.CopyFrom(rates)
    last = response.states[-1]
    response.pose_local_to_rig.pose.CopyFrom(last.pose_local_to_rig)
    response.pose_local_to_rig.timestamp_us = last.timestamp_us
    response.pose_local_to_rig_estimated.CopyFrom(response.pose_local_to_rig)
    response.dynamic_state.CopyFrom(last.dynamic_state)
    response.dynamic_state_estimated.CopyFrom(last.dynamic_state)
    return response


def _write_rates(rates: Rates) -> Any:
    return contract.DynamicState(
        linear_velocity=write_vector(rates.velocity),
        angular_velocity=write_vector(rates.angular_velocity),
        linear_acceleration=write_vector(rates.acceleration),
        angular_acceleration=write_vector(rates.angular_acceleration),
    )
