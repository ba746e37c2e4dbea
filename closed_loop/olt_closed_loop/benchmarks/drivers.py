"""What it costs to have a policy at the other end of a loopback connection, in a process of its own.

Each setting asks once. Beside the policy itself and the `drive` call, a whole step is timed: the new pose, the route
and the `drive` call, without and with the new frames of four cameras.
"""

from collections.abc import Callable
from functools import cache, partial
from itertools import count
from multiprocessing import get_context
from multiprocessing.connection import Connection
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.simulation.policies import RouteFollowingPolicy
from olt_generator.poses import Array
from olt_toolkit.bench.benchmark import Benchmark, Setting
from olt_toolkit.policy.contract import HISTORY_STEPS, IMAGE_FRAMES, STEP_SECONDS, STEP_US, Observation
from olt_toolkit.rigs.rig import CAMERA_INDEX, POLICY_CAMERAS

SPEED = 10.0
IMAGE_SIZE = (320, 576)
_START_US = 2_000_000
_SECONDS_TO_START = 60.0


class WatchingPolicy(RouteFollowingPolicy):
    """Follows the route, and is shown four cameras."""

    name = "watching"
    cameras = POLICY_CAMERAS
    image_size = IMAGE_SIZE


def observe(step: int, images: NDArray[np.uint8] | None = None) -> Observation:
    """A straight drive at `SPEED`, on a route that leads away to the left."""
    positions = np.zeros((HISTORY_STEPS, 3))
    positions[:, 0] = SPEED * STEP_SECONDS * np.arange(1 - HISTORY_STEPS, 1)
    ahead = np.linspace(0.0, 80.0, 20)
    return Observation(
        images=images,
        camera_indices=np.array([CAMERA_INDEX[camera] for camera in POLICY_CAMERAS], dtype=np.int64),
        history_xyz=positions,
        history_rotation=np.tile(np.eye(3), (HISTORY_STEPS, 1, 1)),
        route_xy=np.stack([ahead, 0.002 * ahead**2], axis=-1),
        time_us=_START_US + step * STEP_US,
        seed=0,
    )


@cache
def _images() -> NDArray[np.uint8]:
    """Four frames of each camera, of a street: noise would code badly, one colour too well."""
    from olt_closed_loop.scenes.procedural import generate_scene
    from olt_closed_loop.sensors.ray_casting import rig_sensors

    scene = generate_scene("nominal", 0)
    pose = scene.ego.T_world_rig[0]
    pictures = rig_sensors(scene)(POLICY_CAMERAS, IMAGE_SIZE, pose, int(scene.ego.timestamps_us[0]))
    return np.repeat(pictures[:, None], IMAGE_FRAMES, axis=1)


def _serve(policy: type[RouteFollowingPolicy], connection: Connection) -> None:
    from olt_closed_loop.drivers.driver_service import DriverService
    from olt_closed_loop.drivers.server import serving

    with serving(DriverService(policy)) as port:
        connection.send(port)
        connection.recv()


@cache
def _port(policy: type[RouteFollowingPolicy]) -> int:
    """Where a server process of this one, which ends with it, serves a policy."""
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    context.Process(target=_serve, args=(policy, theirs), daemon=True).start()
    if not ours.poll(_SECONDS_TO_START):
        raise RuntimeError(f"the server did not start within {_SECONDS_TO_START:g} s")
    _held.append(ours)
    return ours.recv()


_held: list[Connection] = []


def _step(policy: type[RouteFollowingPolicy]) -> Callable[[], Array]:
    from olt_closed_loop.drivers.remote_driver import load_grpc

    images = _images() if policy.cameras else None
    driver, steps = load_grpc(f"//127.0.0.1:{_port(policy)}"), count()
    driver.reset(0, "bench")
    return lambda: driver.plan(observe(next(steps), images)).xyz


def _drive_call() -> Callable[[], Array]:
    import grpc

    from olt_closed_loop.drivers import contract
    from olt_closed_loop.drivers.observations import read_plan, write_egomotion, write_routes

    port = _port(RouteFollowingPolicy)
    stub = contract.Stub(grpc.insecure_channel(f"127.0.0.1:{port}"), contract.EGODRIVER)
    seen, session = observe(0), str(uuid4())
    stub.start_session(contract.DriveSessionRequest(session_uuid=session))
    for method, request in [
        ("submit_egomotion_observation", write_egomotion(seen, HISTORY_STEPS, np.eye(4))),
        *(("submit_route", route) for route in write_routes(seen)),
    ]:
        request.session_uuid = session
        getattr(stub, method)(request)
    request = contract.DriveRequest(session_uuid=session, time_now_us=_START_US, time_query_us=_START_US + STEP_US)
    return lambda: read_plan(stub.drive(request).trajectory, _START_US, np.eye(4)).xyz


def _here() -> Callable[[], Array]:
    policy, seen = RouteFollowingPolicy(), observe(0)
    return lambda: policy.plan(seen).xyz


def _measure_error(xyz: Array) -> float:
    """Largest distance between planned positions and those of the policy in this process, metres."""
    return float(np.linalg.norm(xyz - _here()(), axis=1).max())


BENCHMARK = Benchmark(
    title="One plan of the route policy, asked over loopback from a process of its own",
    error_name="largest deviation of the plan",
    error_unit="m",
    reference="the policy asked in this process",
    settings=lambda: [
        Setting("drive call", _drive_call, default=True),
        Setting("pose, route and drive call", partial(_step, RouteFollowingPolicy)),
        Setting("pose, route, four 320 x 576 JPEG frames and drive call", partial(_step, WatchingPolicy)),
        Setting("the policy here", _here),
    ],
    measure_error=_measure_error,
)
