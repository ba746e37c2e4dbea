"""Policies beside each other and beside the baselines."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from olt_closed_loop.commands import app
from olt_closed_loop.evaluation.baselines import BASELINES, run_baselines, word_warnings
from olt_closed_loop.evaluation.comparison import compare_scores, name_runs, read_scores
from olt_closed_loop.evaluation.comparison_report import policy_rows
from olt_closed_loop.evaluation.evaluation import run_closed_loop
from olt_closed_loop.evaluation.run_folder import save_results
from olt_closed_loop.scoring.definitions import RolloutScore
from olt_closed_loop.simulation.settings import SimulationSettings
from olt_generator.errors import InputError

SHORT = SimulationSettings(duration_us=4_000_000)


def run(values, policy="p", rollouts=1, definition="strict"):
    """Scores of a policy on scenes "0", "1", ...; None failed."""
    return [
        RolloutScore(str(i), "c", policy, seed, definition, valid=v is not None, score=v, collided=v == 0.0)
        for i, v in enumerate(values)
        for seed in range(rollouts)
    ]


def test_differences_are_paired_by_scene():
    generator = np.random.default_rng(0)
    scenes = generator.uniform(0.1, 0.8, size=20)
    comparison = compare_scores({"a": run(scenes + 0.1), "b": run(scenes + generator.normal(0, 0.02, 20))})
    (difference,) = comparison.differences
    assert difference.score == pytest.approx(0.1, abs=0.02) and difference.separated
    low, high = difference.score_interval
    assert high - low < 0.05  # while each score alone is known to 0.2
    width = np.diff(comparison.policies["a"].alpasim_score_interval)[0]
    assert width > 4 * (high - low)


def test_the_difference_turns_with_the_order_and_rollouts_of_a_scene_count_as_one():
    first, second = np.linspace(0.0, 1.0, 9), np.linspace(0.3, 0.6, 9)
    (there,) = compare_scores({"a": run(first), "b": run(second)}).differences
    (back,) = compare_scores({"b": run(second), "a": run(first)}).differences
    (often,) = compare_scores({"a": run(first, rollouts=5), "b": run(second)}).differences
    assert there.score == pytest.approx(-back.score) and not there.separated
    assert often.score_interval == there.score_interval and often.scenes == 9


@pytest.mark.parametrize(("count", "separated"), [(5, False), (6, True)])
def test_few_scenes_that_agree_separate_nothing(count, separated):
    (difference,) = compare_scores({"a": run([1.0] * count), "b": run([0.5] * count)}).differences
    assert (difference.score, difference.score_interval) == (0.5, None)
    assert difference.separated == separated


@pytest.mark.parametrize(("met", "words"), [(0, "none in 2 (at least "), (1, "2 (at least "), (10, "0.2 (")])
def test_a_distance_that_may_be_any_is_not_called_none(met, words):
    """One incident on twenty scenes: scenes drawn anew may have none, so the interval has no upper end."""
    scores = [
        replace(score, distance_m=100.0, incidents=int(place < met), incidents_at_fault=int(place < met))
        for place, score in enumerate(run([1.0] * 20))
    ]
    comparison = compare_scores({"a": scores})
    (row,) = policy_rows(comparison)
    assert row[-1] is not None and row[-2:] == [row[-1]] * 2 and row[-1].startswith(words)
    assert ("to" in row[-1]) == (met == 10)


def test_scenes_that_one_did_not_drive_or_score_are_not_compared():
    comparison = compare_scores({"a": run([1.0, 0.5, 0.2]), "b": run([0.5, None])})
    (difference,) = comparison.differences
    assert (comparison.scenes, comparison.not_compared) == (2, ("2",))
    assert (difference.scenes, difference.score, difference.score_interval) == (1, 0.5, None)
    (nothing,) = compare_scores({"a": run([1.0]), "b": run([None])}).differences
    assert (nothing.scenes, nothing.score) == (0, None) and not nothing.separated


def test_what_cannot_be_compared_is_refused():
    with pytest.raises(InputError, match="alpasim@3032e0c and strict cannot be compared"):
        compare_scores({"a": run([1.0]), "b": run([1.0], definition="alpasim@3032e0c")})
    with pytest.raises(InputError, match="no scene was driven by all"):
        compare_scores({"a": run([1.0]), "b": []})


def test_a_baseline_that_is_as_good_is_warned_of():
    better, equal, worse = np.full(12, 0.51), np.linspace(0.2, 0.8, 12), np.zeros(12)
    runs = {"mine": run(better), "go straight": run(equal), "stop": run(worse), "route": run(np.ones(12))}
    lines = word_warnings(compare_scores(runs, "mine"))
    assert len(lines) == 2
    assert lines[0].startswith("mine is not clearly separated from go straight: AS differs by +0.010 (95 % -")
    assert lines[1].startswith("route scores higher than mine: AS differs by -0.490 (no interval")


def test_baselines_are_the_four_without_the_policy_itself(straight_scene):
    driven = run_baselines(["nominal:0"], "route", settings=SHORT, definition="alpasim@challenge-2026-09")
    assert list(driven) == ["constant speed", "go straight", "stop"]
    ((rollout, score),) = driven["go straight"]
    assert rollout.policy == BASELINES["go straight"] == "constant_velocity"
    assert score.definition == "alpasim@challenge-2026-09"
    assert set(run_baselines([straight_scene()], "toy:x", settings=SHORT)) == set(BASELINES)


def test_runs_are_named_by_what_tells_them_apart(tmp_path):
    folders = [tmp_path / "x" / "one", tmp_path / "y" / "two", tmp_path / "z" / "two"]
    assert name_runs(folders[:2], [run([1.0], "p"), run([1.0], "q")]) == ["p", "q"]
    assert name_runs(folders[:2], [run([1.0]), run([1.0])]) == ["one", "two"]
    assert name_runs(folders[1:], [run([1.0]), run([1.0])]) == [str(folder) for folder in folders[1:]]


def test_the_run_command_shows_baselines_and_compare_reads_what_it_wrote(tmp_path):
    out = tmp_path / "run"
    arguments = ["run", "nominal:0", "--policy", "route", "--rollouts", "1", "--workers", "1", "--duration", "4"]
    result = CliRunner().invoke(app, [*arguments, "--out", str(out), "--json"])
    assert result.exit_code == 0, result.output
    printed = json.loads(result.stdout)
    assert list(printed["comparison"]["policies"]) == ["route", "constant speed", "go straight", "stop"]
    assert len(printed["warnings"]) == 3  # one scene tells nothing apart
    assert json.loads((out / "comparison.json").read_text())["warnings"] == printed["warnings"]
    assert (out / "comparison.png").read_bytes().startswith(b"\x89PNG")
    folders = [out, out / "baselines" / "standing"]
    compared = CliRunner().invoke(app, ["compare", *map(str, folders), "--json", "--out", str(tmp_path / "both")])
    assert compared.exit_code == 0, compared.output
    assert list(json.loads(compared.stdout)["policies"]) == ["route", "standing"]
    assert "route less standing" in CliRunner().invoke(app, ["compare", *map(str, folders)]).stdout
    assert CliRunner().invoke(app, ["compare", str(out)]).exit_code == 2


def test_without_baselines_none_is_driven(tmp_path):
    arguments = ["run", "nominal:0", "--policy", "standing", "--rollouts", "1", "--workers", "1", "--duration", "4"]
    options = ["--no-baselines", "--definition", "alpasim@challenge-2026-09", "--out", str(tmp_path)]
    result = CliRunner().invoke(app, [*arguments, *options])
    assert result.exit_code == 0 and "WARNING" not in result.stdout and "km / at fault" in result.stdout
    assert not (tmp_path / "baselines").exists()
    (row,) = json.loads((tmp_path / "results-summary.json").read_text())["rollouts"]
    assert (row["clipgt_id"], row["status"]) == ("nominal_000000", "pass")
    assert row["score_metrics"]["left_corridor_laterally"] == 0.0


def test_scores_of_a_run_come_back(straight_scene, tmp_path):
    results = run_closed_loop([straight_scene()], "standing", rollouts=2, settings=SHORT)
    save_results(tmp_path, results)
    kept = read_scores(tmp_path)
    assert (
        compare_scores({"a": kept, "b": kept}).policies["a"]
        == compare_scores({"a": [score for _, score in results], "b": kept}).policies["a"]
    )


@pytest.mark.parametrize("text", ["[]", "{}", '{"scores": [{}]}', '{"scores": 3}', "no JSON"])
def test_a_folder_without_scores_is_refused(tmp_path, text):
    (tmp_path / "scores.json").write_text(text)
    with pytest.raises(InputError, match=r"scores"):
        read_scores(tmp_path)
