"""Drivers behind `grpc://` drive our scenes; what they do wrong is the named event of their rollout."""

import io
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from olt_closed_loop.control.plans import PlanRefused
from olt_closed_loop.drivers.addresses import DriverAddress
from olt_closed_loop.drivers.conversions import read_pose, read_trajectory, write_trajectory
from olt_closed_loop.drivers.driver_service import DriverService
from olt_closed_loop.drivers.observations import read_plan
from olt_closed_loop.drivers.remote_driver import RemoteDriver
from olt_closed_loop.drivers.server import serving
from olt_closed_loop.evaluation.evaluation import run_closed_loop
from olt_closed_loop.sensors.ray_casting import rig_sensors
from olt_closed_loop.simulation.closed_loop import simulate
from olt_closed_loop.simulation.policy_hosts import PolicyLimits
from olt_closed_loop.simulation.policy_process import PolicyNotStarted
from olt_closed_loop.simulation.settings import SimulationSettings
from olt_closed_loop.vehicle.state import STATE
from olt_generator.errors import InputError
from olt_generator.poses import invert, planar_pose
from olt_toolkit.rigs.rig import CROSS_LEFT, FRONT_WIDE, POLICY_CAMERAS
from olt_toolkit.rigs.rig_files import pav_rig

from .peers import (
    STEP_US,
    SteadyDriver,
    answer_in_the_rig,
    be_slow,
    delay,
    driver_at,
    forget_rotation,
    go_back,
    go_beside,
    hang,
    keep_poses,
    put,
    raise_error,
    reverse_times,
    set_time,
    shift_times,
    terminate,
)

SHORT = SimulationSettings(duration_us=4_000_000)
HASTY = replace(SHORT, limits=PolicyLimits(call_seconds=0.4))
CALLS = 23  # from 1.7 s to 3.9 s


def test_a_driver_drives(straight_scene):
    driver = SteadyDriver()
    with driver_at(driver) as policy:
        rollout = simulate(straight_scene(), policy, SHORT, seed=7)
        assert rollout.failure is None
        assert rollout.policy == "steady"
        assert rollout.incidents.plans_asked == driver.calls == CALLS
        assert rollout.states[-1, STATE.speed] == pytest.approx(8.0, abs=0.1)
        assert abs(rollout.states[-1, STATE.y]) < 0.01
    (session,) = driver.sessions
    assert session.random_seed == 7
    assert session.debug_info.scene_id == "straight"
    assert driver.closed == [session.session_uuid]


def test_what_a_driver_is_told_of_the_ego(straight_scene):
    driver = SteadyDriver()
    with driver_at(driver) as policy:
        rollout = simulate(straight_scene(), policy, SHORT)
    times, poses = read_trajectory_of(driver.poses)
    assert times.tolist() == list(range(200_000, 4_000_000, STEP_US))  # 1.5 s before the first call, then each step
    world = planar_pose(rollout.states[:, 0], rollout.states[:, 1], rollout.states[:, 2])
    first = 17
    expected = invert(world[first]) @ world[2:40]
    np.testing.assert_allclose(poses, expected, atol=2e-5)
    speeds = np.array([state.linear_velocity.x for state in driver.states])
    np.testing.assert_allclose(speeds[:16], 10.0, atol=1e-3)
    np.testing.assert_allclose(speeds[20:], rollout.states[22:40, STATE.speed], atol=0.1)
    braking = min(state.linear_acceleration.x for state in driver.states)
    assert braking == pytest.approx(rollout.states[:, STATE.acceleration].min(), abs=0.6)
    route = driver.routes[0]
    assert route.timestamp_us == 1_700_000
    assert [point.y for point in route.waypoints] == pytest.approx([0.0] * 20)
    assert route.waypoints[19].x == pytest.approx(80.0, abs=1e-3)


def read_trajectory_of(entries):
    message = write_trajectory([], np.zeros((0, 4, 4)))
    message.poses.extend(entries)
    return read_trajectory(message, "told")


@pytest.mark.parametrize("coding", ["jpeg", "png"])
def test_what_a_driver_is_shown(straight_scene, coding):
    scene, driver, size = straight_scene(), SteadyDriver(), (40, 72)
    sensors, taken = rig_sensors(scene), {}

    def take(cameras, image_size, pose, time_us):
        taken[time_us] = sensors(cameras, image_size, pose, time_us)
        return taken[time_us]

    with driver_at(driver) as policy:
        policy = policy.replace("cameras=none", f"cameras={FRONT_WIDE},{CROSS_LEFT}&size=40x72&images={coding}")
        rollout = simulate(scene, policy, replace(SHORT, duration_us=2_000_000), renderer=take)
    assert rollout.failure is None
    assert [(frame.logical_id, frame.frame_end_us) for frame in driver.frames if frame.logical_id == FRONT_WIDE] == [
        (FRONT_WIDE, time_us) for time_us in range(1_400_000, 2_000_000, STEP_US)
    ]
    for frame in driver.frames:
        with Image.open(io.BytesIO(frame.image_bytes)) as image:
            assert image.format.lower() == coding
            seen = np.asarray(image, np.int64).transpose(2, 0, 1)
        shot = taken[frame.frame_end_us][(CROSS_LEFT, FRONT_WIDE).index(frame.logical_id)]
        assert np.abs(seen - shot).mean() < (1e-9 if coding == "png" else 6.0)
    told = {camera.logical_id: camera for camera in driver.sessions[0].rollout_spec.vehicle.available_cameras}
    assert list(told) == [CROSS_LEFT, FRONT_WIDE]
    mounted = pav_rig().fitted(size[1], size[0])[FRONT_WIDE]
    lens = told[FRONT_WIDE].intrinsics.ftheta_param
    assert (told[FRONT_WIDE].intrinsics.resolution_h, told[FRONT_WIDE].intrinsics.resolution_w) == size
    np.testing.assert_allclose(read_pose(told[FRONT_WIDE].rig_to_camera, "camera"), mounted.T_rig_camera, atol=1e-5)
    point = np.array([0.5, -0.2, 1.0])
    angle = np.arctan2(np.hypot(*point[:2]), point[2])
    radius = np.polyval(list(lens.angle_to_pixeldist_poly)[::-1], angle)
    direction = radius * point[:2] / np.hypot(*point[:2])
    cde = lens.linear_cde
    across = cde.linear_c * direction[0] + cde.linear_d * direction[1]
    down = cde.linear_e * direction[0] + direction[1]
    pixel, visible = mounted.camera.project(point[None])
    assert visible.all()
    np.testing.assert_allclose((lens.principal_point_x + across, lens.principal_point_y + down), pixel[0], atol=0.05)


BAD = {
    "hangs": (hang, "policy_timeouts", "no answer within 0.4 s"),
    "raises": (raise_error, "policy_errors", "answered with UNKNOWN"),
    "terminates": (terminate, "policy_exits", "asked to end the session"),
    "NaN": (put(np.nan), "plans_refused", "not finite"),
    "infinite": (put(1e300), "plans_refused", "not finite"),
    "jump": (put(1e6), "plans_refused", "m within 0.1 s"),
    "largest": (put(3e38), "plans_refused", "m within 0.1 s"),
    "too few points": (keep_poses(3), "plans_refused", "control looks 1 s ahead"),
    "one point": (keep_poses(1), "plans_refused", "control looks 1 s ahead"),
    "no point": (keep_poses(0), "plans_refused", "no poses"),
    "past": (
        lambda driver, response: shift_times(-1_900_000)(driver, keep_poses(20)(driver, response)),
        "plans_refused",
        "control looks 1 s ahead",
    ),
    "future": (shift_times(5_000_000), "plans_refused", "control looks 1 s ahead"),
    "late": (delay(2_000_000), "plans_refused", "control looks 1 s ahead"),
    "a time twice": (set_time(4, 3), "plans_refused", "do not increase"),
    "the last time twice": (set_time(-1, -2), "plans_refused", "do not increase"),
    "a time too late": (set_time(3, -1), "plans_refused", "do not increase"),
    "no times": (reverse_times, "plans_refused", "do not increase"),
    "no rotation": (forget_rotation, "plans_refused", "quaternion"),
    "no clock": (shift_times(2**63), "plans_refused", "below 2^62"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_driver_that_does_wrong_is_an_event_of_its_rollout(straight_scene, name):
    change, kind, words = BAD[name]
    driver = SteadyDriver(change, from_call=5)
    with driver_at(driver) as policy:
        limited = HASTY if name == "hangs" else SHORT
        rollouts = [rollout for rollout, _ in run_closed_loop([straight_scene()], policy, 2, settings=limited)]
    assert driver.closed == [session.session_uuid for session in driver.sessions]
    assert len(driver.sessions) == 2
    for rollout in rollouts:
        assert rollout.failure_kind == kind, rollout.failure
        assert words in rollout.failure
        assert getattr(rollout.incidents, kind) > 0
        assert rollout.incidents.plans_asked >= 5


@pytest.mark.parametrize("change", [go_back, go_beside, answer_in_the_rig])
def test_a_driver_that_plans_what_no_car_can_is_no_good_one(straight_scene, change):
    """Its plans are followed as far as the car goes; what that is worth, and that it was asked for, is told."""
    with driver_at(SteadyDriver(change)) as policy:
        ((rollout, score),) = run_closed_loop([straight_scene()], policy, 1, settings=SHORT)
    assert rollout.failure_kind == "plans_refused" or score.score < 0.7
    assert rollout.incidents.plans_out_of_reach + rollout.incidents.plans_refused > 0
    assert rollout.plan_deviation_max > 1.0
    if change is go_back:
        assert score.metrics["reversed_m"] > 0.5
    with driver_at(SteadyDriver()) as policy:
        assert simulate(straight_scene(), policy, SHORT).incidents.plans_out_of_reach == 0


def test_one_refused_answer_is_counted_and_the_last_plan_held(straight_scene):
    def once(driver, response):
        return keep_poses(0)(driver, response) if driver.calls == 9 else response

    with driver_at(SteadyDriver(once)) as policy:
        rollout = simulate(straight_scene(), policy, SHORT)
    assert rollout.failure is None
    assert (rollout.incidents.plans_refused, rollout.incidents.plans_asked) == (1, CALLS)


def test_a_slow_driver_within_its_time_drives_the_same(straight_scene):
    states = []
    for change in (be_slow, lambda driver, response: response):
        with driver_at(SteadyDriver(change)) as policy:
            states.append(simulate(straight_scene(), policy, replace(SHORT, duration_us=2_300_000)).states)
    np.testing.assert_array_equal(*states)


def test_a_driver_that_dies_ends_its_rollout_and_the_next_says_so(straight_scene):
    driver = SteadyDriver()
    with serving(driver) as port:
        remote = RemoteDriver(DriverAddress.parse(f"//127.0.0.1:{port}?cameras=none"), call_seconds=5.0)
        assert simulate(straight_scene(), remote, SHORT).failure is None
    gone = simulate(straight_scene(), remote, SHORT)
    remote.close()
    assert gone.failure_kind == "policy_deaths"
    assert "could not be reached" in gone.failure


def test_a_driver_that_is_not_there(straight_scene):
    limits = PolicyLimits(start_seconds=0.3)
    with serving(SteadyDriver()) as port:
        pass
    with pytest.raises(PolicyNotStarted, match="could not be reached at"):
        simulate(straight_scene(), f"grpc://127.0.0.1:{port}", replace(SHORT, limits=limits))
    ((rollout, _),) = run_closed_loop(
        [straight_scene()], f"grpc://127.0.0.1:{port}", 1, settings=replace(SHORT, limits=limits)
    )
    assert rollout.failure_kind == "policy_deaths"


def test_what_a_driver_tells_of_its_needs():
    class Told(SteadyDriver):
        def get_version(self, request, context):
            context.send_initial_metadata((("openlongtail-cameras", self.cameras), ("openlongtail-image-size", "8x9")))
            return super().get_version(request, context)

    driver = Told()
    driver.cameras = FRONT_WIDE
    with serving(driver) as port:
        remote = RemoteDriver(DriverAddress.parse(f"//127.0.0.1:{port}"))
        assert (remote.cameras, remote.image_size) == ((FRONT_WIDE,), (8, 9))
        remote.close()
        remote = RemoteDriver(DriverAddress.parse(f"//127.0.0.1:{port}?cameras=none&size=10x20"))
        assert (remote.cameras, remote.image_size) == ((), (10, 20))
        remote.close()
        driver.cameras = "../../etc"
        with pytest.raises(Exception, match="told what it needs in no known words"):
            print(RemoteDriver(DriverAddress.parse(f"//127.0.0.1:{port}")).name)
    with serving(SteadyDriver()) as port:
        remote = RemoteDriver(DriverAddress.parse(f"//127.0.0.1:{port}"))
        assert (remote.cameras, remote.image_size) == (POLICY_CAMERAS, (320, 576))
        remote.close()


@pytest.mark.parametrize(
    "text",
    ["", "//", "host:1", "//host", "//host:0", "//host:99999", "//host:1/path", "//u@host:1", "//h:1?size=0x3",
     "//h:1?size=9", "//h:1?cameras=front", "//h:1?images=gif", "//h:1?unknown=1", "//h:1?cameras="],
)  # fmt: skip
def test_no_address(text):
    with pytest.raises(InputError, match="policy grpc:"):
        DriverAddress.parse(text)


def test_an_address():
    given = DriverAddress.parse("//10.0.0.2:6789?cameras=alpamayo-2&size=1080x1900&images=png")
    assert given.target == "10.0.0.2:6789"
    assert (len(given.cameras), given.image_size, given.coding) == (6, (1080, 1900), "png")
    assert DriverAddress.parse("//[::1]:5") == DriverAddress("[::1]:5")


@settings(max_examples=60, deadline=None)
@given(
    step=st.sampled_from([50_000, 100_000, 250_000, 500_000]),
    first=st.integers(-3, 1),
    speed=st.floats(0.0, 30.0),
    yaw_rate=st.floats(-0.3, 0.3),
    turned=st.floats(-3.1, 3.1),
)
def test_a_plan_at_any_spacing_is_the_way_that_was_meant(step, first, speed, yaw_rate, turned):
    """Steady turns: chords of circles, told in a local frame in which the rig stands anywhere."""
    now_us = 5_000_000
    times = now_us + step * np.arange(first, 7_000_000 // step)
    T_local_rig = planar_pose(40.0, -7.0, turned)
    meant = T_local_rig @ circle((times - now_us) * 1e-6, speed, yaw_rate)
    plan = read_plan(write_trajectory(times.tolist(), meant), now_us, invert(T_local_rig))
    wanted = circle(0.1 * np.arange(1, 65), speed, yaw_rate)
    chord = speed * abs(yaw_rate) * (step * 1e-6) ** 2 / 8.0  # sagitta: between poses the way is straight
    assert np.abs(plan.xyz - wanted[:, :3, 3]).max() < 1e-4 + 1.01 * chord
    assert np.abs(plan.rotation - wanted[:, :3, :3]).max() < 1e-5


def circle(seconds, speed, yaw_rate):
    yaw = yaw_rate * seconds
    chord = speed * seconds * np.sinc(yaw / (2.0 * np.pi))
    return planar_pose(chord * np.cos(yaw / 2), chord * np.sin(yaw / 2), yaw)


def test_a_plan_that_ends_early_goes_on_as_it_ended():
    times = np.arange(1, 31) * STEP_US
    plan = read_plan(write_trajectory(times.tolist(), planar_pose(5e-6 * times, 0.0, 0.0)), 0, np.eye(4))
    np.testing.assert_allclose(plan.xyz[:, 0], 0.5 * np.arange(1, 65), atol=1e-4)
    with pytest.raises(PlanRefused, match="30 poses from 1\\.1 s"):
        read_plan(write_trajectory((times + 1_000_000).tolist(), planar_pose(5e-6 * times, 0.0, 0.0)), 0, np.eye(4))


@pytest.mark.parametrize("name", ["route_follower", "constant_speed"])
def test_the_peers_drivers_drive_our_scenes(straight_scene, name):
    server = pytest.importorskip("carla_driver_interface.server", reason="needs the package carla-driver-interface")
    from carla_driver_interface.policies import load_policy

    driver = load_policy(name, cruise_speed_mps=6.0)
    with server.serving(driver, port=0, host="127.0.0.1", mode="alpasim") as port:
        results = run_closed_loop(
            [straight_scene(), "cyclists:1"], f"grpc://127.0.0.1:{port}?cameras=none", 1, settings=SHORT
        )
    for rollout, score in results:
        assert rollout.failure is None
        assert rollout.policy.startswith(name)
        assert rollout.states[-1, STATE.speed] == pytest.approx(6.0, abs=0.6)
        assert score.score is not None


@pytest.mark.parametrize("spec", ["route", "constant_speed", "standing", "recorded:cyclists:1"])
def test_a_served_policy_drives_as_it_does_here(spec):
    with serving(DriverService(spec)) as port:
        ((far, _),) = run_closed_loop(["cyclists:1"], f"grpc://127.0.0.1:{port}", 1, settings=SHORT)
    ((near, _),) = run_closed_loop(["cyclists:1"], spec, 1, settings=SHORT)
    assert near.failure is None
    assert far.failure is None
    # The wire is float32.
    np.testing.assert_allclose(far.states[:, :3], near.states[:, :3], atol=1e-4)


EVENTS = {  # events of the suite by what the peer's drivers are shown
    "longtail/closed_lane": "none",
    "longtail/officer_overrules_light": "none",
    "longtail/riders_on_curve": "none",
    "longtail/tractor_ahead": FRONT_WIDE,
}


def drive_events_with_peer(name, events, duration_us):
    """Scores of the peer's driver on events of the suite, by event."""
    server = pytest.importorskip("carla_driver_interface.server", reason="needs the package carla-driver-interface")
    from carla_driver_interface.policies import load_policy

    scores, settings = {}, SimulationSettings(duration_us=duration_us)
    with server.serving(load_policy(name), port=0, host="127.0.0.1", mode="alpasim") as port:
        for event in events:
            policy = f"grpc://127.0.0.1:{port}?cameras={EVENTS[event]}&size=32x56"
            ((rollout, score),) = run_closed_loop([event], policy, 1, settings=settings)
            assert rollout.failure is None
            assert rollout.policy.startswith(name)
            assert rollout.incidents.plans_refused == 0
            if EVENTS[event] != "none":
                assert rollout.rendered_images == {EVENTS[event]: rollout.incidents.plans_asked + 3}
            scores[event] = score
    return scores


@pytest.mark.parametrize("name", ["route_follower", "constant_speed"])
def test_the_peers_drivers_drive_the_suite(name):
    scores = drive_events_with_peer(name, ["longtail/closed_lane", "longtail/tractor_ahead"], 4_000_000)
    assert all(score.score is not None for score in scores.values())


@pytest.mark.slow
@pytest.mark.parametrize(("name", "failed"), [("route_follower", 4), ("constant_speed", 3)])
def test_the_peers_drivers_fail_events_of_every_category(name, failed):
    """They look at nothing: neither officers nor cones nor riders."""
    scores = drive_events_with_peer(name, EVENTS, 20_000_000)
    categories = {score.category for score in scores.values()}
    assert categories == {"work_zone", "complex_intersection", "cyclists", "uncommon_vehicle"}
    assert sum(score.score == 0.0 for score in scores.values()) == failed
