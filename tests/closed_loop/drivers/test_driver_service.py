"""Our policies as drivers of AlpaSim: the peer's simulator drives them, in any order and with any bytes."""

import threading

import grpc
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_closed_loop.drivers import contract
from olt_closed_loop.drivers.conversions import encode_image, read_trajectory, write_pose, write_trajectory
from olt_closed_loop.drivers.driver_service import DriverService
from olt_closed_loop.drivers.server import serving
from olt_closed_loop.simulation.policies import ConstantVelocityPolicy
from olt_closed_loop.simulation.policy_hosts import PolicyLimits
from olt_generator.errors import InputError
from olt_generator.poses import planar_pose, transform
from olt_toolkit.policy.contract import PlannedTrajectory
from olt_toolkit.rigs.rig import CROSS_LEFT, FRONT_WIDE

from .peers import call_with_bytes

STEP_US = 100_000
NAN = float("nan")
HERE = PolicyLimits(isolate="none")


class Looking:
    """Keeps what it sees and goes straight on."""

    name, cameras, image_size = "looking", (CROSS_LEFT, FRONT_WIDE), (8, 12)
    seen = None  # a list that tests put here

    def reset(self, seed, scene):
        self.seed, self.scene = seed, scene

    def plan(self, observation):
        if Looking.seen is not None:
            Looking.seen.append(observation)
        return ConstantVelocityPolicy().plan(observation)


@pytest.fixture
def seen(monkeypatch):
    monkeypatch.setattr(Looking, "seen", [])
    return Looking.seen


class Client:
    """A simulator, one call at a time."""

    def __init__(self, port):
        self.channel = grpc.insecure_channel(f"127.0.0.1:{port}", options=contract.CHANNEL_OPTIONS)
        self.stub = contract.Stub(self.channel, contract.EGODRIVER)

    def start(self, cameras=(), session="a", seed=5, scene="scene"):
        request = contract.DriveSessionRequest(session_uuid=session, random_seed=seed)
        request.debug_info.scene_id = scene
        for name in cameras:
            request.rollout_spec.vehicle.available_cameras.add(logical_id=name)
        self.stub.start_session(request)

    def egomotion(self, times, poses, speeds=None, session="a"):
        request = contract.RolloutEgoTrajectory(session_uuid=session)
        request.trajectory.CopyFrom(write_trajectory(times, poses))
        for speed in speeds or ():
            request.dynamic_states.add().linear_velocity.x = speed
        self.stub.submit_egomotion_observation(request)

    def image(self, name, time_us, content, session="a"):
        request = contract.RolloutCameraImage(session_uuid=session)
        image = request.camera_image
        image.logical_id, image.frame_start_us, image.frame_end_us, image.image_bytes = name, time_us, time_us, content
        self.stub.submit_image_observation(request)

    def route(self, time_us, points, session="a"):
        request = contract.RouteRequest(session_uuid=session)
        request.route.timestamp_us = time_us
        for point in points:
            request.route.waypoints.add(**dict(zip("xyz", point, strict=True)))
        self.stub.submit_route(request)

    def drive(self, now_us, session="a", query_us=None):
        query_us = now_us + STEP_US if query_us is None else query_us
        return self.stub.drive(
            contract.DriveRequest(session_uuid=session, time_now_us=now_us, time_query_us=query_us)
        ).trajectory

    def close(self, session="a"):
        self.stub.close_session(contract.DriveSessionCloseRequest(session_uuid=session))


@pytest.fixture
def client_of():
    opened = []

    def make(policy, limits=HERE, **options):
        service = DriverService(policy, limits=limits, **options)
        context = serving(service)
        client = Client(context.__enter__())
        opened.append((service, context, client))
        return client

    yield make
    for service, context, client in opened:
        client.channel.close()
        context.__exit__(None, None, None)
        service.close()


def drive_of(seconds, speed=10.0, yaw_rate=0.2):
    """Poses of a steady turn on a slope that begins anywhere."""
    yaw = yaw_rate * seconds
    chord = speed * seconds * np.sinc(yaw / (2.0 * np.pi))
    begin = planar_pose(100.0, -50.0, 2.5)
    begin[:3, :3] = begin[:3, :3] @ slope(0.05)
    return begin @ planar_pose(chord * np.cos(yaw / 2), chord * np.sin(yaw / 2), yaw)


def slope(pitch):
    cos, sin = np.cos(pitch), np.sin(pitch)
    return np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])


def code_of(call, *arguments, **options):
    with pytest.raises(grpc.RpcError) as raised:
        call(*arguments, **options)
    return raised.value.code(), raised.value.details()


def test_what_a_policy_sees(client_of, seen):
    client = client_of(Looking)
    client.start((FRONT_WIDE, CROSS_LEFT, "camera_other"))
    times = 7_000_000 + STEP_US * np.arange(-20, 1)
    client.egomotion(times.tolist(), drive_of((times - 7_000_000) * 1e-6))
    shades = {}
    for name in (FRONT_WIDE, CROSS_LEFT, "camera_other"):
        for back in range(6):
            shades[name, back] = 20 * back + (100 if name == FRONT_WIDE else 0)
            image = np.full((3, 80, 120), shades[name, back], np.uint8)
            client.image(name, 7_000_000 - back * STEP_US, encode_image(image, "png"))
    client.route(6_900_000, [(x, 1.0, 0.0) for x in range(10)] + [(NAN, NAN, NAN)] * 10)
    plan_times, planned = read_trajectory(client.drive(7_000_000), "plan")
    (observation,) = seen
    assert observation.time_us == 7_000_000
    assert observation.images.shape == (2, 4, 3, 8, 12)
    expected = [[shades[name, back] for back in (3, 2, 1, 0)] for name in (CROSS_LEFT, FRONT_WIDE)]
    assert observation.images[:, :, 1, 4, 6].tolist() == expected
    assert observation.camera_indices.tolist() == [0, 1]
    flat = drive_of(STEP_US * 1e-6 * np.arange(-15, 1))
    history = np.linalg.inv(flat[-1]) @ flat
    np.testing.assert_allclose(observation.history_xyz, history[:, :3, 3], atol=1e-4)
    np.testing.assert_allclose(observation.history_rotation, history[:, :3, :3], atol=1e-6)
    then = drive_of(np.array([-0.1]))[0]
    points = np.array([(x, 1.0, 0.0) for x in range(10)], dtype=float)
    np.testing.assert_allclose(
        observation.route_xy, transform(np.linalg.inv(flat[-1]) @ then, points)[:, :2], atol=1e-4
    )
    # The way goes on straight from where the rig is, at now and every 0.1 s.
    assert plan_times.tolist() == [7_000_000 + k * STEP_US for k in range(65)]
    meant = ConstantVelocityPolicy().plan(observation)
    np.testing.assert_allclose(planned[0], flat[-1], atol=1e-5)
    np.testing.assert_allclose(transform(flat[-1], meant.xyz), planned[1:, :3, 3], atol=1e-4)


def test_messages_of_a_step_may_come_in_any_order(client_of, seen):
    """Every order of them shows the policy the same."""
    client = client_of(Looking)
    times = 3_000_000 + STEP_US * np.arange(-16, 1)
    poses = drive_of(times * 1e-6)
    coded = encode_image(np.full((3, 8, 12), 9, np.uint8), "png")

    @settings(max_examples=15, deadline=None)
    @given(st.randoms(use_true_random=False))
    def in_some_order(random):
        client.start((FRONT_WIDE, CROSS_LEFT))
        calls = [
            lambda: client.egomotion(times[:9].tolist(), poses[:9]),
            lambda: client.egomotion(times[9:].tolist(), poses[9:]),
            lambda: client.route(3_000_000, [(1.0, 0.0, 0.0), (2.0, 0.5, 0.0)]),
            *(
                lambda name=name, back=back: client.image(name, 3_000_000 - back * STEP_US, coded)
                for name in (FRONT_WIDE, CROSS_LEFT)
                for back in range(4)
            ),
        ]
        random.shuffle(calls)
        for call in calls:
            call()
        client.drive(3_000_000)
        client.close()

    in_some_order()
    first = vars(seen[0])
    for observation in seen[1:]:
        for name, value in vars(observation).items():
            np.testing.assert_array_equal(value, first[name])


def test_before_the_first_pose_the_rig_came_straight(client_of, seen, monkeypatch):
    monkeypatch.setattr(Looking, "cameras", ())
    client = client_of(Looking)
    client.start()
    client.egomotion([1_000_000], planar_pose(3.0, 4.0, 1.0)[None], speeds=[6.0])
    client.drive(1_000_000)
    np.testing.assert_allclose(seen[0].history_xyz[:, 0], 0.6 * np.arange(-15, 1), atol=1e-5)
    client.start(session="told no speed")
    client.egomotion([1_000_000, 1_200_000], planar_pose(np.array([0.0, 1.0]), 0.0, 0.0), session="told no speed")
    client.drive(1_200_000, "told no speed")
    np.testing.assert_allclose(seen[1].history_xyz[:, 0], 0.5 * np.arange(-15, 1), atol=1e-5)


def test_too_few_frames_answer_with_no_poses(client_of):
    client = client_of(Looking)
    client.start((FRONT_WIDE, CROSS_LEFT))
    coded = encode_image(np.zeros((3, 8, 12), np.uint8), "jpeg")
    for step in range(6):
        now = step * STEP_US
        client.egomotion([now], planar_pose(float(step), 0.0, 0.0)[None])
        client.image(FRONT_WIDE, now, coded)
        if step != 1:  # a frame that is lost
            client.image(CROSS_LEFT, now, coded)
        assert len(client.drive(now).poses) == (65 if step == 5 else 0)


def test_calls_that_make_no_sense_are_refused_in_words(client_of):
    client = client_of(Looking)
    invalid, failed = grpc.StatusCode.INVALID_ARGUMENT, grpc.StatusCode.FAILED_PRECONDITION
    assert code_of(client.drive, 0)[0] == grpc.StatusCode.NOT_FOUND
    assert code_of(client.start, session="")[0] == invalid
    code, words = code_of(client.start, (FRONT_WIDE,))
    assert code == failed
    assert f"needs the cameras {CROSS_LEFT}" in words
    client.start((FRONT_WIDE, CROSS_LEFT))
    assert code_of(client.start, (FRONT_WIDE, CROSS_LEFT))[0] == grpc.StatusCode.ALREADY_EXISTS
    assert code_of(client.drive, 0)[0] == failed  # no pose yet
    pose = planar_pose(0.0, 0.0, 0.0)[None]
    nowhere = planar_pose(NAN, 0.0, 0.0)[None]
    assert code_of(client.egomotion, [0], nowhere) == (invalid, "egomotion: pose 0 is not finite")
    assert code_of(client.egomotion, [2**63], pose)[0] == invalid
    assert code_of(client.egomotion, [0], pose, speeds=[1.0, 2.0])[0] == invalid
    assert code_of(client.egomotion, [0], pose, speeds=[NAN])[0] == invalid
    client.egomotion([0, STEP_US], np.repeat(pose, 2, axis=0))
    assert code_of(client.drive, 2 * STEP_US)[0] == failed
    assert code_of(client.drive, STEP_US, query_us=0)[0] == invalid
    assert code_of(client.image, "camera_roof", 0, b"")[0] == invalid
    for content in (
        b"",
        b"GIF89a",
        b"\xff\xd8\xff" + b"\0" * 50,
        encode_image(np.zeros((3, 9, 9), np.uint8), "png")[:60],
    ):
        assert code_of(client.image, FRONT_WIDE, 0, content)[0] == invalid
    assert code_of(client.route, 0, [(np.inf, 0.0, 0.0)])[0] == invalid
    assert code_of(client.route, 0, [(0.0, 0.0, 0.0)] * 1001)[0] == invalid
    client.close()
    client.close()


def test_an_image_of_any_shape_costs_no_more_than_its_pixels(client_of, seen):
    """A line of pixels fits once it is cut, not by being blown up to the height of the policy's images."""
    client = client_of(Looking)
    client.start((FRONT_WIDE, CROSS_LEFT))
    client.egomotion([0, 300_000], np.repeat(planar_pose(0.0, 0.0, 0.0)[None], 2, axis=0))
    for step in range(4):
        client.image(FRONT_WIDE, step * STEP_US, encode_image(np.full((3, 1, 60_000), 7, np.uint8), "png"))
        client.image(CROSS_LEFT, step * STEP_US, encode_image(np.full((3, 5000, 2), 8, np.uint8), "png"))
    client.drive(300_000)
    assert np.unique(seen[0].images[1]).tolist() == [7]
    assert np.unique(seen[0].images[0]).tolist() == [8]


def raising(observation):
    raise ValueError("no engine")


def leaving(observation):
    raise SystemExit(3)


def going_wild(observation):
    return PlannedTrajectory(np.full((64, 3), np.nan), np.tile(np.eye(3), (64, 1, 1)))


@pytest.mark.parametrize(
    ("plan", "words"),
    [(raising, "raised ValueError: no engine"), (leaving, "called for an exit"), (going_wild, "refused")],
)
def test_what_a_policy_does_wrong_is_a_status_and_the_server_lives(client_of, plan, words):
    class Bad:
        name, cameras, image_size = "bad", (), (0, 0)

        def plan(self, observation):
            return plan(observation)

    client = client_of(Bad)
    for session in "ab":
        client.start(session=session)
        client.egomotion([0], planar_pose(0.0, 0.0, 0.0)[None], session=session)
        code, told = code_of(client.drive, 0, session)
        assert code == grpc.StatusCode.INTERNAL
        assert words in told


def test_sessions_are_bounded(client_of):
    client = client_of("constant_speed", sessions=2)
    client.start(session="a")
    client.start(session="b")
    assert code_of(client.start, session="c")[0] == grpc.StatusCode.RESOURCE_EXHAUSTED
    client.close("a")
    client.start(session="c")


def test_log_replay_refuses_other_scenes(client_of):
    client = client_of("recorded:cyclists:1")
    code, words = code_of(client.start, scene="elsewhere")
    assert code == grpc.StatusCode.FAILED_PRECONDITION
    assert "and drives elsewhere" in words
    client.start(scene="")


def test_a_taken_port_and_an_unknown_policy():
    with (
        serving(DriverService("route")) as port,
        pytest.raises(InputError, match="is the port taken"),
        serving(DriverService("route"), port=port),
    ):
        pass
    with pytest.raises(InputError, match="policy 'nobody' is not known"):
        DriverService("nobody")


@pytest.mark.parametrize("policy", ["route", "constant_speed", "standing", "constant_velocity"])
def test_the_peers_loop_drives_our_policies(policy):
    testing = pytest.importorskip("carla_driver_interface.testing", reason="needs the package carla-driver-interface")
    with (
        serving(DriverService(policy)) as port,
        testing.FakeLoop(
            f"127.0.0.1:{port}",
            cameras=(testing.FakeCamera(width=64, height=36),),
            initial_speed_mps=8.0,
            initial_lateral_offset_m=1.0,
        ) as loop,
    ):
        result = loop.run(40)
    assert result.steps == 40
    assert not result.terminated_by_policy
    speed, offset = result.speeds_mps[-1], result.lateral_offsets_m[-1]
    if policy == "route":  # the way back to the lane is longer than the lane, and the loop takes that for speed
        assert 8.0 < speed < 9.0
        assert abs(offset) < 0.1
    else:
        assert speed == pytest.approx(0.0 if policy == "standing" else 8.0, abs=0.05)
        assert offset == pytest.approx(1.0, abs=0.01)


def test_the_peers_loop_shows_its_cameras(seen):
    testing = pytest.importorskip("carla_driver_interface.testing", reason="needs the package carla-driver-interface")
    cameras = tuple(testing.FakeCamera(name, width=64, height=48, fov_deg=90) for name in (FRONT_WIDE, CROSS_LEFT))
    with serving(DriverService(Looking, limits=HERE)) as port:
        for image_format in ("jpeg", "png"):
            with testing.FakeLoop(
                f"127.0.0.1:{port}", cameras, initial_speed_mps=5.0, image_format=image_format
            ) as loop:
                assert loop.run(8).steps == 8
    assert len(seen) == 2 * 5  # the first three calls have too few frames
    sky = seen[0].images[1, -1, :, 0, 6]
    np.testing.assert_allclose(sky, (110, 160, 220), atol=4)


def test_sessions_side_by_side_are_as_alone():
    testing = pytest.importorskip("carla_driver_interface.testing", reason="needs the package carla-driver-interface")

    def run(port, offset):
        camera = testing.FakeCamera(width=32, height=18)
        with testing.FakeLoop(
            f"127.0.0.1:{port}", (camera,), initial_speed_mps=8.0, initial_lateral_offset_m=offset
        ) as loop:
            return loop.run(15).lateral_offsets_m

    offsets = [0.5, -0.5, 1.0, -1.0]
    with serving(DriverService("route")) as port:
        alone = [run(port, offset) for offset in offsets]
        together = {}
        threads = [
            threading.Thread(target=lambda offset=offset: together.update({offset: run(port, offset)}))
            for offset in offsets
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    for offset, way in zip(offsets, alone, strict=True):
        np.testing.assert_array_equal(together[offset], way)


METHODS = [method.name for method in contract.EGODRIVER.methods]
NUMBERS = st.one_of(
    st.floats(width=32),
    st.sampled_from([0.0, 1.0, NAN, np.inf, 1e30]),
)
TIMES = st.one_of(st.integers(0, 2**64 - 1), st.sampled_from([0, 1, STEP_US, 2**62, 2**63, 2**64 - 1]))


@pytest.fixture(scope="module")
def looking_client():
    with serving(DriverService(Looking, limits=HERE)) as port:
        client = Client(port)
        client.start((FRONT_WIDE, CROSS_LEFT))
        client.egomotion([0, STEP_US], np.repeat(planar_pose(0.0, 0.0, 0.0)[None], 2, axis=0))
        yield client
        client.channel.close()


def is_answered(client, method, request):
    """Whatever bytes come, the call is answered by a status that is none of a crash, and the next one by its answer."""
    call_with_bytes(client.channel, f"/egodriver.EgodriverService/{method}", request)
    assert client.stub.get_version(contract.Empty()).version_id.startswith("looking")


@settings(max_examples=150, deadline=None)
@given(method=st.sampled_from(METHODS), request=st.binary(max_size=200))
def test_any_bytes_are_answered(looking_client, method, request):
    is_answered(looking_client, method, request)


@settings(max_examples=150, deadline=None)
@given(data=st.data(), times=st.lists(TIMES, min_size=1, max_size=4), values=st.lists(NUMBERS, min_size=7, max_size=7))
def test_any_numbers_are_answered(looking_client, data, times, values):
    method = data.draw(st.sampled_from(METHODS))
    if method in ("start_session", "close_session", "get_version"):
        method = "drive"
    request = looking_message(method, times, values)
    whole = request.SerializeToString()
    cut = data.draw(st.integers(0, len(whole)))
    flipped = bytearray(whole)
    flipped[data.draw(st.integers(0, len(whole) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    for content in (whole, whole[:cut], bytes(flipped)):
        is_answered(looking_client, method, content)


def looking_message(method, times, values):
    pose = write_pose(np.eye(4))
    (pose.vec.x, pose.vec.y, pose.vec.z), quaternion = values[:3], values[3:]
    if not np.isnan(values[0]):
        pose.quat.w, pose.quat.x, pose.quat.y, pose.quat.z = quaternion
    if method == "drive":
        return contract.DriveRequest(session_uuid="a", time_now_us=times[0], time_query_us=times[-1])
    if method == "submit_image_observation":
        request = contract.RolloutCameraImage(session_uuid="a")
        request.camera_image.logical_id = FRONT_WIDE
        request.camera_image.frame_start_us, request.camera_image.frame_end_us = times[0], times[-1]
        request.camera_image.image_bytes = encode_image(np.zeros((3, 4, 4), np.uint8), "png")
        return request
    if method == "submit_route":
        request = contract.RouteRequest(session_uuid="a")
        request.route.timestamp_us = times[0]
        request.route.waypoints.add(x=values[0], y=values[1], z=values[2])
        return request
    if method == "submit_recording_ground_truth":
        return contract.DriveRequest(session_uuid="a", time_now_us=times[0])
    request = contract.RolloutEgoTrajectory(session_uuid="a")
    for time_us in times:
        entry = request.trajectory.poses.add(timestamp_us=time_us)
        entry.pose.CopyFrom(pose)
    return request
