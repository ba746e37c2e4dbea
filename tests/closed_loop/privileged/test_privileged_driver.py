"""Who sees everything drives the scenes of the training generator too, and refuses what it cannot know."""

from dataclasses import replace

import numpy as np
import pytest

from olt_closed_loop import run_closed_loop
from olt_closed_loop.privileged.driver import PrivilegedDriver
from olt_closed_loop.scenes.procedural import CATEGORIES, generate_scene
from olt_closed_loop.scoring.definitions import score_rollout
from olt_closed_loop.simulation.closed_loop import simulate
from olt_closed_loop.simulation.policies import make_policy
from olt_closed_loop.simulation.settings import SimulationSettings
from olt_generator.errors import InputError


@pytest.mark.parametrize("category", CATEGORIES)
def test_it_drives_scenes_of_other_generators(category):
    scene = generate_scene(category, 3)
    score = score_rollout(scene, simulate(scene, PrivilegedDriver(scene)))
    assert score.score == 1.0 and not score.collided


def test_it_is_a_policy_by_name_and_the_same_at_any_number_of_workers():
    sources = ["work_zone:1", "animal:2"]
    (one, *_), two = (run_closed_loop(sources, "privileged", 1, workers=workers) for workers in (1, 2))
    assert one[1].score == 1.0 and one[0].policy == "privileged"
    assert np.array_equal(one[0].states, two[0][0].states)


def test_it_drives_with_planner_delay():
    scene = generate_scene("work_zone", 1)
    rollout = simulate(scene, PrivilegedDriver(scene), SimulationSettings(planner_delay_us=200_000))
    assert score_rollout(scene, rollout).score == 1.0


def test_without_a_scene_or_a_route_it_refuses():
    with pytest.raises(InputError, match="must know the scene"):
        make_policy("privileged").reset(0, "somewhere")
    scene = replace(generate_scene("nominal", 0), route=np.zeros((0, 3)))
    with pytest.raises(InputError, match="no route"):
        PrivilegedDriver(scene)
