"""The gate tells scenes on which scores mean something from those on which they do not."""

from dataclasses import replace

import numpy as np
import pytest

from olt_closed_loop.evaluation.gate import check_gate
from olt_closed_loop.scenes.procedural import CATEGORIES, generate_scene
from olt_closed_loop.simulation.settings import SimulationSettings
from olt_generator.errors import InputError
from olt_generator.poses import planar_pose
from olt_generator.trajectory import Trajectory


def holds(scene, settings=None):
    return [check.passed for check in check_gate(scene, settings).checks]


@pytest.mark.parametrize("category", CATEGORIES)
def test_it_holds_on_invented_scenes(category):
    assert holds(generate_scene(category, 3)) == [True] * 5


def test_it_holds_wherever_the_scene_lies(straight_scene, moved_scene):
    for place in ((0.0, 0.0, 0.0), (5e6, -5e6, 2.5)):
        assert holds(moved_scene(straight_scene(), *place)) == [True] * 5


def test_it_names_what_the_recording_hits_and_when(straight_scene, moving_agent):
    result = check_gate(straight_scene((moving_agent("van", (50.0, 0.0)),)))
    assert not result.passed
    assert [check.name for check in result.failed] == ["replay scores 1"]
    assert "front contact with automobile van at 4.37 s, collision_at_fault" in result.failed[0].finding


def test_it_names_where_the_recording_leaves_the_road(straight_scene):
    narrow = replace(straight_scene(), drivable=(np.array([[-40.0, -5, 0], [50, -5, 0], [50, 8, 0], [-40, 8, 0]]),))
    result = check_gate(narrow)
    assert [check.name for check in result.failed] == ["replay scores 1"]
    assert "off the road at 4.5" in result.failed[0].finding


def test_what_cannot_be_asked_of_a_standing_recording_is_not(straight_scene):
    assert holds(straight_scene(speed=0.2)) == [True, None, None, True, True]


def test_it_looks_at_the_drive_that_is_asked_for(straight_scene, moving_agent):
    scene = straight_scene((moving_agent("van", (50.0, 0.0)),))
    assert holds(scene, SimulationSettings(duration_us=4_000_000))[0]


def test_a_recording_that_ends_in_the_warm_up_is_refused(straight_scene):
    with pytest.raises(InputError, match="nothing after the warm-up"):
        check_gate(straight_scene(duration=1.5))


def test_the_gate_passes_where_drives_get_what_they_are_worth(straight_scene):
    result = check_gate(straight_scene())
    assert result.passed
    assert [check.passed for check in result.checks] == [True] * 5


def test_the_gate_fails_where_the_recording_itself_collides(straight_scene, moving_agent):
    result = check_gate(straight_scene((moving_agent("in the way", (50.0, 0.0)),)))
    assert not result.passed
    assert result.to_dict()["checks"][0]["passed"] is False


def test_the_gate_does_not_ask_what_a_scene_cannot_answer(straight_scene):
    scene = straight_scene()
    still = replace(scene, ego=Trajectory(scene.ego.timestamps_us, planar_pose(np.zeros(81), 0.0, 0.0)))
    assert [check.passed for check in check_gate(still).checks] == [True, None, None, True, True]
