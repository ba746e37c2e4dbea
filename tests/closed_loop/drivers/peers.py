"""Drivers and simulators that are not ours: those of carla-driver-interface, and drivers that do what none should."""

import threading
import time
from contextlib import contextmanager
from pathlib import Path

import grpc
import numpy as np

from olt_closed_loop.drivers import contract
from olt_closed_loop.drivers.conversions import write_trajectory
from olt_closed_loop.drivers.server import serving
from olt_generator.poses import planar_pose

ROOT = Path(__file__).resolve().parents[3]
STEP_US = 100_000


def call_with_bytes(channel, method, request):
    """Whatever bytes come, the call is answered by a result or by a status that is none of a crash."""
    try:
        channel.unary_unary(method)(request, timeout=20.0)
    except grpc.RpcError as error:
        assert error.code() not in (
            grpc.StatusCode.UNKNOWN,
            grpc.StatusCode.UNAVAILABLE,
            grpc.StatusCode.DEADLINE_EXCEEDED,
        ), error.details()


class SteadyDriver:
    """Goes straight on at 8 m/s along the local frame's x, where the ego begins; what was told to it is kept."""

    service = contract.EGODRIVER

    def __init__(self, change=lambda driver, response: response, from_call=1, name="steady"):
        self.change, self.from_call, self.name = change, from_call, name
        self.sessions, self.closed, self.frames, self.poses, self.routes, self.calls = [], [], [], [], [], 0
        self.states = []
        self.released = threading.Event()

    def get_version(self, request, context):
        return contract.VersionId(version_id=self.name)

    def start_session(self, request, context):
        self.sessions.append(request)
        self.calls = 0
        return contract.SessionRequestStatus()

    def close_session(self, request, context):
        self.closed.append(request.session_uuid)
        return contract.Empty()

    def submit_image_observation(self, request, context):
        self.frames.append(request.camera_image)
        return contract.Empty()

    def submit_egomotion_observation(self, request, context):
        self.poses += list(request.trajectory.poses)
        self.states += list(request.dynamic_states)
        return contract.Empty()

    def submit_route(self, request, context):
        self.routes.append(request.route)
        return contract.Empty()

    def submit_recording_ground_truth(self, request, context):
        return contract.Empty()

    def drive(self, request, context):
        self.calls += 1
        now = self.poses[-1].pose
        times = np.arange(0, 41) * STEP_US
        yaw = 2.0 * np.arctan2(now.quat.z, now.quat.w)
        away = 8.0 * times * 1e-6
        poses = planar_pose(now.vec.x + np.cos(yaw) * away, now.vec.y + np.sin(yaw) * away, np.full(41, yaw))
        response = contract.DriveResponse()
        response.trajectory.CopyFrom(write_trajectory((request.time_now_us + times).tolist(), poses))
        bad = self.calls >= self.from_call
        return self.change(self, response) if bad else response


def keep_poses(count):
    def change(driver, response):
        del response.trajectory.poses[count:]
        return response

    return change


def shift_times(by_us):
    def change(driver, response):
        for pose in response.trajectory.poses:
            pose.timestamp_us += by_us
        return response

    return change


def put(value):
    def change(driver, response):
        response.trajectory.poses[3].pose.vec.x = value
        return response

    return change


def delay(by_us):
    """The plan begins later, and ends when it did."""

    def change(driver, response):
        kept = list(response.trajectory.poses)
        begin_us = kept[0].timestamp_us + by_us
        del response.trajectory.poses[:]
        response.trajectory.poses.extend(pose for pose in kept if pose.timestamp_us >= begin_us)
        return response

    return change


def set_time(index, from_index):
    def change(driver, response):
        poses = response.trajectory.poses
        poses[index].timestamp_us = poses[from_index].timestamp_us
        return response

    return change


def go_back(driver, response):
    now = driver.poses[-1].pose.vec.x
    for pose in response.trajectory.poses:
        pose.pose.vec.x = 2.0 * now - pose.pose.vec.x
    return response


def go_beside(driver, response):
    for pose in response.trajectory.poses:
        pose.pose.vec.y += 5.5
    return response


def answer_in_the_rig(driver, response):
    now = driver.poses[-1].pose.vec
    for pose in response.trajectory.poses:
        pose.pose.vec.x -= now.x
        pose.pose.vec.y -= now.y
    return response


def reverse_times(driver, response):
    poses = list(response.trajectory.poses)[::-1]
    del response.trajectory.poses[:]
    response.trajectory.poses.extend(poses)
    return response


def forget_rotation(driver, response):
    response.trajectory.poses[2].pose.ClearField("quat")
    return response


def terminate(driver, response):
    response.terminate_session = True
    return response


def hang(driver, response):
    driver.released.wait(20.0)
    return response


def raise_error(driver, response):
    raise RuntimeError("no engine")


def be_slow(driver, response):
    time.sleep(0.05)
    return response


@contextmanager
def driver_at(driver):
    """Serve a driver; gives the policy that reaches it without cameras."""
    with serving(driver) as port:
        try:
            yield f"grpc://127.0.0.1:{port}?cameras=none"
        finally:
            driver.released.set()
