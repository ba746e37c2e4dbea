"""Our vehicle and controller behind AlpaSim's service: as we drive them ourselves, at any spacing of calls."""

import grpc
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_closed_loop.control.plans import WorldPlan
from olt_closed_loop.control.tracking import TrackingController
from olt_closed_loop.drivers import contract
from olt_closed_loop.drivers.conversions import read_pose, write_pose, write_trajectory
from olt_closed_loop.drivers.driven_vehicle import DrivenVehicle
from olt_closed_loop.drivers.server import serving
from olt_closed_loop.drivers.vehicle_service import VehicleService
from olt_closed_loop.vehicle.integrators import VehicleStepper
from olt_closed_loop.vehicle.parameters import VehicleParameters, vehicle_with_tyres
from olt_generator.poses import invert, make_pose, planar_pose, yaw_of
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

from .peers import call_with_bytes

STEP_US = 100_000
KINDS = {
    "kinematic": VehicleParameters.from_dimensions(DEFAULT_VEHICLE),
    "tyres": vehicle_with_tyres(DEFAULT_VEHICLE),
}


class Simulator:
    """Drives a served vehicle along a reference, and plans from it in the rig as AlpaSim does."""

    def __init__(self, port, session="a"):
        self.channel = grpc.insecure_channel(f"127.0.0.1:{port}")
        self.stub, self.session = contract.Stub(self.channel, contract.VEHICLE), session
        self.stub.start_session(contract.VDCSessionRequest(session_uuid=session))

    def request(self, now_us, pose, plan_us, plan_rig, future_us, speed=0.0, interval_us=0, coerce=False):
        request = contract.RunRequest(
            session_uuid=self.session,
            future_time_us=future_us,
            pose_reporting_interval_us=interval_us,
            coerce_dynamic_state=coerce,
        )
        request.state.timestamp_us = now_us
        request.state.pose.CopyFrom(write_pose(pose))
        request.state.state.linear_velocity.x = speed
        request.planned_trajectory_in_rig.CopyFrom(write_trajectory(plan_us, plan_rig))
        return request

    def run(self, *arguments, **options):
        return self.stub.run_controller_and_vehicle(self.request(*arguments, **options))

    def follow(self, reference, seconds, speed, step_us=STEP_US, correct=lambda pose: pose):
        """Poses (n, 4, 4) at the ends of the steps of a drive along `reference` (seconds -> poses)."""
        pose, poses = correct(reference(np.zeros(1))[0]), []
        for now_us in range(0, round(seconds * 1e6), step_us):
            plan_us = now_us + STEP_US * np.arange(51)
            plan = invert(pose) @ reference(plan_us * 1e-6)
            plan[0] = np.eye(4)
            states = self.run(now_us, pose, plan_us.tolist(), plan, now_us + step_us, speed).states
            pose = correct(read_pose(states[-1].pose_local_to_rig, "pose"))
            poses.append(pose)
        return np.stack(poses)


@pytest.fixture(params=KINDS)
def served(request):
    with serving(VehicleService(lambda: DrivenVehicle(KINDS[request.param]), request.param)) as port:
        yield request.param, port


def circle(radius, speed, at=(0.0, 0.0)):
    def reference(seconds):
        turned = speed * seconds / radius
        return planar_pose(at[0] + radius * np.sin(turned), at[1] + radius * (1.0 - np.cos(turned)), turned)

    return reference


def distance(poses, others):
    return np.linalg.norm(poses[:, :3, 3] - others[:, :3, 3], axis=1)


@pytest.mark.parametrize("step_us", [STEP_US, 250_000, 500_000])
def test_it_follows_a_circle(served, step_us):
    reference = circle(50.0, 8.0)
    poses = Simulator(served[1]).follow(reference, 6.0, 8.0, step_us)
    times = step_us * 1e-6 * np.arange(1, len(poses) + 1)
    assert distance(poses, reference(times)).max() < 0.2


def test_it_is_the_vehicle_and_controller_that_we_drive_ourselves(served):
    kind, port = served
    reference = circle(30.0, 6.0)
    poses = Simulator(port).follow(reference, 3.0, 6.0)
    vehicle = KINDS[kind]
    controller, stepper = TrackingController(vehicle), VehicleStepper(vehicle)
    state, ours = np.zeros(vehicle.state_size), []
    state[3] = 6.0
    for step in range(30):
        times = STEP_US * np.arange(step, step + 51)
        plan = reference(times * 1e-6)
        planned = np.column_stack([plan[:, :2, 3], yaw_of(plan)])
        planned[0] = state[:3]
        state = stepper(state, controller.control(state, WorldPlan(times, planned), step * STEP_US))
        ours.append(planar_pose(*state[:3]))
    assert distance(poses, np.stack(ours)).max() < 1e-4  # the wire is float32


def test_far_away_and_on_a_slope_it_drives_the_same(served):
    _, port = served
    level = Simulator(port, "level").follow(circle(40.0, 7.0), 2.0, 7.0)
    pitch = 0.1
    tilt = make_pose([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]], [0, 0, 3.0])
    tilted = Simulator(port, "tilted").follow(lambda seconds: tilt @ circle(40.0, 7.0)(seconds), 2.0, 7.0)
    assert distance(tilt @ level, tilted).max() < 0.01
    assert np.abs(tilted[:, 2, 3]).max() > 0.5


def test_states_on_the_way_do_not_change_where_it_ends(served):
    _, port = served
    plan_us = STEP_US * np.arange(51)
    plan = circle(40.0, 7.0)(plan_us * 1e-6)
    once = Simulator(port, "once").run(0, np.eye(4), plan_us.tolist(), plan, 250_000, 7.0)
    often = Simulator(port, "often").run(0, np.eye(4), plan_us.tolist(), plan, 250_000, 7.0, interval_us=30_000)
    assert [state.timestamp_us for state in once.states] == [250_000]
    assert [state.timestamp_us for state in often.states] == [*range(30_000, 250_000, 30_000), 250_000]
    ends = [np.stack([read_pose(each.states[-1].pose_local_to_rig, "end")]) for each in (once, often)]
    assert distance(*ends).max() < 1e-5
    assert once.pose_local_to_rig.timestamp_us == 250_000
    assert once.pose_local_to_rig.pose == once.states[-1].pose_local_to_rig
    assert once.dynamic_state == once.states[-1].dynamic_state == once.states[-1].dynamic_state_estimated
    # Rates are those of the poses.
    poses = np.stack([read_pose(state.pose_local_to_rig, "pose") for state in often.states])
    velocities = np.linalg.norm(np.diff(poses[:-1, :3, 3], axis=0), axis=1) / 0.03
    told = [np.hypot(s.dynamic_state.linear_velocity.x, s.dynamic_state.linear_velocity.y) for s in often.states]
    np.testing.assert_allclose(velocities, told[1:-1], atol=0.05)
    turned = np.diff(yaw_of(poses[:-1])) / 0.03
    np.testing.assert_allclose(turned, [s.dynamic_state.angular_velocity.z for s in often.states[1:-1]], atol=0.06)


def test_rates_are_its_own_unless_they_are_taken_over(served):
    _, port = served
    simulator, plan_us = Simulator(port), STEP_US * np.arange(51)

    def run(step, speed, coerce):
        times = (step * STEP_US + plan_us).tolist()
        plan = planar_pose(8.0 * plan_us * 1e-6, 0.0, 0.0)
        return simulator.run(step * STEP_US, np.eye(4), times, plan, (step + 1) * STEP_US, speed, coerce=coerce)

    assert run(0, 8.0, False).dynamic_state.linear_velocity.x == pytest.approx(8.0, abs=0.1)
    assert run(1, 3.0, False).dynamic_state.linear_velocity.x == pytest.approx(8.0, abs=0.1)
    assert run(2, 3.0, True).dynamic_state.linear_velocity.x == pytest.approx(3.0, abs=0.7)


def test_it_backs_up_and_comes_to_a_stand(served):
    _, port = served

    def back_and_stop(seconds):
        return planar_pose(-np.minimum(seconds, 5.0) * 1.0, 0.0, 0.0)

    poses = Simulator(port).follow(back_and_stop, 8.0, 0.0, 200_000)
    assert poses[-1, 0, 3] == pytest.approx(-5.0, abs=0.5)
    assert np.abs(poses[-1, 0, 3] - poses[-2, 0, 3]) < 0.02


def code_of(call):
    with pytest.raises(grpc.RpcError) as raised:
        call()
    return raised.value.code()


def test_a_plan_that_comes_late_is_in_the_rig_as_it_stood_when_it_was_made(served):
    """As with a planner's delay: the same plan, told in the rig of an earlier time, is driven the same."""
    _, port = served
    reference, delay_us = circle(30.0, 8.0, at=(400.0, -70.0)), 250_000
    ends = {}
    for late in (False, True):
        simulator, pose = Simulator(port, f"late {late}"), reference(np.zeros(1))[0]
        way = {0: pose}
        for now_us in range(0, 2_000_000, STEP_US):
            made_us = max(now_us - delay_us, 0) if late else now_us
            plan_us = made_us + 50_000 * np.arange(100)
            made_at = way[made_us] if made_us in way else between(way, made_us)
            plan = invert(made_at) @ reference(plan_us * 1e-6)
            states = simulator.run(now_us, pose, plan_us.tolist(), plan, now_us + STEP_US, 8.0, 50_000).states
            for state in states:
                way[state.timestamp_us] = read_pose(state.pose_local_to_rig, "pose")
            pose = way[now_us + STEP_US]
        ends[late] = pose
    np.testing.assert_allclose(ends[True], ends[False], atol=2e-3)
    older = np.arange(11) * STEP_US
    stranger = Simulator(port, "stranger")
    assert code_of(lambda: stranger.run(500_000, pose, older.tolist(), planar_pose(older, 0.0, 0.0), 600_000)) == (
        grpc.StatusCode.INVALID_ARGUMENT
    )


def between(way, time_us):
    times = np.array(sorted(way))
    return Trajectory(times, np.stack([way[time] for time in times])).interpolate(np.array([time_us]))[0]


def test_requests_that_make_no_sense_are_refused_and_change_nothing(served):
    _, port = served
    simulator = Simulator(port)
    plan_us, plan = (STEP_US * np.arange(11)).tolist(), planar_pose(0.8 * np.arange(11), 0.0, 0.0)
    invalid, failed = grpc.StatusCode.INVALID_ARGUMENT, grpc.StatusCode.FAILED_PRECONDITION
    nan = planar_pose(np.full(11, np.nan), 0.0, 0.0)
    for code, arguments, options in [
        (invalid, (0, np.eye(4), plan_us, plan, 0), {}),
        (invalid, (0, np.eye(4), plan_us, plan, 61_000_000), {}),
        (invalid, (0, np.eye(4), plan_us, plan, STEP_US), {"interval_us": -1}),
        (invalid, (0, np.eye(4), plan_us, plan, 60_000_000), {"interval_us": 1}),
        (invalid, (0, np.eye(4), [], plan[:0], STEP_US), {}),
        (invalid, (0, np.eye(4), plan_us[1:], plan[1:], STEP_US), {}),
        (invalid, (0, np.eye(4), plan_us, nan, STEP_US), {}),
        (invalid, (0, np.eye(4), [0, *plan_us[:0:-1]], plan, STEP_US), {}),
        (invalid, (0, np.eye(4), plan_us, planar_pose(1e4 * np.arange(11), 0.0, 0.0), STEP_US), {}),
        (invalid, (0, np.eye(4), plan_us, plan, STEP_US), {"speed": 1e6}),
        (invalid, (0, np.eye(4), plan_us, plan, STEP_US), {"speed": float("nan")}),
    ]:
        assert code_of(lambda a=arguments, o=options: simulator.run(*a, **o)) == code
    simulator.run(0, np.eye(4), plan_us, plan, STEP_US, 8.0)
    assert code_of(lambda: simulator.run(0, np.eye(4), plan_us, plan, STEP_US, 8.0)) == failed
    given_rig = contract.VDCSessionRequest(session_uuid="b")
    given_rig.vehicle_and_controller_params.rig_file = "../../etc/passwd"
    assert code_of(lambda: simulator.stub.start_session(given_rig)) == failed
    assert code_of(lambda: Simulator(port)) == grpc.StatusCode.ALREADY_EXISTS
    assert code_of(lambda: Simulator(port, "")) == invalid
    simulator.stub.close_session(contract.VDCSessionCloseRequest(session_uuid="a"))
    assert code_of(lambda: simulator.run(0, np.eye(4), plan_us, plan, STEP_US)) == grpc.StatusCode.NOT_FOUND


@pytest.fixture(scope="module")
def vehicle_channel():
    with serving(VehicleService(lambda: DrivenVehicle(KINDS["tyres"]), "tyres")) as port:
        simulator = Simulator(port)
        yield simulator
        simulator.channel.close()


@settings(max_examples=150, deadline=None)
@given(
    method=st.sampled_from([method.name for method in contract.VEHICLE.methods]),
    flips=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 7)), max_size=4),
    cut=st.floats(0.5, 1.0),
    noise=st.binary(max_size=20),
)
def test_any_bytes_are_answered(vehicle_channel, method, flips, cut, noise):
    plan_us, plan = (STEP_US * np.arange(11)).tolist(), planar_pose(0.8 * np.arange(11), 0.0, 0.0)
    whole = bytearray(vehicle_channel.request(0, np.eye(4), plan_us, plan, STEP_US, 8.0).SerializeToString())
    for place, bit in flips:
        whole[int(place * len(whole))] ^= 1 << bit
    content = bytes(whole[: int(cut * len(whole))]) + noise
    if method == "close_session":
        content = noise
    call_with_bytes(vehicle_channel.channel, f"/controller.VDCService/{method}", content)
    assert vehicle_channel.stub.get_version(contract.Empty()).version_id.startswith("tyres")
