"""A training that is killed goes on as if nothing had happened."""

import json
import os
import signal

import numpy as np
import pytest

from olt_sft_recipes.training import checkpoints, optimization, two_stages
from olt_sft_recipes.training.stage_config import StageConfig
from olt_sft_recipes.training.two_stages import read_results, train_two_stages
from olt_sft_recipes.training.validation import Validation

AUGMENTED = {"mirror_probability": 0.5, "turn_degrees": 4.0, "move_metres": 0.5}
SETTINGS = {"num_train_epochs": 2, "per_device_train_batch_size": 4, "learning_rate": 3e-3, "warmup_steps": 2}
STAGES = (
    StageConfig(stage=1, save_steps=2, hidden_token_probability=0.5, **SETTINGS, **AUGMENTED),
    StageConfig(stage=2, save_steps=2, eval_steps=3, **SETTINGS, **AUGMENTED),
)
STEPS = 12  # six of each stage


@pytest.fixture
def train(drives, tiny_config, tmp_path):
    keys = sorted(drives)
    validation = Validation([drives[key] for key in keys[:3]])

    def batches(epoch, size):
        return [keys[start : start + size] for start in range(0, len(keys), size)]

    def run(name, on_progress=lambda share: None):
        def load(asked):
            return [drives[key] for key in asked]

        return train_two_stages(STAGES, batches, load, tmp_path / name, tiny_config, on_progress, validation)

    return run


def in_child(work):
    """Do work in a process of its own; returns how it ended."""
    child = os.fork()
    if child == 0:
        try:
            work()
        finally:
            os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def kill():
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.fixture
def whole(train, tmp_path):
    """An uninterrupted training: the results and all bytes of its policy."""
    results = train("whole")
    return results, [path.read_bytes() for path in sorted((tmp_path / "whole/policy").glob("*.safetensors"))]


def check_equal(results, whole, folder):
    assert [result.losses for result in results] == [result.losses for result in whole[0]]
    assert [result.evaluations for result in results] == [result.evaluations for result in whole[0]]
    assert [path.read_bytes() for path in sorted((folder / "policy").glob("*.safetensors"))] == whole[1]
    assert not [path.name for path in folder.rglob(".*")]
    assert not (folder / "samples").exists()


def test_killed_at_any_step_it_goes_on_exactly(train, whole, tmp_path):
    for step in range(1, STEPS + 1):
        name = f"killed-{step}"

        def kill_there(share, step=step):
            if share >= step / STEPS - 1e-9:
                kill()

        assert in_child(lambda name=name, at=kill_there: train(name, at)) == -signal.SIGKILL
        check_equal(train(name), whole, tmp_path / name)


@pytest.mark.parametrize(
    ("module", "function"),
    [
        (checkpoints, "write_model"),
        (optimization, "prune_checkpoints"),
        (optimization, "evaluate"),
        (optimization, "update_state"),
        (two_stages, "write_model"),
    ],
)
@pytest.mark.parametrize("after", [False, True])
def test_killed_while_it_saves_or_judges_it_goes_on_exactly(
    train, whole, tmp_path, monkeypatch, module, function, after
):
    real, calls = getattr(module, function), []

    def killing(*arguments):
        calls.append(arguments)
        last = len(calls) == (1 if module is two_stages else 2)
        if last and not after:
            kill()
        result = real(*arguments)
        if last:
            kill()
        return result

    with monkeypatch.context() as patched:
        patched.setattr(module, function, killing)
        assert in_child(lambda: train("killed")) == -signal.SIGKILL
    results = train("killed")
    assert [result.losses for result in results] == [result.losses for result in whole[0]]
    assert [result.evaluations for result in results] == [result.evaluations for result in whole[0]]
    assert [path.read_bytes() for path in sorted((tmp_path / "killed/policy").glob("*.safetensors"))] == whole[1]


def test_killed_in_a_row_it_still_goes_on(train, whole, tmp_path):
    """Each life takes three more steps and is killed before it saves the last of them."""

    def live():
        taken = []
        train("killed", lambda share: taken.append(share) or (len(taken) == 3 and kill()))

    lives = 0
    while in_child(live) == -signal.SIGKILL:
        lives += 1
    assert lives > 2
    check_equal(train("killed"), whole, tmp_path / "killed")


def test_other_settings_are_not_gone_on_with(train, tmp_path, monkeypatch):
    whole = train("one")
    monkeypatch.setattr(two_stages, "code_version", lambda: "another")
    again = train("one")
    assert [result.losses for result in again] == [result.losses for result in whole]
    assert again[0].seconds != whole[0].seconds


def test_the_state_holds_no_pickle_and_nothing_hidden(train, tmp_path):
    train("one")
    names = {path.name for path in (tmp_path / "one/stage2/checkpoint-6").iterdir()}
    assert names == {
        "config.json",
        "model-00001-of-00001.safetensors",
        "model.safetensors.index.json",
        "optimizer.safetensors",
        "trainer_state.json",
    }
    state = json.loads((tmp_path / "one/stage2/checkpoint-6/trainer_state.json").read_text())
    assert state["global_step"] == state["max_steps"] == 6
    assert [row["step"] for row in state["log_history"]] == [1, 2, 3, 4, 5, 6]
    rates = [row["learning_rate"] for row in state["log_history"]]
    assert rates == [STAGES[1].learning_rate_at(step, 6) for step in range(6)]


def test_the_best_checkpoint_is_kept_and_goes_on(train, tmp_path):
    results = train("one")
    judged = results[1].evaluations
    assert [evaluation["step"] for evaluation in judged] == [3, 6]
    errors = [evaluation["open_loop"]["min_ade"] for evaluation in judged]
    best = judged[int(np.argmin(errors))]["step"]
    assert results[1].checkpoint == f"checkpoint-{best}"
    kept = {path.name for path in (tmp_path / "one/stage2").glob("checkpoint-*")}
    assert kept == {"checkpoint-4", "checkpoint-6", f"checkpoint-{best}"}
    weights = "model-00001-of-00001.safetensors"
    chosen = tmp_path / "one/stage2" / results[1].checkpoint / weights
    assert (tmp_path / "one/policy" / weights).read_bytes() == chosen.read_bytes()
    assert read_results(tmp_path / "one") == results
