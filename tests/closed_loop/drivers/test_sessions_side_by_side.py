"""Sessions of several rollouts at once: each as if it were alone, whatever the policies of others do."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import grpc
import numpy as np
import pytest

from olt_closed_loop.drivers import contract
from olt_closed_loop.drivers.conversions import encode_image, write_trajectory
from olt_closed_loop.drivers.driven_vehicle import DrivenVehicle
from olt_closed_loop.drivers.driver_service import DriverService
from olt_closed_loop.drivers.server import serving
from olt_closed_loop.drivers.vehicle_service import VehicleService
from olt_closed_loop.simulation.policies import ConstantVelocityPolicy
from olt_closed_loop.simulation.policy_hosts import PolicyLimits
from olt_closed_loop.vehicle.parameters import VehicleParameters
from olt_generator.errors import InputError
from olt_generator.poses import planar_pose
from olt_toolkit.policy.contract import PlannedTrajectory
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE, FRONT_WIDE

STEP_US, SESSIONS, STEPS = 100_000, 8, 8


class Remembering:
    """Plans by what it sees now, by its seed, and by how often it was asked."""

    name, cameras, image_size = "remembering", (FRONT_WIDE,), (8, 12)

    def reset(self, seed, scene):
        self.generator, self.asked = np.random.default_rng(seed), 0

    def plan(self, observation):
        self.asked += 1
        plan = ConstantVelocityPolicy().plan(observation)
        shade = observation.images.astype(float).mean() * 1e-3
        return PlannedTrajectory(plan.xyz + self.asked * 0.01 + shade + 0.01 * self.generator.random(3), plan.rotation)


class Rude:
    """Hangs, dies or raises, as the scene says."""

    name, cameras, image_size = "rude", (), (0, 0)

    def reset(self, seed, scene):
        self.scene = scene

    def plan(self, observation):
        if self.scene == "hang":
            time.sleep(60.0)
        if self.scene == "die":
            import os

            os.abort()
        if self.scene == "raise":
            raise ValueError("no engine")
        return ConstantVelocityPolicy().plan(observation)


class Rollout:
    """What a simulator tells one session, and the bytes of the answers."""

    def __init__(self, port, session, seed=0, cameras=(), scene="scene"):
        self.channel = grpc.insecure_channel(f"127.0.0.1:{port}", options=contract.CHANNEL_OPTIONS)
        self.stub, self.session = contract.Stub(self.channel, contract.EGODRIVER), session
        self.seed, self.cameras = seed, cameras
        request = contract.DriveSessionRequest(session_uuid=session, random_seed=seed)
        request.debug_info.scene_id = scene
        for name in cameras:
            request.rollout_spec.vehicle.available_cameras.add(logical_id=name)
        self.stub.start_session(request)

    def step(self, index):
        now_us = index * STEP_US
        request = contract.RolloutEgoTrajectory(session_uuid=self.session)
        request.trajectory.CopyFrom(write_trajectory([now_us], planar_pose(0.5 * index + self.seed, 0.0, 0.1)[None]))
        self.stub.submit_egomotion_observation(request)
        for name in self.cameras:
            message = contract.RolloutCameraImage(session_uuid=self.session)
            image = message.camera_image
            image.logical_id, image.frame_start_us, image.frame_end_us = name, now_us, now_us
            image.image_bytes = encode_image(np.full((3, 8, 12), 10 * self.seed + index, np.uint8), "png")
            self.stub.submit_image_observation(message)
        drive = contract.DriveRequest(session_uuid=self.session, time_now_us=now_us, time_query_us=now_us + STEP_US)
        return self.stub.drive(drive, timeout=50.0).SerializeToString()

    def run(self, steps=STEPS):
        answers = [self.step(index) for index in range(steps)]
        self.stub.close_session(contract.DriveSessionCloseRequest(session_uuid=self.session))
        self.channel.close()
        return answers


def drive(port, number, when):
    return Rollout(port, f"{when} {number}", seed=number, cameras=(FRONT_WIDE,)).run()


@pytest.mark.parametrize("isolate", ["none", "process"])
def test_eight_sessions_at_once_are_answered_as_one_by_one(isolate):
    service = DriverService(Remembering, limits=PolicyLimits(isolate=isolate))
    with serving(service) as port, ThreadPoolExecutor(SESSIONS) as pool:
        alone = [drive(port, number, "alone") for number in range(SESSIONS)]
        together = list(pool.map(lambda number: drive(port, number, "together"), range(SESSIONS)))
    service.close()
    assert together == alone
    assert len({answers[-1] for answers in alone}) == SESSIONS
    assert alone[0][-1] != alone[0][-2]


def test_sessions_of_one_object_do_not_share_it():
    """An object that resets itself is copied: the steps of two sessions are taken in turn."""
    service = DriverService(Remembering(), limits=PolicyLimits(isolate="none"))
    with serving(service) as port:
        alone = [Rollout(port, f"alone {seed}", seed, (FRONT_WIDE,)).run() for seed in (1, 2)]
        rollouts = [Rollout(port, f"in turn {seed}", seed, (FRONT_WIDE,)) for seed in (1, 2)]
        in_turn = [[rollout.step(index) for rollout in rollouts] for index in range(STEPS)]
    assert [list(answers) for answers in zip(*in_turn, strict=True)] == alone

    class Uncopyable(Rude):
        def __init__(self):
            self.lock = threading.Lock()

    with pytest.raises(InputError, match="cannot be copied for every session"):
        DriverService(Uncopyable(), limits=PolicyLimits(isolate="none"))


def code_of(call, *arguments):
    with pytest.raises(grpc.RpcError) as raised:
        call(*arguments)
    return raised.value.code(), raised.value.details()


def test_a_foreign_policy_hurts_its_own_session_only():
    service = DriverService(Rude, limits=PolicyLimits(call_seconds=4.0))
    with serving(service) as port, ThreadPoolExecutor(1) as pool:
        hanging = pool.submit(code_of, Rollout(port, "a", scene="hang").step, 0)
        assert len(Rollout(port, "b").run()) == STEPS
        code, words = hanging.result()
        assert (code, words) == (grpc.StatusCode.INTERNAL, "the policy gave no answer within 4 s")
        for scene, meant in (("die", "died of SIGABRT"), ("raise", "raised ValueError: no engine")):
            bad = Rollout(port, scene, scene=scene)
            for index in range(2):  # it is not asked again, and the answer stays
                code, words = code_of(bad.step, index)
                assert code == grpc.StatusCode.INTERNAL
                assert meant in words
            bad.stub.close_session(contract.DriveSessionCloseRequest(session_uuid=scene))
            # The next session gets a policy in a known state.
            assert len(Rollout(port, f"after {scene}").run()) == STEPS
    service.close()


def test_policies_by_name_get_processes_too():
    service = DriverService("constant_velocity", limits=PolicyLimits(isolate="process"))
    with serving(service) as port:
        answers = Rollout(port, "a").run()
    service.close()
    here = DriverService("constant_velocity")
    with serving(here) as port:
        assert Rollout(port, "a").run() == answers


def wait_until(holds, seconds=20.0):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if holds():
            return True
        time.sleep(0.05)
    return False


def is_open(call):
    try:
        call()
    except grpc.RpcError as error:
        assert error.code() == grpc.StatusCode.NOT_FOUND
        assert "one without a call for 1 s is dropped" in error.details()
        return False
    return True


def test_idle_sessions_are_dropped_and_busy_ones_are_not():
    service = DriverService("constant_velocity", sessions=2, idle_seconds=1.0)
    with serving(service) as port:
        idle, busy = Rollout(port, "idle"), Rollout(port, "busy")
        idle.step(0)
        for index in range(30):
            busy.step(index)
            time.sleep(0.1)
        assert not is_open(lambda: idle.step(1))
        Rollout(port, "has room").step(0)
        busy.step(30)
    service.close()


def test_a_call_that_takes_long_is_no_idle_session():
    service = DriverService(Rude, limits=PolicyLimits(call_seconds=3.0), idle_seconds=0.5)
    with serving(service) as port:
        assert code_of(Rollout(port, "a", scene="hang").step, 0)[1] == "the policy gave no answer within 3 s"
    service.close()


def test_idle_sessions_of_the_vehicle_are_dropped():
    parameters = VehicleParameters.from_dimensions(DEFAULT_VEHICLE)
    service = VehicleService(lambda: DrivenVehicle(parameters), "kinematic", idle_seconds=1.0)
    with serving(service) as port:
        stub = contract.Stub(grpc.insecure_channel(f"127.0.0.1:{port}"), contract.VEHICLE)
        stub.start_session(contract.VDCSessionRequest(session_uuid="a"))

        def reopened():
            try:
                stub.start_session(contract.VDCSessionRequest(session_uuid="a"))
            except grpc.RpcError as error:
                assert error.code() == grpc.StatusCode.ALREADY_EXISTS
                return False
            return True

        assert not reopened()
        assert wait_until(reopened)
    service.close()
