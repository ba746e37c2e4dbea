"""The route that samples hand on is the one that the closed loop shows."""

import numpy as np
import pytest

from olt_closed_loop.simulation.closed_loop import simulate
from olt_closed_loop.simulation.recorded_driver import RecordedDriver
from olt_closed_loop.suite.scenes import make_scene
from olt_toolkit.policy.route import routes_ahead


@pytest.mark.parametrize("name", ["curved_road", "free_right_turn", "roundabout_three_arms"])
def test_samples_and_rollouts_have_the_same_route(name):
    scene = make_scene(name)

    seen = []

    class Watching(RecordedDriver):
        def plan(self, observation):
            seen.append((observation.time_us, observation.route_xy))
            return super().plan(observation)

    rollout = simulate(scene, Watching(scene))
    first = rollout.handover_us // 100_000
    poses = rollout.states[first:, :3]
    times = [time for time, _ in seen]
    assert times == rollout.timestamps_us[first : first + len(times)].tolist()
    routes = routes_ahead(scene.route[:, :2], poses[: len(times)])
    np.testing.assert_array_equal(routes, np.stack([route for _, route in seen]))
