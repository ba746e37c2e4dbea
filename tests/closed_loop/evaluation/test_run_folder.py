"""Runs that are broken off at any moment, and what is found again."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from olt_closed_loop.commands import app
from olt_closed_loop.evaluation.evaluation import run_closed_loop
from olt_closed_loop.rollouts.rollout_tables import load_rollouts
from olt_closed_loop.scenes.scene_file import write_scene
from olt_closed_loop.simulation.policies import ConstantVelocityPolicy
from olt_closed_loop.simulation.policy_hosts import PolicyLimits
from olt_closed_loop.simulation.settings import SimulationSettings
from olt_generator.errors import InputError
from olt_toolkit.runtime.workers import Engine

SHORT = SimulationSettings(duration_us=3_000_000)
RESULTS = ("rollouts.parquet", "scores.json")


class Counting:
    """Goes straight on, and writes down each rollout that it begins."""

    name, cameras, image_size = "counting", (), (0, 0)

    def __init__(self, log=None, die_at=None):
        self.log, self.die_at = log, die_at

    def reset(self, seed, scene):
        with self.log.open("a") as log:
            log.write(f"{seed}\n")
        if self.die_at and (self.die_at.exists() and seed == 2):
            self.die_at.unlink()
            os.kill(os.getppid(), signal.SIGKILL)

    def plan(self, observation):
        return ConstantVelocityPolicy().plan(observation)


def results_of(folder):
    return {name: (folder / name).read_bytes() for name in RESULTS}


def test_results_stand_in_the_folder_as_they_are_returned(straight_scene, tmp_path):
    results = run_closed_loop([straight_scene()], "route", 3, settings=SHORT, out=tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir() if not path.name.startswith(".")) == [
        "rollouts.parquet",
        "run.json",
        "scores.json",
        "timings.json",
    ]
    kept = load_rollouts(tmp_path / "rollouts.parquet")
    assert [one.to_dict() for one in kept] == [replace(one, timings={}).to_dict() for one, _ in results]
    assert len(json.loads((tmp_path / "timings.json").read_text())["seconds"]) == 3


def test_a_finished_rollout_is_not_driven_again(straight_scene, tmp_path):
    log, parts = tmp_path / "log", tmp_path / "out" / "parts"
    run_closed_loop([straight_scene()], Counting(log), 4, settings=SHORT, out=tmp_path / "out")
    whole = results_of(tmp_path / "out")
    again = run_closed_loop([straight_scene()], Counting(log), 4, settings=SHORT, out=tmp_path / "out")
    assert log.read_text().split() == ["0", "1", "2", "3"]
    assert results_of(tmp_path / "out") == whole and [score.score for _, score in again] == [1.0] * 4
    assert not parts.exists()


def drive_scenes(folder, workers=1):
    """A run of eight rollouts, by a policy of which each kind of host is asked."""
    scenes = [f"{category}:{seed}" for category in ("nominal", "cyclists") for seed in (1, 2)]
    settings = SimulationSettings(duration_us=2_500_000, limits=PolicyLimits(isolate="process"))
    return run_closed_loop(scenes, "constant_velocity", 2, settings=settings, out=folder, workers=workers)


def run_in_another_process(folder, workers=1):
    code = "import sys; from pathlib import Path; import test_run_folder as t; t.drive_scenes(Path(sys.argv[1]), {})"
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parent), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-c", f"if __name__ == '__main__':\n    {code.format(workers)}", str(folder)]
    return subprocess.Popen(command, env=environment)


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_a_run_that_is_killed_at_random_moments_ends_like_an_unbroken_one(tmp_path, workers):
    drive_scenes(tmp_path / "unbroken")
    unbroken = results_of(tmp_path / "unbroken")
    first = run_in_another_process(tmp_path / "timed")
    started = time.monotonic()
    assert first.wait() == 0
    longest = time.monotonic() - started
    moments = np.random.default_rng(workers).uniform(0.0, longest, 20)
    folder, killed, kept = tmp_path / "killed", 0, set()
    for moment in moments:
        process = run_in_another_process(folder, workers)
        time.sleep(moment)
        process.kill()
        killed += process.wait() == -signal.SIGKILL
        found = {path.name for path in folder.glob("parts/0*.parquet")}
        assert kept <= found or (folder / "rollouts.parquet").exists()
        kept = found
    assert killed >= 10
    drive_scenes(folder)
    assert results_of(folder) == unbroken


def test_a_killed_run_goes_on_where_it_was(straight_scene, tmp_path):
    log, die_at = tmp_path / "log", tmp_path / "die"
    die_at.touch()
    scenes = [straight_scene()]
    child = os.fork()
    if child == 0:
        try:
            run_closed_loop(scenes, Counting(log, die_at), 4, settings=SHORT, out=tmp_path / "out")
        finally:
            os._exit(1)
    assert os.WTERMSIG(os.waitpid(child, 0)[1]) == signal.SIGKILL
    assert sorted(path.name for path in (tmp_path / "out" / "parts").iterdir()) == ["000000.parquet", "000001.parquet"]
    (tmp_path / "out" / ".rollouts.abandoned.parquet").touch()
    run_closed_loop(scenes, Counting(log, die_at), 4, settings=SHORT, out=tmp_path / "out")
    assert log.read_text().split() == ["0", "1", "2", "2", "3"]
    run_closed_loop(scenes, Counting(log, die_at), 4, settings=SHORT, out=tmp_path / "unbroken")
    assert results_of(tmp_path / "out") == results_of(tmp_path / "unbroken")
    assert not (tmp_path / "out" / ".rollouts.abandoned.parquet").exists()


OTHER = {
    "--seed was 0 and is 1": {"seed": 1},
    "--rollouts was 1 and is 2": {"rollouts": 2},
    "--definition was": {"definition": "alpasim"},
    "--policy was .*route.*standing": {"policy": "standing"},
    "--duration was 3000000 and is 4000000": {"settings": replace(SHORT, duration_us=4_000_000)},
    "--traffic was": {"settings": replace(SHORT, traffic="idm")},
    "scenes was": {"scenes": ["nominal:0"]},
    "limits.refused_share was": {"settings": replace(SHORT, limits=PolicyLimits(refused_share=0.5))},
}


@pytest.mark.parametrize("words", OTHER)
def test_a_run_with_other_options_is_refused_by_their_name(straight_scene, tmp_path, words):
    given = {"scenes": [straight_scene()], "policy": "route", "rollouts": 1, "settings": SHORT, "out": tmp_path}
    run_closed_loop(**given)
    whole = results_of(tmp_path)
    with pytest.raises(InputError, match=f"holds a run with other options .*{words}"):
        run_closed_loop(**(given | OTHER[words]))
    assert results_of(tmp_path) == whole


def test_a_scene_file_that_changed_is_told(straight_scene, tmp_path):
    path = write_scene(straight_scene(), tmp_path / "scene.usda")
    run_closed_loop([str(path)], "route", 1, settings=SHORT, out=tmp_path / "out")
    write_scene(straight_scene(speed=9.0), path)
    with pytest.raises(InputError, match="scenes was"):
        run_closed_loop([str(path)], "route", 1, settings=SHORT, out=tmp_path / "out")


def test_a_run_of_which_nothing_is_finished_may_be_given_other_options(straight_scene, moving_agent, tmp_path):
    blocked = straight_scene((moving_agent("in the way", (30.0, 0.0)),))
    with pytest.raises(InputError, match="gate fails"):
        run_closed_loop([blocked], "route", 1, settings=SHORT, out=tmp_path)
    assert len(run_closed_loop([straight_scene()], "route", 1, settings=SHORT, out=tmp_path)) == 1


def test_two_runs_cannot_share_a_folder(tmp_path):
    first = run_in_another_process(tmp_path)
    try:
        while not (tmp_path / "run.json").exists():
            time.sleep(0.05)
        with pytest.raises(InputError, match="another process runs in this folder"):
            drive_scenes(tmp_path)
    finally:
        first.kill()
        first.wait()


def test_isolation_and_workers_may_change(straight_scene, tmp_path):
    for isolate in ("none", "process"):
        settings = replace(SHORT, limits=PolicyLimits(isolate=isolate))
        run_closed_loop([straight_scene()], "route", 1, settings=settings, out=tmp_path)


def test_a_folder_of_something_else_is_refused(straight_scene, tmp_path):
    (tmp_path / "rollouts.json").write_text("{}")
    with pytest.raises(InputError, match="holds results of something else"):
        run_closed_loop([straight_scene()], "route", 1, settings=SHORT, out=tmp_path)


def test_one_bad_scene_loses_itself_only(straight_scene, moving_agent, tmp_path):
    blocked = replace(straight_scene((moving_agent("in the way", (30.0, 0.0)),)), name="blocked")
    damaged = tmp_path / "damaged.usda"
    damaged.write_text("no scene")
    results = run_closed_loop([blocked, straight_scene(), str(damaged)], "route", 1, settings=SHORT, out=tmp_path / "o")
    assert [(rollout.failure_kind, score.score) for rollout, score in results] == [
        ("scene_refused", None),
        (None, 1.0),
        ("scene_refused", None),
    ]
    assert "gate fails on scene blocked" in results[0][1].reason and "damaged.usda" in results[2][1].reason
    assert [rollout.scene for rollout in load_rollouts(tmp_path / "o" / "rollouts.parquet")] == [
        "blocked",
        "straight",
        str(damaged),
    ]


def test_the_command_goes_on_after_a_bad_scene_and_fails(tmp_path):
    (tmp_path / "damaged.usda").write_text("no scene")
    arguments = ["run", str(tmp_path / "damaged.usda"), "nominal:0", "--rollouts", "1", "--workers", "1", "--json"]
    result = CliRunner().invoke(app, [*arguments, "--duration", "3"])
    assert result.exit_code == 1
    printed = json.loads(result.stdout)
    assert [score["score"] for score in printed["scores"]] == [None, 1.0]
    assert (printed["table"]["rows"][-1]["valid"], printed["table"]["rows"][-1]["rollouts"]) == (1, 2)


def test_limits_of_time_and_memory_need_a_process():
    arguments = ["run", "nominal:0", "--isolate", "none", "--policy-timeout", "3"]
    assert CliRunner().invoke(app, arguments).exit_code == 2


class Deadly:
    """Kills the process that drives, once."""

    name, cameras, image_size = "deadly", (), (0, 0)

    def __init__(self, mark):
        self.mark = mark

    def plan(self, observation):
        if self.mark.exists():
            self.mark.unlink()
            os.kill(os.getpid(), signal.SIGKILL)
        return ConstantVelocityPolicy().plan(observation)


@pytest.mark.slow
def test_a_run_on_a_cluster_survives_a_killed_worker(straight_scene, tmp_path):
    pytest.importorskip("ray", reason="needs the extra `distributed`")
    mark = tmp_path / "mark"
    settings = replace(SHORT, limits=PolicyLimits(isolate="none"))
    scenes = [straight_scene()]
    run_closed_loop(scenes, Deadly(mark), 4, settings=settings, out=tmp_path / "here")
    mark.touch()
    run_closed_loop(scenes, Deadly(mark), 4, settings=settings, out=tmp_path / "cluster", workers=2, engine=Engine.RAY)
    assert not mark.exists()
    assert results_of(tmp_path / "cluster") == results_of(tmp_path / "here")
