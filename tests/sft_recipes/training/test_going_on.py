"""A training that is killed goes on as if nothing had happened."""

import json
import os
import signal
import traceback

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


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("trainings")


@pytest.fixture(scope="module")
def train(drives, tiny_config, folder):
    keys = sorted(drives)
    validation = Validation([drives[keys[0]]])

    def batches(epoch, size):
        return [keys[start : start + size] for start in range(0, len(keys), size)]

    def run(name, on_progress=lambda share: None):
        def load(asked):
            return [drives[key] for key in asked]

        return train_two_stages(STAGES, batches, load, folder / name, tiny_config, on_progress, validation)

    return run


def in_child(work):
    """Do work in a process of its own; returns how it ended."""
    child = os.fork()
    if child == 0:
        try:
            work()
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def kill():
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.fixture(scope="module")
def whole(train, folder):
    """An uninterrupted training: the results and all bytes of its policy."""
    results = train("whole")
    return results, [path.read_bytes() for path in sorted((folder / "whole/policy").glob("*.safetensors"))]


def check_equal(results, whole, out):
    assert [result.losses for result in results] == [result.losses for result in whole[0]]
    assert [result.evaluations for result in results] == [result.evaluations for result in whole[0]]
    assert [path.read_bytes() for path in sorted((out / "policy").glob("*.safetensors"))] == whole[1]
    assert not [path.name for path in out.rglob(".*")]
    assert not (out / "samples").exists()


@pytest.mark.parametrize(
    "step", [pytest.param(step, marks=[pytest.mark.slow] if step not in (3, 8) else []) for step in range(1, STEPS + 1)]
)
def test_killed_at_any_step_it_goes_on_exactly(train, whole, folder, step):
    def kill_there(share):
        if share >= step / STEPS - 1e-9:
            kill()

    name = f"killed-{step}"
    assert in_child(lambda: train(name, kill_there)) == -signal.SIGKILL
    check_equal(train(name), whole, folder / name)


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
@pytest.mark.slow
def test_killed_while_it_saves_or_judges_it_goes_on_exactly(train, whole, folder, monkeypatch, module, function, after):
    real, calls, name = getattr(module, function), [], f"{module.__name__}-{function}-{after}"

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
        assert in_child(lambda: train(name)) == -signal.SIGKILL
    results = train(name)
    assert [result.losses for result in results] == [result.losses for result in whole[0]]
    assert [result.evaluations for result in results] == [result.evaluations for result in whole[0]]
    assert [path.read_bytes() for path in sorted((folder / name / "policy").glob("*.safetensors"))] == whole[1]


@pytest.mark.slow
def test_killed_in_a_row_it_still_goes_on(train, whole, folder):
    """Each life takes three more steps and is killed before it saves the last of them."""

    def live():
        taken = []
        train("killed", lambda share: taken.append(share) or (len(taken) == 3 and kill()))

    lives = 0
    while in_child(live) == -signal.SIGKILL:
        lives += 1
    assert lives > 2
    check_equal(train("killed"), whole, folder / "killed")


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
    assert rates == [STAGES[1].learning_rate_at(step, 6) for step in range(6)]


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
