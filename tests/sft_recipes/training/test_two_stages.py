import json

import numpy as np
import pytest
import torch

from olt_generator.errors import InputError
from olt_sft_recipes.open_loop import evaluate_open_loop
from olt_sft_recipes.toy.checkpoint import read_model, read_tensors, save_model
from olt_sft_recipes.toy.policy import ToyPolicy
from olt_sft_recipes.training.stage_config import StageConfig
from olt_sft_recipes.training.two_stages import train_stage, train_two_stages

STAGE_1 = StageConfig(
    stage=1, num_train_epochs=4, per_device_train_batch_size=4, learning_rate=3e-3, warmup_steps=2, seed=5
)
STAGE_2 = STAGE_1.model_copy(update={"stage": 2})


@pytest.fixture
def train(drives, tiny_config, tmp_path):
    """Train both stages on the fabricated drives; returns the results and the folder."""

    def batches(epoch, size):
        keys = sorted(drives)
        return [keys[start : start + size] for start in range(0, len(keys), size)]

    def run(first=STAGE_1, second=STAGE_2, name="run"):
        out = tmp_path / name
        results = train_two_stages(
            (first, second), batches, lambda keys: [drives[key] for key in keys], out, tiny_config
        )
        return results, out

    return run


def test_equal_trainings_give_equal_bytes(train):
    augmented = {"mirror_probability": 0.5, "turn_degrees": 4.0, "move_metres": 0.5}
    stages = [
        STAGE_1.model_copy(update={**augmented, "hidden_token_probability": 0.5, "regression_warmup_epochs": 1}),
        STAGE_2.model_copy(update=augmented),
    ]
    (_, one), (_, two) = train(*stages, name="one"), train(*stages, name="two")
    for part in ("stage1", "policy"):
        assert (one / part / "model.safetensors").read_bytes() == (two / part / "model.safetensors").read_bytes()


def test_stage_2_trains_the_expert_and_nothing_else(train):
    _, out = train()
    before, after = read_tensors(out / "stage1"), read_tensors(out / "policy")
    vlm = [name for name in before if name.startswith("vlm.")]
    assert vlm and all(torch.equal(before[name], after[name]) for name in vlm)
    expert = [name for name in before if name.startswith("expert.")]
    assert any(not torch.equal(before[name], after[name]) for name in expert)


def test_accumulated_batches_make_one_step(train):
    halves = {"per_device_train_batch_size": 2, "gradient_accumulation_steps": 2}
    (results, _) = train(STAGE_1.model_copy(update=halves), STAGE_2, name="halves")
    assert [result.steps for result in results] == [12, 12]


def test_training_overfits_a_handful_of_drives(train, drives):
    first = STAGE_1.model_copy(update={"num_train_epochs": 40})
    second = STAGE_2.model_copy(update={"num_train_epochs": 120})
    results, out = train(first, second)
    assert results[0].final_loss < 0.6 * results[0].losses[0]
    assert results[1].final_loss < 0.3 * results[1].losses[0]
    errors = evaluate_open_loop(ToyPolicy(read_model(out / "policy")), drives.values(), plans_per_sample=2)
    straight_on = np.mean([np.abs(sample.ego_future_xyz[0, :, 1]).mean() for sample in drives.values()])
    assert errors["min_ade"] < 0.5 * straight_on


def test_a_finished_stage_is_kept_and_a_changed_one_is_trained_again(train):
    _, out = train()
    weights = out / "policy" / "model.safetensors"
    written = weights.stat().st_mtime_ns
    results, _ = train()
    assert weights.stat().st_mtime_ns == written
    assert results[1].steps == 12
    train(STAGE_1, STAGE_2.model_copy(update={"learning_rate": 1e-3}))
    assert weights.stat().st_mtime_ns != written


def test_what_other_code_trained_is_trained_again(train, monkeypatch):
    _, out = train()
    weights = out / "policy" / "model.safetensors"
    written = weights.stat().st_mtime_ns
    monkeypatch.setattr("olt_sft_recipes.training.two_stages.code_version", lambda: "another")
    train()
    assert weights.stat().st_mtime_ns != written


def test_stage_2_refuses_a_checkpoint_whose_names_do_not_match(train, drives, tmp_path):
    _, out = train()
    folder = out / "stage1"
    config = json.loads((folder / "config.json").read_text())
    config["layers"] = 1
    (folder / "config.json").write_text(json.dumps(config))
    with pytest.raises(InputError, match="unknown"):
        train_stage(
            STAGE_2,
            lambda epoch, size: [sorted(drives)],
            lambda keys: [drives[key] for key in keys],
            folder,
            tmp_path / "other",
        )


def test_stage_2_needs_a_checkpoint(drives, tmp_path):
    with pytest.raises(InputError, match="Stage 1 folder"):
        train_stage(
            STAGE_2,
            lambda epoch, size: [sorted(drives)],
            lambda keys: [drives[k] for k in keys],
            None,
            tmp_path / "out",
        )


def test_stages_in_the_wrong_order_are_refused(train):
    with pytest.raises(InputError, match="stage 1, then stage 2"):
        train(STAGE_2, STAGE_1)


def test_a_model_survives_its_folder(train):
    _, out = train()
    model = read_model(out / "policy")
    save_model(out / "copy", model)
    copy = (out / "copy" / "model.safetensors").read_bytes()
    assert copy == (out / "policy" / "model.safetensors").read_bytes()
