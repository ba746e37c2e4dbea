import json
from dataclasses import replace

import numpy as np
import pytest

from olt_closed_loop.scoring.definitions import score_rollout
from olt_closed_loop.simulation.camera_faults import CameraFault
from olt_closed_loop.simulation.closed_loop import RolloutRequest, replay, simulate, simulate_batch, stand
from olt_closed_loop.simulation.policies import (
    ConstantVelocityPolicy,
    RouteFollowingPolicy,
    StandingPolicy,
)
from olt_closed_loop.simulation.settings import SimulationSettings
from olt_closed_loop.vehicle.state import STATE
from olt_generator.errors import InputError
from olt_generator.poses import planar_pose
from olt_generator.trajectory import Trajectory
from olt_toolkit.policy.contract import PlannedTrajectory
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE, FRONT_TELE, FRONT_WIDE


class Recorder:
    """Drives at constant velocity and keeps what it was shown; a subclass may change the answer."""

    name = "recorder"
    cameras: tuple[str, ...] = ()
    image_size = (4, 6)

    def __init__(self):
        self.observations = []

    def plan(self, observation):
        self.observations.append(observation)
        return self.answer(ConstantVelocityPolicy().plan(observation), len(self.observations))

    def answer(self, plan, _call):
        return plan


class Watcher(Recorder):
    cameras = (FRONT_WIDE, FRONT_TELE)


class CountingSensors:
    """Images whose value is the step at which they were taken."""

    def __init__(self):
        self.times = []

    def __call__(self, cameras, size, T_world_rig, time_us):
        self.times.append(time_us)
        return np.full((len(cameras), 3, *size), time_us // 100_000, dtype=np.uint8)


def test_the_recording_drives_first_then_the_policy(straight_scene):
    policy = Recorder()
    rollout = simulate(straight_scene(), policy)
    assert policy.observations[0].time_us == rollout.handover_us == 1_700_000
    assert len(policy.observations) == len(rollout.plans) == 63
    assert rollout.timestamps_us[-1] == 8_000_000
    assert np.isnan(rollout.controls[:17]).all() and np.isfinite(rollout.controls[17:]).all()


def test_history_and_route_are_in_the_rig_frame(straight_scene, moved_scene):
    policy = Recorder()
    simulate(moved_scene(straight_scene(), 300.0, -200.0, 2.5), policy)
    for observation in policy.observations:
        np.testing.assert_allclose(observation.history_xyz[:, 0], np.arange(-15, 1), atol=1e-6)
        np.testing.assert_allclose(observation.history_xyz[:, 1:], 0.0, atol=1e-6)
        np.testing.assert_allclose(observation.route_xy[:, 0], np.arange(20) * 80.0 / 19.0, atol=1e-6)
        np.testing.assert_allclose(observation.route_xy[:, 1], 0.0, atol=1e-6)


def test_history_before_the_recording_is_carried_back(straight_scene):
    policy = Recorder()
    simulate(straight_scene(), policy, SimulationSettings(warm_up_us=300_000))
    np.testing.assert_allclose(policy.observations[0].history_xyz[:, 0], np.arange(-15, 1), atol=1e-9)


def test_every_picture_is_taken_once_and_shown_four_times(straight_scene):
    policy, sensors = Watcher(), CountingSensors()
    rollout = simulate(straight_scene(), policy, SimulationSettings(duration_us=2_500_000), renderer=sensors)
    assert sensors.times == [100_000 * step for step in range(14, 25)]
    assert rollout.rendered_images == {FRONT_WIDE: 11, FRONT_TELE: 11}
    for observation in policy.observations:
        assert observation.images.shape == (2, 4, 3, 4, 6)
        steps = observation.time_us // 100_000 + np.arange(-3, 1)
        np.testing.assert_array_equal(observation.images[1, :, 0, 0, 0], steps)
        np.testing.assert_array_equal(observation.camera_indices, [1, 6])


def test_without_cameras_nothing_is_rendered(straight_scene):
    sensors = CountingSensors()
    with_sensors = simulate(straight_scene(), Recorder(), renderer=sensors)
    assert sensors.times == []
    assert with_sensors.rendered_images == {}
    assert any("rendering" in omission.what for omission in with_sensors.left_out)
    np.testing.assert_array_equal(with_sensors.states, simulate(straight_scene(), Recorder()).states)


def test_a_policy_with_cameras_needs_a_renderer(straight_scene):
    with pytest.raises(InputError, match="renderer"):
        simulate(straight_scene(), Watcher())


class Refused(Recorder):
    def answer(self, plan, call):
        return PlannedTrajectory(np.full_like(plan.xyz, np.nan), plan.rotation) if 5 <= call < 9 else plan


def test_unusable_plans_are_counted_and_the_last_one_is_held(straight_scene):
    rollout = simulate(straight_scene(), Refused())
    assert rollout.incidents.plans_refused == 4
    assert rollout.failure is None
    assert len(rollout.plans) == 63 - 4
    np.testing.assert_allclose(rollout.states[:, STATE.x], 0.001 * rollout.timestamps_us / 100, atol=1e-3)


class NeverUsable(Recorder):
    def answer(self, plan, call):
        return PlannedTrajectory(np.full_like(plan.xyz, np.inf), plan.rotation)


class Raising(Recorder):
    def answer(self, plan, call):
        if call == 10:
            raise InputError("no idea")
        return plan


@pytest.mark.parametrize(
    ("policy", "reason"), [(NeverUsable(), "first plan"), (Raising(), "InputError at 2.6 s: no idea")]
)
def test_a_policy_without_an_answer_has_no_score(straight_scene, policy, reason):
    scene = straight_scene()
    rollout = simulate(scene, policy)
    score = score_rollout(scene, rollout)
    assert reason in rollout.failure
    assert not score.valid
    assert score.score is None and score.progress is None and score.collided is None
    assert score.reason == rollout.failure


class Noisy(Recorder):
    def answer(self, plan, call):
        noise = np.random.default_rng(self.observations[-1].seed).normal(scale=0.2, size=plan.xyz.shape)
        return PlannedTrajectory(plan.xyz + noise, plan.rotation)


def test_the_seed_decides_everything(straight_scene):
    def drive(seed):
        return {**simulate(straight_scene(), Noisy(), seed=seed).to_dict(), "timings": None}

    assert json.dumps(drive(3)) == json.dumps(drive(3))
    assert drive(3)["states"] != drive(4)["states"]


def without_timings(rollout):
    return {**rollout.to_dict(), "timings": None}


@pytest.mark.parametrize("policy", [ConstantVelocityPolicy(), RouteFollowingPolicy(), StandingPolicy(), Noisy()])
def test_a_rollout_is_the_same_alone_and_in_any_batch(straight_scene, moved_scene, policy):
    short = curved_scene(straight_scene(duration=3.0))
    small = replace(DEFAULT_VEHICLE, wheelbase=2.5)
    far = replace(moved_scene(straight_scene(duration=4.0, speed=17.0), 5e6, -3e5, 2.0), vehicle=small)
    requests = [RolloutRequest(scene, seed) for seed, scene in enumerate([short, far, straight_scene(duration=3.5)])]
    together = simulate_batch(requests, policy)
    for request, rollout in zip(requests, together, strict=True):
        assert without_timings(rollout) == without_timings(simulate(request.scene, policy, seed=request.seed))
    assert [len(rollout.states) for rollout in together] == [31, 41, 36]


def test_a_drive_without_a_route_fails_alone(straight_scene):
    without = replace(straight_scene(), route=np.zeros((0, 3)))
    requests = [RolloutRequest(straight_scene()), RolloutRequest(without)]
    whole, failed = simulate_batch(requests, RouteFollowingPolicy())
    assert whole.failure is None and len(whole.states) == 81
    assert "no route ahead" in failed.failure and failed.incidents.policy_errors == 1


def test_leaving_out_the_route_changes_nothing(straight_scene):
    lean, full = (
        simulate(straight_scene(), ConstantVelocityPolicy(), SimulationSettings(skip=skip)) for skip in (True, False)
    )
    np.testing.assert_array_equal(lean.states, full.states)
    np.testing.assert_array_equal(lean.plans, full.plans)
    assert any("route" in omission.what for omission in lean.left_out)
    assert not any("route" in omission.what for omission in full.left_out)


class Braking(Recorder):
    """Goes on at constant velocity until it is asked at 3.0 s or later, and plans to stand where it is from then on."""

    def answer(self, plan, _call):
        late = self.observations[-1].time_us >= 3_000_000
        return PlannedTrajectory(np.zeros_like(plan.xyz), plan.rotation) if late else plan


@pytest.mark.parametrize("delay_us", [0, 100_000, 500_000, 1_400_000])
def test_a_plan_is_in_force_after_the_planner_delay(straight_scene, delay_us):
    policy = Braking()
    rollout = simulate(straight_scene(), policy, SimulationSettings(planner_delay_us=delay_us))
    assert policy.observations[0].time_us == 1_700_000 - delay_us
    assert policy.observations[-1].time_us == 7_900_000 - delay_us
    braked = rollout.controls[:, 1] < -1.0
    assert rollout.timestamps_us[np.argmax(braked)] == 3_000_000 + delay_us


def test_a_planner_delay_shifts_the_pictures_too(straight_scene):
    policy, sensors = Watcher(), CountingSensors()
    settings = SimulationSettings(duration_us=2_500_000, planner_delay_us=400_000)
    simulate(straight_scene(), policy, settings, renderer=sensors)
    assert sensors.times == [100_000 * step for step in range(10, 21)]
    assert policy.observations[0].images[0, :, 0, 0, 0].tolist() == [10, 11, 12, 13]


@pytest.mark.parametrize("delay_us", [-100_000, 50_000, 1_500_000])
def test_unusable_planner_delays_are_refused(delay_us):
    with pytest.raises(InputError, match="planner delay"):
        SimulationSettings(planner_delay_us=delay_us)


@pytest.mark.parametrize("method", ["auto", "rk4"])
def test_a_vehicle_with_tyres_follows_a_winding_road_too(straight_scene, method):
    scene = curved_scene(straight_scene())
    settings = SimulationSettings(vehicle="tyres", integrator=method)
    slipping, rolling = (simulate(scene, RouteFollowingPolicy(), s) for s in (settings, SimulationSettings()))
    apart = np.linalg.norm(slipping.states[:, :2] - rolling.states[:, :2], axis=1)
    assert slipping.states.shape == rolling.states.shape
    assert 1e-4 < apart.max() < 0.5
    requests = [RolloutRequest(scene), RolloutRequest(straight_scene(duration=3.0))]
    together = simulate_batch(requests, RouteFollowingPolicy(), settings)
    np.testing.assert_array_equal(together[0].states, slipping.states)
    assert any("tyre" in omission.what for omission in rolling.left_out)


IDM = SimulationSettings(traffic="idm")


def test_a_follower_brakes_for_an_ego_that_stops_where_the_recording_did_not(straight_scene, moving_agent):
    scene = straight_scene((moving_agent("follower", (-20.0, 0.0), (10.0, 0.0)),))
    recorded = simulate(scene, StandingPolicy())
    assert score_rollout(scene, recorded).collided
    reactive = simulate(scene, StandingPolicy(), IDM)
    assert reactive.traffic == "idm" and [agent.id for agent in reactive.reacted] == ["follower"]
    (follower,) = reactive.reacted
    np.testing.assert_array_equal(follower.timestamps_us, 100_000 * np.arange(81))
    steps = np.diff(follower.poses[:, 0])
    assert np.all(steps >= 0.0) and np.all(steps <= 1.0 + 1e-9)
    assert np.diff(steps).min() > -0.1 * 0.8 - 1e-9
    np.testing.assert_array_equal(follower.poses[:17], scene.agents[0].poses[:17])
    ego_rear = reactive.states[-1, STATE.x] + DEFAULT_VEHICLE.rear_axle_to_bbox_center - DEFAULT_VEHICLE.length / 2
    assert 0.5 < ego_rear - (follower.poses[-1, 0] + 2.25) < 4.0
    assert not score_rollout(reactive.driven_scene(scene), reactive).collided


def test_a_queue_stops_behind_its_first_car(straight_scene, moving_agent):
    queue = [moving_agent(f"car {i}", (-20.0 - 12.0 * i, 0.0), (10.0, 0.0), duration=14.0) for i in range(4)]
    rollout = simulate(straight_scene(tuple(queue), duration=14.0), StandingPolicy(), IDM)
    assert {agent.id for agent in rollout.reacted} == {"car 0", "car 1", "car 2", "car 3"}
    fronts = np.stack([agent.poses[-100:, 0] for agent in sorted(rollout.reacted, key=lambda agent: agent.id)])
    assert np.all(fronts[:-1] - fronts[1:] > 4.5)


def test_who_has_a_free_way_replays_the_recording(straight_scene, moving_agent):
    agents = (
        moving_agent("ahead", (40.0, 0.0), (10.0, 0.0)),
        moving_agent("beside", (-10.0, 3.5), (10.0, 0.0)),
        moving_agent("oncoming", (150.0, 5.0), (-10.0, 0.0), yaw=np.pi),
        moving_agent("parked", (30.0, -3.0)),
    )
    scene = straight_scene(agents)
    recorded, reactive = (simulate(scene, ConstantVelocityPolicy(), s) for s in (SimulationSettings(), IDM))
    assert reactive.reacted == () and reactive.driven_scene(scene).agents == agents
    np.testing.assert_array_equal(recorded.states, reactive.states)


def test_an_agent_at_the_end_of_its_way_stands_on(straight_scene, moving_agent):
    car = moving_agent("car", (-30.0, 3.5), (10.0, 0.0))
    arrived = replace(car, poses=car.poses[np.minimum(np.arange(81), 40)])
    rollout = simulate(straight_scene((arrived,)), StandingPolicy(), IDM)
    assert rollout.reacted == ()


def test_reactive_traffic_is_not_for_policies_with_cameras(straight_scene):
    with pytest.raises(InputError, match="reactive"):
        simulate(straight_scene(), Watcher(), IDM, renderer=CountingSensors())


def curved_scene(scene):
    """The scene with a winding recording and route of the same speed."""
    arc = 10.0 * scene.ego.times
    fine = np.arange(0.0, 300.0, 0.01)
    yaw = 0.5 * np.sin(fine / 20.0)
    x, y = (np.concatenate([[0.0], np.cumsum(0.01 * f(yaw))[:-1]]) for f in (np.cos, np.sin))
    poses = planar_pose(np.interp(arc, fine, x), np.interp(arc, fine, y), 0.5 * np.sin(arc / 20.0))
    route = np.stack([x, y, np.zeros_like(x)], axis=-1)[::100]
    return replace(scene, ego=Trajectory(scene.ego.timestamps_us, poses), route=route, drivable=())


@pytest.mark.parametrize(("follows", "off"), [("recording", 0.02), ("route", 0.4)])
def test_replay_and_route_following_stay_on_a_winding_road(straight_scene, replay_policy, follows, off):
    scene = curved_scene(straight_scene())
    rollout = simulate(scene, RouteFollowingPolicy() if follows == "route" else replay_policy(scene))
    nearest = np.linalg.norm(rollout.states[:, None, :2] - scene.route[None, :, :2], axis=-1).min(axis=1)
    recorded = replay(scene).states
    assert np.linalg.norm(rollout.states[-1, :2] - recorded[-1, :2]) < off
    assert nearest.max() < 0.75


def test_standing_policy_comes_to_rest(straight_scene):
    rollout = simulate(straight_scene(), StandingPolicy())
    assert rollout.states[-1, STATE.speed] < 1e-3
    # The recording's speed of 10 m/s at 17 m, taken off at 4 m/s^2 after the lag of the brakes.
    assert rollout.states[-1, STATE.x] == pytest.approx(17.0 + 12.5, abs=1.5)


def test_given_drives_replay_and_stand(straight_scene):
    scene = straight_scene()
    np.testing.assert_allclose(replay(scene).states[:, STATE.x], scene.ego.positions[:, 0])
    standing = stand(scene)
    np.testing.assert_array_equal(standing.states[17:, STATE.x], standing.states[17, STATE.x])


def test_a_recording_that_ends_in_the_warm_up_is_refused(straight_scene):
    with pytest.raises(InputError, match="nothing after the warm-up"):
        simulate(straight_scene(duration=1.5), Recorder())


@pytest.mark.parametrize("warm_up_us", [250_000, 200_000])
def test_unusable_warm_ups_are_refused(warm_up_us):
    with pytest.raises(InputError, match="warm-up"):
        SimulationSettings(warm_up_us=warm_up_us)


def test_pictures_that_no_plan_is_made_from_are_left_out_with_the_same_result(straight_scene):
    policies, rollouts, taken = [], [], []
    for skip in (True, False):
        sensors = CountingSensors()
        policies.append(Watcher())
        settings = SimulationSettings(plan_interval_us=1_000_000, skip=skip)
        rollouts.append(simulate(straight_scene(), policies[-1], settings, renderer=sensors))
        taken.append(len(sensors.times))
    for ours, full in zip(policies[0].observations, policies[1].observations, strict=True):
        assert np.array_equal(ours.images, full.images)
        assert ours.images[0, :, 0, 0, 0].tolist() == [ours.time_us // 100_000 - back for back in (3, 2, 1, 0)]
    assert np.array_equal(rollouts[0].states, rollouts[1].states)
    times = np.diff([observation.time_us for observation in policies[0].observations])
    assert set(times.tolist()) == {1_000_000} and len(rollouts[0].plans) == len(times) + 1
    (omission,) = (found for found in rollouts[0].left_out if found.what == "pictures between decisions")
    assert omission.count == taken[1] - taken[0] > 0


def test_plans_in_force_must_reach_beyond_the_next():
    for interval in (0, 50_000, 3_100_000):
        with pytest.raises(InputError, match="plans every"):
            SimulationSettings(plan_interval_us=interval)


def test_faults_of_cameras_are_counted_and_change_what_is_shown(straight_scene):
    fault = CameraFault("late", FRONT_WIDE, 0.2)
    settings = SimulationSettings(camera_faults=(fault,))
    policy = Watcher()
    rollout = simulate(straight_scene(), policy, settings, renderer=CountingSensors())
    steps = policy.observations[5].images[:, -1, 0, 0, 0]
    assert steps[1] - steps[0] == 2
    # The second picture is the first again; the first has nothing before it.
    assert rollout.camera_faults == {"late:camera_front_wide_120fov=0.2": rollout.rendered_images[FRONT_WIDE] - 1}
    assert rollout.conditions == "day, clear"
    blind = simulate(straight_scene(), Recorder(), settings)
    assert any(omission.what == "faults of cameras" for omission in blind.left_out)
    with pytest.raises(InputError, match="not camera_cross_left"):
        unseen = CameraFault("noise", "camera_cross_left_120fov", 3.0)
        simulate(straight_scene(), Watcher(), SimulationSettings(camera_faults=(unseen,)), renderer=CountingSensors())
