"""A training that is killed goes on as if nothing had happened."""

import json
import runpy
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from olt_sft_recipes.training import two_stages
from olt_sft_recipes.training.two_stages import read_results

SCRIPT = Path(__file__).with_name("killed_training.py")
TRAINING = runpy.run_path(str(SCRIPT))
STEPS = TRAINING["STEPS"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("trainings")


@pytest.fixture(scope="module")
def train(folder):
    return lambda name: TRAINING["train"](folder / name)


def is_killed(out, *where):
    """Train in a process of its own until it is killed there; False where it came to its end before."""
    ended = subprocess.run([sys.executable, SCRIPT, out, *map(str, where)], timeout=300).returncode
    assert ended in (0, -signal.SIGKILL)
    return ended != 0


@pytest.fixture(scope="module")
def whole(train, folder):
    """An uninterrupted training: the results and all bytes of its policy."""
    results = train("whole")
    return results, [path.read_bytes() for path in sorted((folder / "whole/policy").glob("*.safetensors"))]


def check_equal(results, whole, out):
    assert [result.losses for result in results] == [result.losses for result in whole[0]]
    assert [result.evaluations for result in results] == [result.evaluations for result in whole[0]]
    assert [path.read_bytes() for path in sorted((out / "policy").glob("*.safetensors"))] == whole[1]
    assert [path.name for path in out.rglob(".*")] == [".lock"]
    assert not (out / "samples").exists()


@pytest.mark.parametrize(
    "step", [pytest.param(step, marks=[pytest.mark.slow] if step not in (3, 8) else []) for step in range(1, STEPS + 1)]
)
def test_killed_at_any_step_it_goes_on_exactly(train, whole, folder, step):
    name = f"killed-{step}"
    assert is_killed(folder / name, "step", step)
    check_equal(train(name), whole, folder / name)


@pytest.mark.parametrize(
    ("function", "call"),
    [
        ("checkpoints.write_model", 2),
        ("optimization.prune_checkpoints", 2),
        ("optimization.evaluate", 2),
        ("optimization.update_state", 2),
        ("two_stages.write_model", 1),
    ],
)
@pytest.mark.parametrize("when", ["before", "after"])
@pytest.mark.slow
def test_killed_while_it_saves_or_judges_it_goes_on_exactly(train, whole, folder, function, call, when):
    name = f"{function}-{when}"
    assert is_killed(folder / name, f"olt_sft_recipes.training.{function}", call, when)
    results = train(name)
    assert [result.losses for result in results] == [result.losses for result in whole[0]]
    assert [result.evaluations for result in results] == [result.evaluations for result in whole[0]]
    assert [path.read_bytes() for path in sorted((folder / name / "policy").glob("*.safetensors"))] == whole[1]


@pytest.mark.slow
def test_killed_in_a_row_it_still_goes_on(train, whole, folder):
    """Each life takes three more steps and is killed before it saves the last of them."""
    lives = 0
    while is_killed(folder / "killed", "three steps"):
        lives += 1
    assert lives > 2
    check_equal(train("killed"), whole, folder / "killed")


def is_running(process):
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_killed_while_another_process_decodes_it_leaves_none_and_goes_on_exactly(train, whole, folder):
    assert is_killed(folder / "ahead", "decoded ahead")
    left = (folder / "ahead.left").read_text().split()
    assert len(left) == 1
    until = time.monotonic() + 120
    while is_running(left[0]) and time.monotonic() < until:
        time.sleep(0.2)
    assert not is_running(left[0])
    check_equal(train("ahead"), whole, folder / "ahead")


def test_what_other_code_began_is_not_gone_on_with(train, whole, monkeypatch):
    monkeypatch.setattr(two_stages, "code_version", lambda: "another")
    again = train("other code")
    assert [result.losses for result in again] == [result.losses for result in whole[0]]
    monkeypatch.undo()
    assert train("other code")[0].seconds != again[0].seconds


def test_the_state_holds_no_pickle_and_nothing_hidden(whole, folder):
    names = {path.name for path in (folder / "whole/stage2/checkpoint-6").iterdir()}
    assert names == {
        "config.json",
        "model-00001-of-00001.safetensors",
        "model.safetensors.index.json",
        "optimizer.safetensors",
        "trainer_state.json",
    }
    state = json.loads((folder / "whole/stage2/checkpoint-6/trainer_state.json").read_text())
    assert state["global_step"] == state["max_steps"] == 6
    assert [row["step"] for row in state["log_history"]] == [1, 2, 3, 4, 5, 6]
    rates = [row["learning_rate"] for row in state["log_history"]]
    assert rates == [TRAINING["STAGES"][1].learning_rate_at(step, 6) for step in range(6)]


def test_the_best_checkpoint_is_kept_and_goes_on(whole, folder):
    results = whole[0]
    judged = results[1].evaluations
    assert [evaluation["step"] for evaluation in judged] == [3, 6]
    errors = [evaluation["open_loop"]["min_ade"] for evaluation in judged]
    best = judged[int(np.argmin(errors))]["step"]
    assert results[1].checkpoint == f"checkpoint-{best}"
    kept = {path.name for path in (folder / "whole/stage2").glob("checkpoint-*")}
    assert kept == {"checkpoint-4", "checkpoint-6", f"checkpoint-{best}"}
    weights = "model-00001-of-00001.safetensors"
    chosen = folder / "whole/stage2" / results[1].checkpoint / weights
    assert (folder / "whole/policy" / weights).read_bytes() == chosen.read_bytes()
    assert read_results(folder / "whole") == results
