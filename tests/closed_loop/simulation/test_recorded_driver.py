"""A driver that wants to go where the recording went gets there, wherever the scene lies."""

import numpy as np
import pytest

from olt_closed_loop.evaluation.evaluation import run_closed_loop
from olt_closed_loop.scenes.procedural import generate_scene
from olt_closed_loop.simulation.closed_loop import replay, simulate
from olt_closed_loop.simulation.policies import make_policy
from olt_closed_loop.simulation.recorded_driver import RecordedDriver
from olt_closed_loop.simulation.settings import SimulationSettings
from olt_generator.errors import InputError
from olt_generator.poses import planar_pose
from olt_toolkit.policy.contract import Observation

SHORT = SimulationSettings(duration_us=4_000_000)


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


def test_it_may_be_asked_less_often(straight_scene):
    """Every 0.5 s, as AlpaSim asks in some of its settings: where it is does not depend on that."""
    scene = straight_scene(speed=10.0)
    driver = RecordedDriver(scene)
    for step in range(15, 70, 5):
        plan = driver.plan(observe(step))
        np.testing.assert_allclose(plan.xyz[:, 0], 10.0 * 0.1 * np.arange(1, 65), atol=1e-6)


@pytest.mark.parametrize(("steps", "words"), [((-1,), "asked at -100000 us"), ((81,), "recording is there from 0 us")])
def test_it_is_asked_within_its_recording(straight_scene, steps, words):
    driver = RecordedDriver(straight_scene(duration=8.0))
    with pytest.raises(InputError, match=words):
        for step in steps:
            driver.plan(observe(step))


@pytest.mark.parametrize("steps", [(20, 20), (20, 19), (20, 36)])
def test_it_refuses_calls_between_which_it_cannot_reckon(straight_scene, steps):
    driver = RecordedDriver(straight_scene())
    with pytest.raises(InputError, match="ask it in steps"):
        for step in steps:
            driver.plan(observe(step))


def observe(step):
    history = planar_pose(1.0 * np.arange(-15, 1), 0.0, 0.0)
    return Observation(
        images=None,
        camera_indices=np.zeros(0, dtype=np.int64),
        history_xyz=history[:, :3, 3],
        history_rotation=history[:, :3, :3],
        route_xy=np.zeros((0, 2)),
        time_us=100_000 * step,
        seed=0,
    )


def test_as_a_policy_it_drives_its_own_scene_only():
    ((rollout, score),) = run_closed_loop(["cyclists:1"], "recorded:cyclists:1", 1, settings=SHORT)
    assert rollout.failure is None
    assert score.score is not None
    ((rollout, _),) = run_closed_loop(["cyclists:2"], "recorded:cyclists:1", 1, settings=SHORT)
    assert rollout.failure_kind == "policy_errors"
    assert "it knows the scene" in rollout.failure


@pytest.mark.parametrize("name", ["recorded", "privileged"])
def test_policies_that_know_scenes_are_told_theirs_in_one_way(name):
    """By the simulation, or after the name where nobody tells them; the drive is the same."""
    told, given = (run_closed_loop(["cyclists:1"], spec, 1, settings=SHORT) for spec in (name, f"{name}:cyclists:1"))
    assert told[0][0].failure is None and told[0][0].policy == given[0][0].policy == name
    np.testing.assert_array_equal(told[0][0].states, given[0][0].states)
    served = make_policy(f"{name}:cyclists:1")
    assert served.plan(observe(17)).xyz.shape == (64, 3)
    with pytest.raises(InputError, match=f"must know the scene; give it as in {name}:"):
        make_policy(name).plan(observe(17))
