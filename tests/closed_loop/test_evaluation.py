import json
from dataclasses import replace
from importlib.metadata import EntryPoint

import pytest
from typer.testing import CliRunner

from olt_closed_loop import policies
from olt_closed_loop.commands import app
from olt_closed_loop.evaluation import load_scene, pass_gate, run_closed_loop, save_results
from olt_closed_loop.rollout import load_rollouts
from olt_closed_loop.simulation import SimulationSettings
from olt_generator.errors import InputError

SHORT = SimulationSettings(duration_us=4_000_000)


def without_timings(results):
    return [(replace(rollout, timings={}).to_dict(), score) for rollout, score in results]


def test_every_scene_is_driven_with_every_seed(straight_scene):
    scenes = [straight_scene(), replace(straight_scene(category="work_zone"), name="other")]
    shares = []
    results = run_closed_loop(scenes, "route", rollouts=2, seed=5, settings=SHORT, on_progress=shares.append)
    assert [(r.scene, r.seed, s.score) for r, s in results] == [
        ("straight", 5, 1.0),
        ("straight", 6, 1.0),
        ("other", 5, 1.0),
        ("other", 6, 1.0),
    ]
    assert shares == [0.25, 0.5, 0.75, 1.0]


@pytest.mark.slow
def test_results_do_not_depend_on_the_number_of_workers(straight_scene):
    scenes = [straight_scene()]
    alone = run_closed_loop(scenes, "constant_velocity", settings=SHORT, workers=1)
    together = run_closed_loop(scenes, "constant_velocity", settings=SHORT, workers=2)
    assert without_timings(alone) == without_timings(together)


def test_results_are_written_whole(straight_scene, tmp_path):
    results = run_closed_loop([straight_scene()], "standing", settings=SHORT)
    save_results(tmp_path / "out", results)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["rollouts.json", "scores.json"]
    assert [rollout.seed for rollout in load_rollouts(tmp_path / "out" / "rollouts.json")] == [0, 1]
    report = json.loads((tmp_path / "out" / "scores.json").read_text())
    assert report["table"]["rows"][-1]["rollouts"] == 2
    assert [score["valid"] for score in report["scores"]] == [True, True]


@pytest.mark.parametrize("source", ["nothing", "cyclists:one", "cyclists:-1"])
def test_unusable_scene_names_are_refused(source):
    with pytest.raises(InputError, match="CATEGORY:SEED"):
        load_scene(source)


def test_at_least_one_rollout_is_asked_for(straight_scene):
    with pytest.raises(InputError, match="1 or more"):
        run_closed_loop([straight_scene()], "route", rollouts=0)


def test_no_scene_is_scored_where_the_recording_itself_collides(straight_scene, moving_agent):
    blocked = replace(straight_scene((moving_agent("in the way", (50.0, 0.0)),)), name="blocked")
    assert [result.scene for result in pass_gate([straight_scene()])] == ["straight"]
    with pytest.raises(InputError, match=r"gate fails on scene blocked \(replay scores 1: score 0\.0000"):
        pass_gate([straight_scene(), blocked])


def test_the_command_prints_a_table_and_writes_files(tmp_path):
    arguments = ["run", "--scene", "nominal:0", "--policy", "route", "--rollouts", "1", "--workers", "1", "--json"]
    result = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    printed = json.loads(result.stdout)
    assert printed["table"]["rows"][-1]["category"] == "overall"
    assert (tmp_path / "scores.json").is_file()


class _Broken:
    name, cameras, image_size = "broken", (), (0, 0)

    def plan(self, observation):
        raise RuntimeError("out of order")


def test_the_command_fails_when_a_rollout_is_not_valid(monkeypatch):
    entry = EntryPoint("broken", "nowhere:broken", "olt.policies")
    monkeypatch.setattr(EntryPoint, "load", lambda self: lambda argument: _Broken())
    monkeypatch.setattr(policies, "entry_points", lambda group: [entry])
    result = CliRunner().invoke(app, ["run", "--scene", "nominal:0", "--policy", "broken", "--workers", "1"])
    assert result.exit_code == 1
    assert "not valid: the policy raised RuntimeError" in result.stdout
