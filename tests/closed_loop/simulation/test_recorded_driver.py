"""A driver that wants to go where the recording went gets there, wherever the scene lies."""

import numpy as np
import pytest

from olt_closed_loop.scenes.procedural import generate_scene
from olt_closed_loop.simulation.closed_loop import replay, simulate
from olt_closed_loop.simulation.recorded_driver import RecordedDriver
from olt_closed_loop.simulation.settings import SimulationSettings


def deviations(scene, settings=None):
    """Distances (n,) between the driven and the recorded rig."""
    driven = simulate(scene, RecordedDriver(scene), settings)
    assert driven.failure is None and driven.incidents.plans_refused == 0
    return np.linalg.norm(driven.states[:, :2] - replay(scene, settings).states[:, :2], axis=1)


@pytest.mark.parametrize("delay_us", [0, 300_000])
def test_it_stays_on_the_recording(delay_us):
    settings = SimulationSettings(planner_delay_us=delay_us)
    assert deviations(generate_scene("work_zone", 1), settings).max() < 0.1


def test_it_reckons_its_place_however_far_from_the_origin(straight_scene, moved_scene):
    near, far = (deviations(moved_scene(straight_scene(), *place)) for place in ((0.0, 0.0, 0.0), (5e6, -5e6, 2.5)))
    np.testing.assert_allclose(far, near, atol=1e-3)


def test_its_plans_are_the_recorded_poses(straight_scene):
    scene = straight_scene(speed=10.0)
    rollout = simulate(scene, RecordedDriver(scene))
    for time_us, plan in zip(rollout.plan_times_us, rollout.plans, strict=True):
        ahead = plan[1:, 0] - 10.0 * (time_us * 1e-6 + 0.1 * np.arange(1, 65))
        np.testing.assert_allclose(ahead, 0.0, atol=1e-6)
