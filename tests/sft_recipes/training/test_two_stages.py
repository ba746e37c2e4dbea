import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from olt_generator.errors import InputError
from olt_sft_recipes.open_loop import evaluate_open_loop
from olt_sft_recipes.toy.checkpoint import read_model, read_tensors, save_model
from olt_sft_recipes.toy.policy import ToyPolicy
from olt_sft_recipes.training.stage_config import StageConfig
from olt_sft_recipes.training.two_stages import train_stage, train_two_stages
from olt_toolkit.rigs.contracts import find_contract

WEIGHTS = "model-00001-of-00001.safetensors"
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
    for part in ("stage1/checkpoint-12", "stage2/checkpoint-12", "policy"):
        assert (one / part / WEIGHTS).read_bytes() == (two / part / WEIGHTS).read_bytes()


def test_stage_2_trains_the_expert_and_nothing_else(train):
    _, out = train()
    before, after = read_tensors(out / "stage1/checkpoint-12"), read_tensors(out / "policy")
    vlm = [name for name in before if name.startswith("vlm.")]
    assert vlm and all(torch.equal(before[name], after[name]) for name in vlm)
    expert = [name for name in before if name.startswith("expert.")]
    assert any(not torch.equal(before[name], after[name]) for name in expert)


def test_accumulated_batches_make_one_step(train):
    halves = {"per_device_train_batch_size": 2, "gradient_accumulation_steps": 2}
    (results, _) = train(STAGE_1.model_copy(update=halves), STAGE_2, name="halves")
    assert [result.steps for result in results] == [12, 12]


def invented(sample, share):
    """The sample with so large a part of all its images invented, from the left."""
    origin = np.ones((*sample.image_frames.shape[:2], *sample.image_frames.shape[-2:]), np.uint8)
    origin[..., : round(share * origin.shape[-1])] = 0
    return replace(sample, image_origin=origin)


@pytest.mark.parametrize("parts", [1, 3])
def test_samples_count_by_what_of_them_was_seen(drives, tiny_config, tmp_path, parts):
    """Of half of the samples everything is invented: at weight 0 the loss is that of the other half alone."""
    keys = sorted(drives)
    half = keys[: len(keys) // 2]
    marked = {key: invented(drives[key], 1.0 if key in half else 0.0) for key in keys}
    seen = [key for key in keys if key not in half]

    def first_loss(name, chosen, weight):
        update = {"warmup_steps": 0, "invented_pixel_weight": weight}
        update |= {"per_device_train_batch_size": len(chosen), "gradient_accumulation_steps": parts}
        # The regression head alone: its loss draws nothing at random, so that it is the same in any company.
        update |= {"num_train_epochs": 2, "regression_warmup_epochs": 1}
        stage = STAGE_1.model_copy(update=update)
        result = train_stage(
            stage, lambda *_: [chosen], lambda asked: [marked[key] for key in asked], None, tmp_path / name, tiny_config
        )
        return result.regression_warmup_losses[0]

    alike, weighted, alone = first_loss("a", keys, 1.0), first_loss("b", keys, 0.0), first_loss("c", seen, 1.0)
    others = first_loss("d", half, 1.0)
    assert weighted == pytest.approx(alone, abs=2e-6)
    assert alike == pytest.approx(0.5 * (alone + others), abs=2e-6)
    assert abs(alike - weighted) > 1e-3
    quarter = first_loss("e", keys, 0.25)
    assert quarter == pytest.approx((alone + 0.25 * others) / 1.25, abs=2e-6)


def test_weights_change_nothing_where_all_samples_are_alike(train, drives):
    (plain, _), (weighted, _) = (
        train(*(stage.model_copy(update={"invented_pixel_weight": weight}) for stage in (STAGE_1, STAGE_2)), name=name)
        for name, weight in (("one", 1.0), ("half", 0.5))
    )
    for one, other in zip(plain, weighted, strict=True):
        np.testing.assert_allclose(one.losses, other.losses, atol=1e-5)


def test_six_cameras_are_trained_and_driven(drives, tiny_config, tmp_path):
    keys = sorted(drives)
    six = {key: replace(sample, image_frames=sample.image_frames[[0, 1, 2, 0, 2, 3]]) for key, sample in drives.items()}
    config = tiny_config.model_copy(update={"rig": "alpamayo-2"})
    augmented = {"mirror_probability": 0.5, "turn_degrees": 4.0, "move_metres": 0.5, "num_train_epochs": 1}
    stages = tuple(stage.model_copy(update=augmented) for stage in (STAGE_1, STAGE_2))
    train_two_stages(stages, lambda *_: [keys], lambda asked: [six[key] for key in asked], tmp_path, config)
    policy = ToyPolicy(read_model(tmp_path / "policy"))
    assert policy.cameras == find_contract("alpamayo-2").cameras
    assert evaluate_open_loop(policy, six.values())["ade"] > 0.0


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
    weights = out / "policy" / WEIGHTS
    written = weights.stat().st_mtime_ns
    results, _ = train()
    assert weights.stat().st_mtime_ns == written
    assert results[1].steps == 12
    train(STAGE_1, STAGE_2.model_copy(update={"learning_rate": 1e-3}))
    assert weights.stat().st_mtime_ns != written


def test_what_other_code_trained_is_trained_again(train, monkeypatch):
    _, out = train()
    weights = out / "policy" / WEIGHTS
    written = weights.stat().st_mtime_ns
    monkeypatch.setattr("olt_sft_recipes.training.two_stages.code_version", lambda: "another")
    train()
    assert weights.stat().st_mtime_ns != written


def test_stage_2_refuses_a_checkpoint_whose_names_do_not_match(train, drives, tmp_path):
    _, out = train()
    folder = out / "stage1/checkpoint-12"
    config = json.loads((folder / "config.json").read_text())
    config["layers"] = 1
    (folder / "config.json").write_text(json.dumps(config))
    with pytest.raises(InputError, match="unknown"):
        read_model(folder)
    state = json.loads((folder / "trainer_state.json").read_text())
    (folder / "trainer_state.json").write_text(json.dumps({**state, "files": {}}))
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
    copy = (out / "copy" / WEIGHTS).read_bytes()
    assert copy == (out / "policy" / WEIGHTS).read_bytes()
