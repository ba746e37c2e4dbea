import json
from dataclasses import replace
from types import SimpleNamespace
from typing import get_args

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from olt_closed_loop.commands import app, options
from olt_closed_loop.control.nonlinear import NonlinearSolver
from olt_closed_loop.control.tracking import ControlMethod, ControlSettings
from olt_closed_loop.evaluation import evaluation
from olt_closed_loop.evaluation.evaluation import (
    count_left_out,
    count_vehicle_steps,
    load_scene,
    pass_gate,
    run_closed_loop,
)
from olt_closed_loop.evaluation.gate import check_gate
from olt_closed_loop.evaluation.run_folder import save_results
from olt_closed_loop.evaluation.score_table import summarize_scores
from olt_closed_loop.rollouts.rollout import Traffic
from olt_closed_loop.rollouts.rollout_tables import load_rollouts
from olt_closed_loop.scenes.scene_file import write_scene
from olt_closed_loop.scoring.definitions import DefinitionName
from olt_closed_loop.simulation import policies
from olt_closed_loop.simulation.settings import SimulationSettings, VehicleKind
from olt_closed_loop.vehicle.integrators import Method
from olt_generator.errors import InputError
from olt_generator.omissions import Omission

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
    assert shares == [0.5, 1.0]


@pytest.mark.slow
def test_results_do_not_depend_on_the_number_of_workers(straight_scene):
    scenes = [straight_scene()]
    alone = run_closed_loop(scenes, "constant_velocity", settings=SHORT, workers=1)
    together = run_closed_loop(scenes, "constant_velocity", settings=SHORT, workers=2)
    assert without_timings(alone) == without_timings(together)


def test_everything_on_gives_the_same_numbers(straight_scene, moving_agent):
    agents = (moving_agent("far", (0.0, 300.0)), moving_agent("ahead", (60.0, 0.0), (9.0, 0.0)))
    scene = straight_scene(agents)
    for policy in ("constant_velocity", "standing", "route"):
        (lean, quick), (full, slow) = (
            run_closed_loop([scene], policy, 1, settings=replace(SHORT, skip=skip))[0] for skip in (True, False)
        )
        assert replace(lean, timings={}, left_out=()).to_dict() == replace(full, timings={}, left_out=()).to_dict()
        assert replace(quick, left_out=()) == replace(slow, left_out=())
        assert count_left_out([(lean, quick)])


def test_late_solves_reach_the_results_and_the_table(straight_scene, tmp_path):
    never_in_time = replace(SHORT, control=ControlSettings(deadline_seconds=0.0))
    results = run_closed_loop([straight_scene()], "route", rollouts=2, settings=never_in_time)
    steps = round((4.0 - 1.7) / 0.1)
    for rollout, score in results:
        assert rollout.incidents.solves_late == steps and score.rollout_incidents == vars(rollout.incidents)
    overall = summarize_scores([score for _, score in results]).overall
    assert (overall.rollout_incidents["solves_late"], overall.rollout_incidents["solves_failed"]) == (2 * steps, 0)
    save_results(tmp_path, results)
    report = json.loads((tmp_path / "scores.json").read_text())
    assert report["table"]["rows"][-1]["rollout_incidents"]["solves_late"] == 2 * steps
    assert [score["rollout_incidents"]["solves_late"] for score in report["scores"]] == [steps, steps]


def test_what_fatrop_gives_up_reaches_the_results(straight_scene, monkeypatch):
    solve = NonlinearSolver.solve

    def give_up(solver, *arguments):
        solver.given_up += 1
        return solve(solver, *arguments)

    monkeypatch.setattr(NonlinearSolver, "solve", give_up)
    settings = replace(SHORT, duration_us=2_000_000, control=ControlSettings(method="nonlinear"))
    ((_, score),) = run_closed_loop([straight_scene()], "route", rollouts=1, settings=settings)
    assert (score.rollout_incidents["solves_given_up"], score.rollout_incidents["solves_failed"]) == (3, 0)


def test_the_plan_says_what_moved_the_vehicle_and_what_that_left_out(straight_scene):
    settings = replace(SHORT, vehicle="tyres")
    results = run_closed_loop([straight_scene()], "route", rollouts=2, settings=settings)
    steps = 2 * round((4.0 - 1.7) / 0.1)
    taken = count_vehicle_steps(results)
    assert sum(taken.values()) == steps
    rolling = sum(count for way, count in taken.items() if way.startswith("kinematic"))
    assert rolling > 0
    slipless = Omission("steps of tyre slip", "below 3e-07 m in 0.1 s", rolling, steps)
    assert count_left_out(results)[slipless] == 2


def test_scores_are_refused_while_the_gate_fails(straight_scene, moving_agent):
    blocked = straight_scene((moving_agent("in the way", (30.0, 0.0)),))
    with pytest.raises(InputError, match=r"gate fails on scene straight .*in the way at 2\.37 s.*scores would mean"):
        run_closed_loop([blocked], "constant_velocity", settings=SHORT)


def test_reactive_traffic_is_scored_as_it_moved(straight_scene, moving_agent):
    scene = straight_scene((moving_agent("follower", (-20.0, 0.0), (10.0, 0.0)),))
    hit, spared = (
        run_closed_loop([scene], "standing", 1, settings=SimulationSettings(traffic=traffic))[0]
        for traffic in ("recorded", "idm")
    )
    assert hit[1].collided and not spared[1].collided
    assert spared[0].traffic == "idm"


def test_results_are_written_whole(straight_scene, tmp_path):
    results = run_closed_loop([straight_scene()], "standing", settings=SHORT)
    save_results(tmp_path / "out", results)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "rollouts.parquet",
        "scores.json",
        "timings.json",
    ]
    assert [rollout.seed for rollout in load_rollouts(tmp_path / "out" / "rollouts.parquet")] == [0, 1]
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


def test_a_bad_scene_loses_itself_only(straight_scene, moving_agent):
    blocked = replace(straight_scene((moving_agent("in the way", (30.0, 0.0)),)), name="blocked", category="dense")
    alone = run_closed_loop([straight_scene()], "constant_velocity", settings=SHORT)
    for workers in (1, 2):
        results = run_closed_loop(
            [blocked, "absent.usda", straight_scene(duration=1.5), straight_scene()],
            "constant_velocity",
            settings=SHORT,
            workers=workers,
        )
        assert [(score.scene, score.category, score.valid) for _, score in results[::2]] == [
            ("blocked", "dense", False),
            ("absent.usda", "unknown", False),
            ("straight", "nominal", False),
            ("straight", "nominal", True),
        ]
        reasons = [score.reason for _, score in results[:6:2]]
        assert all(
            text in why
            for text, why in zip(("in the way at 2.37 s", "absent.usda", "after the warm-up"), reasons, strict=True)
        )
        assert all(score.score is None for _, score in results[:6])
        for (rollout, score), (other, expected) in zip(results[6:], alone, strict=True):
            np.testing.assert_array_equal(rollout.states, other.states)
            assert score.to_dict() == expected.to_dict()
    table = summarize_scores([score for _, score in results])
    assert (table.overall.rollouts, table.overall.valid) == (8, 2)


def test_the_gate_is_not_asked_again_of_scenes_on_which_it_holds(straight_scene, monkeypatch):
    asked = []
    monkeypatch.setattr(evaluation, "check_gate", lambda scene, *rest: asked.append(scene) or check_gate(scene, *rest))
    first, again = (
        run_closed_loop([straight_scene()], "constant_velocity", 1, settings=SHORT, gated=gated)[0][1]
        for gated in (False, True)
    )
    assert len(asked) == 1 and first == again


def test_the_gate_command_names_what_it_refuses(tmp_path):
    arguments = ["gate", str(tmp_path / "absent.json.gz"), "cyclists:3", "--definition", "alpasim", "--json"]
    result = CliRunner().invoke(app, arguments)
    refused, passed = json.loads(result.stdout)["gate"]
    assert result.exit_code == 1 and not refused["passed"] and "absent.json.gz" in refused["refusal"]
    assert passed["passed"] and passed["narrow"][0]["metres"] > 1.0


def test_the_gate_command_draws_what_it_could_read(tmp_path):
    picture = tmp_path / "gate.png"
    CliRunner().invoke(app, ["gate", str(tmp_path / "absent.json.gz"), "cyclists:3", "--picture", str(picture)])
    image = cv2.imread(str(picture))
    assert image.shape[1] > image.shape[0] > 300 and len(np.unique(image.reshape(-1, 3), axis=0)) > 20
    assert CliRunner().invoke(app, ["gate", "cyclists:3", "--picture", str(tmp_path / "gate.gif")]).exit_code == 2


def test_the_command_prints_a_table_and_writes_files(tmp_path):
    arguments = ["run", "--scene", "nominal:0", "--policy", "route", "--rollouts", "1", "--workers", "1", "--json"]
    result = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    printed = json.loads(result.stdout)
    assert printed["table"]["rows"][-1]["category"] == "overall"
    assert (tmp_path / "scores.json").is_file()


def test_traffic_and_planner_delay_are_options(tmp_path):
    arguments = ["run", "nominal:0", "--policy", "standing", "--rollouts", "1", "--workers", "1", "--json"]
    options = ["--traffic", "idm", "--planner-delay", "0.3", "--duration", "4", "--definition", "alpasim"]
    result = CliRunner().invoke(app, [*arguments, *options, "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    printed = json.loads(result.stdout)
    assert (printed["traffic"], printed["table"]["definition"]) == ("idm", "alpasim@3032e0c")
    (rollout,) = load_rollouts(tmp_path / "rollouts.parquet")
    assert rollout.traffic == "idm" and len(rollout.states) == 41
    assert rollout.plan_times_us[0] == rollout.handover_us - 300_000


def test_the_gate_command_fails_where_the_gate_does(straight_scene, moving_agent, tmp_path):
    good = write_scene(straight_scene(), tmp_path / "good.usda")
    blocked = write_scene(straight_scene((moving_agent("in the way", (30.0, 0.0)),)), tmp_path / "blocked.usda")
    passed = CliRunner().invoke(app, ["gate", str(good), "--json"])
    assert passed.exit_code == 0 and json.loads(passed.stdout)["passed"]
    failed = CliRunner().invoke(app, ["gate", str(good), str(blocked)])
    assert failed.exit_code == 1 and "front contact with automobile in the way" in " ".join(failed.stdout.split())


def test_the_scene_command_converts_and_reports_the_gate(tmp_path):
    stage = tmp_path / "scene.usdc"
    result = CliRunner().invoke(app, ["scene", "nominal:1", "--out", str(stage), "--json"])
    assert result.exit_code == 0, result.output
    printed = json.loads(result.stdout)
    assert printed["gate"]["passed"] and printed["assumptions"] == []
    assert load_scene(str(stage)).name == printed["name"]
    assert CliRunner().invoke(app, ["scene", "nominal:1", "--out", str(tmp_path / "scene.obj")]).exit_code != 0


def test_controller_and_integrator_are_options_of_the_names_that_there_are():
    assert (get_args(options.Controller), get_args(options.Integrator)) == (get_args(ControlMethod), get_args(Method))
    assert (get_args(options.Traffic), get_args(options.Vehicle)) == (get_args(Traffic), get_args(VehicleKind))
    assert get_args(options.Definition) == get_args(DefinitionName)


@pytest.mark.parametrize(
    ("options", "way"),
    [
        (["--controller", "lqr", "--integrator", "rk4"], "kinematic rk4"),
        (["--integrator", "cvodes", "--vehicle", "tyres"], "saturating cvodes"),
    ],
)
def test_controller_and_integrator_are_taken(options, way):
    arguments = ["run", "nominal:0", "--policy", "route", "--rollouts", "1", "--workers", "1", "--duration", "3"]
    result = CliRunner().invoke(app, [*arguments, *options, "--json"])
    assert result.exit_code == 0, result.output
    printed = json.loads(result.stdout)
    assert printed["vehicle_steps"] == {way: 13}
    assert (printed["controller"], printed["integrator"]) == ("lqr" if "lqr" in options else "linear", way.split()[1])


class _Named(policies.ConstantVelocityPolicy):
    name = "{} of {0!r:>3} 1 of 2"


class _Broken:
    name, cameras, image_size = "broken", (), (0, 0)

    def plan(self, observation):
        raise RuntimeError("out of order")


@pytest.fixture
def register(monkeypatch):
    """Makes a policy known under a name."""

    def register_policy(name, policy):
        entry = SimpleNamespace(name=name, load=lambda: lambda argument: policy)
        monkeypatch.setattr(policies, "entry_points", lambda group: [entry])

    return register_policy


def test_a_policy_may_have_any_name(register):
    register("{policy}", _Named())
    arguments = ["run", "nominal:0", "--policy", "{policy}", "--rollouts", "2", "--workers", "1", "--duration", "3"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    told = " ".join(result.stdout.split())
    assert f"left out in 2 of 2 rollouts: the route ahead: policy {_Named.name} does not look at it" in told


def test_what_was_left_out_is_added_up(straight_scene, moving_agent):
    near, far = moving_agent("near", (20.0, 4.0)), moving_agent("far", (0.0, 300.0))
    scenes = [straight_scene((near, far)), replace(straight_scene((far,)), name="other")]
    results = run_closed_loop(scenes, "standing", rollouts=2, settings=SHORT)
    counted = count_left_out(results)
    assert counted[Omission("agents in collision tests", "never within reach", 4, 6)] == 4
    assert counted[Omission("tyre dynamics", "the vehicle is kinematic")] == 4


def test_the_command_fails_when_a_rollout_is_not_valid(register):
    register("broken", _Broken())
    result = CliRunner().invoke(app, ["run", "--scene", "nominal:0", "--policy", "broken", "--workers", "1"])
    assert result.exit_code == 1
    assert "not valid: the policy raised RuntimeError" in result.stdout
