import numpy as np
import pytest

from olt_closed_loop.control.plans import PlanRefused, WorldPlan, place_plan
from olt_closed_loop.control.tracking import TrackingController
from olt_closed_loop.vehicle.integrators import VehicleStepper
from olt_closed_loop.vehicle.parameters import VehicleParameters
from olt_closed_loop.vehicle.state import STATE
from olt_generator.poses import planar_pose
from olt_toolkit.policy.contract import PlannedTrajectory
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

PARAMETERS = VehicleParameters.from_dimensions(DEFAULT_VEHICLE)


def make_reference(speed, yaw_rate, seconds=16.0):
    """A path of speed(t) and yaw_rate(t), by fine midpoint steps."""
    step = 1e-3
    time = np.arange(0.0, seconds, step)
    yaw = np.concatenate([[0.0], np.cumsum(yaw_rate(time + 0.5 * step) * step)])
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    moved = speed(time + 0.5 * step) * step
    x = np.concatenate([[0.0], np.cumsum(moved * np.cos(middle))])
    y = np.concatenate([[0.0], np.cumsum(moved * np.sin(middle))])
    return WorldPlan(1000 * np.arange(len(x), dtype=np.int64), np.stack([x, y, yaw], axis=-1))


def track(reference, speed, seconds=10.0, steering=0.0, offset=(0.0, 0.0, 0.0)):
    """States and controls of a vehicle that starts on the reference and is shown 5 s of it in every step."""
    controller, stepper = TrackingController(PARAMETERS), VehicleStepper(PARAMETERS)
    state = np.concatenate([reference.poses[0] + offset, [speed, steering, 0.0]])
    states, controls = [state], []
    for index in range(round(seconds * 10)):
        times = 100_000 * (index + np.arange(51, dtype=np.int64))
        controls.append(controller.control(state, WorldPlan(times, reference.at(times)), int(times[0])))
        state = stepper(state, controls[-1])
        states.append(state)
    return np.stack(states), np.stack(controls)


def distances(states, reference):
    times = 100_000 * np.arange(len(states), dtype=np.int64)
    return np.linalg.norm(states[:, :2] - reference.at(times)[:, :2], axis=1)


def constant(value):
    return lambda time: np.full_like(time, value)


@pytest.mark.parametrize(("speed", "radius"), [(7.7, 20.0), (12.2, 50.0), (15.0, 100.0), (40.0, 600.0)])
def test_a_circle_is_tracked_within_a_decimetre_and_then_a_centimetre(speed, radius):
    reference = make_reference(constant(speed), constant(speed / radius))
    states, _ = track(reference, speed, steering=np.arctan(PARAMETERS.wheelbase / radius))
    errors = distances(states, reference)
    assert errors.max() < 0.1
    assert errors[30:].max() < 0.01


@pytest.mark.parametrize("speed", [10.0, 20.0, 35.0])
def test_a_lane_change_is_tracked_within_a_centimetre(speed):
    amplitude = 3.5 * 2.0 * np.pi / (9.0 * speed)

    def yaw_rate(time):
        return np.where((time > 1.0) & (time < 4.0), amplitude * np.sin(2.0 * np.pi * (time - 1.0) / 3.0), 0.0)

    reference = make_reference(constant(speed), yaw_rate)
    assert 2.5 < reference.poses[-1, 1] < 4.5
    states, _ = track(reference, speed)
    assert distances(states, reference).max() < 0.01


def test_a_stop_ends_in_place_with_the_brake_held_and_the_steering_still():
    reference = make_reference(lambda time: np.maximum(8.0 - 2.0 * time, 0.0), constant(0.0))
    states, controls = track(reference, 8.0)
    assert distances(states, reference).max() < 0.15
    np.testing.assert_allclose(states[-1, :2], reference.poses[-1, :2], atol=0.05)
    assert np.all(controls[-30:, 1] < 0.0)
    assert np.ptp(controls[-50:, 0]) < 1e-3


def test_jitter_in_a_plan_to_stand_moves_nothing():
    controller = TrackingController(PARAMETERS)
    generator = np.random.default_rng(0)
    state = np.array([5.0, 3.0, 1.0, 0.0, 0.1, -2.0])
    for _ in range(20):
        poses = state[:3] + generator.normal(scale=(5e-4, 5e-4, 0.05), size=(65, 3))
        control = controller.control(state, WorldPlan(100_000 * np.arange(65, dtype=np.int64), poses), 0)
        assert control[0] == state[STATE.steering]
        assert control[1] < 0.0


def test_an_offset_is_driven_off():
    reference = make_reference(constant(15.0), constant(0.0))
    states, _ = track(reference, 15.0, offset=(0.0, 1.0, 0.05))
    assert distances(states, reference)[-1] < 0.02


def test_commands_stay_within_the_limits():
    reference = make_reference(constant(12.0), constant(0.0))
    _, controls = track(reference, 2.0, offset=(0.0, 6.0, 1.2), seconds=4.0)
    low, high = PARAMETERS.control_limits
    assert np.all((controls >= low) & (controls <= high))
    assert np.any(controls[:, 1] == high[1])


def test_far_coordinates_and_whole_turns_change_nothing():
    reference = make_reference(constant(10.0), constant(0.2))
    near, _ = track(reference, 10.0, seconds=3.0)
    shift = np.array([5e6, -5e6, 4.0 * np.pi])
    far, _ = track(WorldPlan(reference.timestamps_us, reference.poses + shift), 10.0, seconds=3.0)
    np.testing.assert_allclose(far[:, :3] - shift, near[:, :3], atol=1e-6)


def test_a_plan_is_placed_where_it_was_made():
    poses = planar_pose(np.arange(1.0, 65.0), np.zeros(64), np.zeros(64))
    placed = place_plan(PlannedTrajectory(poses[:, :3, 3], poses[:, :3, :3]), 100.0, 50.0, np.pi / 2, 2_000_000)
    np.testing.assert_allclose(placed.poses[0], [100.0, 50.0, np.pi / 2])
    np.testing.assert_allclose(placed.poses[-1], [100.0, 114.0, np.pi / 2])
    assert placed.timestamps_us[-1] == 2_000_000 + 6_400_000
    np.testing.assert_allclose(placed.at(np.array([60_000_000]))[0], placed.poses[-1])


@pytest.mark.parametrize(
    "plan",
    [
        PlannedTrajectory(np.full((64, 3), np.nan), np.tile(np.eye(3), (64, 1, 1))),
        PlannedTrajectory(np.zeros((64, 3)), np.full((64, 3, 3), np.inf)),
        PlannedTrajectory(np.zeros((50, 3)), np.tile(np.eye(3), (50, 1, 1))),
    ],
)
def test_unusable_plans_are_refused(plan):
    with pytest.raises(PlanRefused):
        place_plan(plan, 0.0, 0.0, 0.0, 0)
