"""The gate tells scenes on which scores mean something from those on which they do not."""

from dataclasses import replace

import numpy as np
import pytest

from olt_closed_loop.control.tracking import ControlSettings
from olt_closed_loop.evaluation.gate import check_gate
from olt_closed_loop.scenes.procedural import CATEGORIES, generate_scene
from olt_closed_loop.scoring.definitions import DEFINITIONS
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


def road_of_width(scene, left, right):
    """The scene on a road from `right` to `left` of the ego's way, metres."""
    outline = np.array([[-40.0, right, 0], [250, right, 0], [250, left, 0], [-40, left, 0]])
    return replace(scene, drivable=(outline,), road_edges=())


@pytest.mark.parametrize(("room", "passes"), [(0.0, False), (0.02, False), (0.08, False), (0.15, True), (1.0, True)])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_road_without_room_for_a_good_driver_is_found(straight_scene, room, passes, side):
    half = 0.5 * straight_scene().vehicle.width
    borders = (half + room, -5.0) if side > 0 else (5.0, -half - room)
    result = check_gate(road_of_width(straight_scene(), *borders))
    assert result.passed is passes
    border = next(place for place in result.narrow if place.what == "the border of the road")
    assert border.metres == pytest.approx(room, abs=2e-3)
    if not passes:
        (check,) = result.failed
        assert check.name == "0.1 m aside score as replayed"
        assert f"m to the {'left' if side > 0 else 'right'}: score 0.0000" in check.finding
        assert "off the road at 1.70 s" in check.finding


def test_an_agent_beside_which_there_is_no_room_is_found(straight_scene, moving_agent):
    beside = moving_agent("van", (50.0, 0.5 * (straight_scene().vehicle.width + 2.0) + 0.05), size=(5.0, 2.0, 2.0))
    result = check_gate(straight_scene((beside,)))
    (check,) = result.failed
    assert "to the left: score 0.0000" in check.finding and "automobile van" in check.finding
    van = result.narrow[-1]
    assert van.what == "automobile van" and van.metres == pytest.approx(0.05, abs=1e-6)
    assert 40.0 < van.x < 60.0


def test_a_recording_that_no_car_can_follow_is_found(straight_scene, moving_agent):
    """The recorded ego stands, from one moment to the next, before something that is in its way."""
    scene = straight_scene((moving_agent("rock", (72.0, 0.0), size=(1.0, 5.0, 1.0)),), speed=20.0)
    x = np.minimum(scene.ego.positions[:, 0], 66.0)
    result = check_gate(replace(scene, ego=Trajectory(scene.ego.timestamps_us, planar_pose(x, 0.0, 0.0))))
    assert [check.passed for check in result.checks] == [True, True, None, False, True]
    assert "too fast to brake" in result.checks[2].finding
    assert any(
        why in result.checks[3].finding for why in ("contact with automobile rock", "plans in a row were refused")
    )


@pytest.mark.parametrize("vehicle", ["kinematic", "tyres"])
@pytest.mark.parametrize("method", ["lqr", "linear"])
def test_a_driver_along_the_recording_scores_as_the_replay(vehicle, method):
    settings = SimulationSettings(vehicle=vehicle, control=ControlSettings(method=method))
    assert holds(generate_scene("path_reassignment", 2), settings) == [True] * 5


@pytest.mark.parametrize("definition", DEFINITIONS)
def test_the_definition_that_is_used_is_gated(definition, straight_scene, moving_agent):
    result = check_gate(generate_scene("cyclists", 3), definition=definition)
    assert result.passed and result.definition == definition
    assert result.to_dict()["definition"] == definition
    assert not check_gate(straight_scene((moving_agent("van", (50.0, 0.0)),)), definition=definition).passed


def test_what_alpasim_cannot_measure_is_no_score(straight_scene):
    (definition, *_) = [name for name in DEFINITIONS if name.startswith("alpasim")]
    result = check_gate(straight_scene(with_road=False), definition=definition)
    assert not result.passed and "no scene score" in result.checks[0].finding


def test_agents_replay_the_recording_whatever_drives(straight_scene, moving_agent):
    follower = moving_agent("follower", (-20.0, 0.0), (10.0, 0.0))
    scene = straight_scene((follower,))
    assert check_gate(scene, SimulationSettings(traffic="idm")).to_dict() == check_gate(scene).to_dict()


def test_the_gate_does_not_depend_on_how_often_the_policy_plans():
    scene = generate_scene("work_zone", 1, 6_000_000)
    seldom = SimulationSettings(plan_interval_us=1_000_000)
    assert check_gate(scene, seldom).to_dict() == check_gate(scene).to_dict()
