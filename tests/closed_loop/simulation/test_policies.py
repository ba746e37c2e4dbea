from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_closed_loop.simulation.policies import (
    ConstantSpeedPolicy,
    ConstantVelocityPolicy,
    ObservationBatch,
    RouteFollowingPolicy,
    StandingPolicy,
    load_constant_speed,
    load_constant_velocity,
    load_route,
    load_standing,
    make_policy,
)
from olt_generator.errors import InputError
from olt_generator.poses import planar_pose, yaw_of
from olt_toolkit.policy.contract import Observation


def make_observation(speed=10.0, route=None, time_us=1_700_000):
    history = np.zeros((16, 3))
    history[:, 0] = speed * 0.1 * np.arange(-15, 1)
    return Observation(
        images=None,
        camera_indices=np.zeros(0, dtype=np.int64),
        history_xyz=history,
        history_rotation=np.tile(np.eye(3), (16, 1, 1)),
        route_xy=np.zeros((0, 2)) if route is None else np.asarray(route, dtype=np.float64),
        time_us=time_us,
        seed=0,
    )


def test_constant_velocity_goes_straight_on():
    plan = ConstantVelocityPolicy().plan(make_observation(speed=12.0))
    np.testing.assert_allclose(plan.xyz[:, 0], 1.2 * np.arange(1, 65))
    np.testing.assert_array_equal(plan.xyz[:, 1:], 0.0)


def test_standing_brakes_to_a_stop_and_stays():
    plan = StandingPolicy().plan(make_observation(speed=8.0))
    assert plan.xyz[-1, 0] == pytest.approx(8.0)
    np.testing.assert_allclose(plan.xyz[20:, 0], 8.0)
    assert np.all(np.diff(plan.xyz[:, 0]) >= -1e-12)


@settings(max_examples=30)
@given(radius=st.floats(15.0, 500.0), side=st.sampled_from([-1.0, 1.0]), speed=st.floats(1.0, 12.0))
def test_route_following_stays_on_a_curved_route_at_its_speed(radius, side, speed):
    angle = np.arange(20) * 80.0 / 19.0 / radius
    route = np.stack([radius * np.sin(angle), side * radius * (1.0 - np.cos(angle))], axis=-1)
    plan = RouteFollowingPolicy().plan(make_observation(speed, route))
    chord_sag = (80.0 / 19.0) ** 2 / (8.0 * radius)
    off_route = np.abs(np.linalg.norm(plan.xyz[:, :2] - [0.0, side * radius], axis=1) - radius)
    assert off_route.max() <= chord_sag + 1e-6
    assert np.linalg.norm(np.diff(plan.xyz, axis=0), axis=1).max() <= 0.1 * speed + 1e-9
    assert np.all(side * np.diff(np.unwrap(yaw_of(plan.rotation))) >= -1e-9)


def test_route_following_starts_where_it_is_and_returns_to_the_route():
    route = np.stack([np.arange(20) * 4.21, np.full(20, 2.0)], axis=-1)
    plan = RouteFollowingPolicy().plan(make_observation(10.0, route))
    assert abs(plan.xyz[0, 1]) < 0.3
    assert plan.xyz[-1, 1] == pytest.approx(2.0, abs=0.01)


@given(speed=st.floats(0.5, 30.0), turn=st.floats(-0.5, 0.5))
def test_constant_speed_goes_on_along_the_circle_that_it_came_on(speed, turn):
    times = 0.1 * np.arange(-15, 65)
    angles = turn * times
    places = np.stack([np.sinc(angles / np.pi) * times, np.sinc(angles / 2 / np.pi) * np.sin(angles / 2) * times], -1)
    poses = planar_pose(speed * places[:, 0], speed * places[:, 1], angles)
    seen = make_observation(speed)
    seen = replace(seen, history_xyz=poses[:16, :3, 3], history_rotation=poses[:16, :3, :3])
    plan = ConstantSpeedPolicy().plan(seen)
    # The speed is read off three poses, which a curve makes a little shorter.
    np.testing.assert_allclose(plan.xyz, poses[16:, :3, 3], atol=0.02 * speed)
    np.testing.assert_allclose(plan.rotation, poses[16:, :3, :3], atol=1e-9)


def test_route_following_needs_a_route():
    with pytest.raises(InputError, match="no route"):
        RouteFollowingPolicy().plan(make_observation())


@settings(max_examples=20)
@given(
    speeds=st.lists(st.floats(0.0, 40.0), min_size=2, max_size=5),
    lengths=st.lists(st.integers(2, 20), min_size=5, max_size=5),
)
@pytest.mark.parametrize(
    "policy", [ConstantSpeedPolicy(), ConstantVelocityPolicy(), StandingPolicy(), RouteFollowingPolicy()]
)
def test_each_row_of_a_batch_is_answered_as_alone(policy, speeds, lengths):
    rows = []
    for speed, length in zip(speeds, lengths, strict=False):
        route = np.full((20, 2), np.nan)
        route[:length] = np.stack([4.21 * np.arange(length), 0.1 * speed * np.sin(np.arange(length))], axis=-1)
        rows.append(ObservationBatch.of(make_observation(speed, route)))
    names = ("history_xyz", "history_rotation", "route_xy", "time_us", "seeds")
    together = policy.plan_batch(
        ObservationBatch(*(np.concatenate([getattr(row, name) for row in rows]) for name in names))
    )
    for index, row in enumerate(rows):
        alone = policy.plan_batch(row)
        np.testing.assert_array_equal(together.xyz[index], alone.xyz[0])
        np.testing.assert_array_equal(together.rotation[index], alone.rotation[0])


def test_replay_answers_with_the_recorded_future(straight_scene, replay_policy):
    plan = replay_policy(straight_scene(speed=7.0)).plan(make_observation(7.0))
    np.testing.assert_allclose(plan.xyz[:, 0], 0.7 * np.arange(1, 65), atol=1e-9)


def test_loaders_build_their_policies_and_take_no_argument():
    loaders = (load_constant_speed, load_constant_velocity, load_route, load_standing)
    assert [load(None).name for load in loaders] == [
        "constant_speed",
        "constant_velocity",
        "route",
        "standing",
    ]
    with pytest.raises(InputError, match="takes nothing"):
        load_route("somewhere")


def test_an_unknown_policy_is_refused():
    with pytest.raises(InputError, match="not known"):
        make_policy("teleport")
