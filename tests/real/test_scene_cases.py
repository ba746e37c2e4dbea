"""Each case of `cases/scenes` against its `expected.txt`, and a drive whose road is as narrow as the car."""

import numpy as np
import pytest

from olt_closed_loop.evaluation.evaluation import gate_scene, run_closed_loop
from olt_closed_loop.evaluation.gate import check_gate
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.scenes.sources import read_recording
from olt_closed_loop.scoring.definitions import score_rollout
from olt_closed_loop.simulation.closed_loop import replay
from olt_generator.errors import InputError

PATH = 236.93


@pytest.fixture
def case(shared_real):
    def path(name: str):
        found = shared_real.parent / "cases" / "scenes" / name / "scene.json.gz"
        if not found.is_file():
            pytest.skip(f"{found} is not there")
        return found

    return path


def replay_score(scene: Scene):
    return score_rollout(scene, replay(scene))


def test_an_agent_that_is_away_is_not_there(case):
    scene = read_recording(case("agent_gap"))
    gone = [agent for agent in scene.agents if agent.id.startswith("gone")]
    assert [agent.id for agent in gone] == ["gone", "gone#2"]
    assert not any(np.any((agent.timestamps_us > 2_100_000) & (agent.timestamps_us < 17_900_000)) for agent in gone)
    score = replay_score(scene)
    assert score.score == 1.0 and not score.collided
    assert check_gate(scene).passed


def test_an_agent_that_is_nowhere_is_named_in_one_line(case):
    with pytest.raises(InputError, match=r"scene\.json\.gz: .*track \w+ is valid at 0\.00 s, where .* nan") as caught:
        read_recording(case("agent_nan"))
    assert "\n" not in str(caught.value)


def test_steps_without_the_ego_are_no_poses(case):
    scene = read_recording(case("ego_not_valid"))
    assert scene.ego.path_length == pytest.approx(PATH, abs=0.05)
    assert any("3 of 196 steps of the ego" in text for text in scene.assumptions)
    assert check_gate(scene).passed


def test_without_a_map_the_road_is_not_measured(case):
    scene = read_recording(case("no_map"))
    assert scene.lanes == () and scene.drivable == ()
    score = replay_score(scene)
    assert score.score == 1.0 and score.offroad is None


def test_a_bad_case_loses_itself_only(case):
    sources = [str(case("agent_nan")), str(case("agent_gap"))]
    assert [gate_scene(source)[1].passed for source in sources] == [False, True]
    results = run_closed_loop(sources, "constant_velocity", rollouts=1)
    assert [score.valid for _, score in results] == [False, True]
