import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from olt_generator.errors import InputError
from olt_sft_recipes.toy.action_expert import SPREAD
from olt_sft_recipes.toy.checkpoint import ToyModel, read_model, save_model
from olt_sft_recipes.toy.image_encoder import IMAGE_TOKENS
from olt_sft_recipes.toy.inputs import encode_inputs
from olt_sft_recipes.toy.plan_choice import WAY_WORTH
from olt_sft_recipes.toy.policy import ToyPolicy, load_toy
from olt_sft_recipes.training.driving_samples import DrivingSamples
from olt_toolkit.policy.contract import Observation

from ...fuzzing import SECONDS


@pytest.fixture(scope="module")
def model(tiny_config):
    torch.manual_seed(0)
    return ToyModel(tiny_config)


@pytest.fixture(scope="module")
def inputs(drives, tiny_config):
    samples = DrivingSamples.gather(list(drives.values())[:2], tiny_config)
    return encode_inputs(samples.images, samples.history, samples.routes, tiny_config)


def observe(sample, seed):
    return Observation(
        images=sample.image_frames,
        camera_indices=sample.camera_indices,
        history_xyz=sample.ego_history_xyz[0].astype(float),
        history_rotation=sample.ego_history_rot[0].astype(float),
        route_xy=np.zeros((0, 2)),
        time_us=sample.t0_us,
        seed=seed,
    )


def test_a_token_depends_only_on_the_tokens_before_it(model, inputs):
    tokens = torch.zeros(2, 128, dtype=torch.long)
    changed = tokens.clone()
    changed[:, 60] = 1234
    nothing_hidden = torch.zeros(2, 128, dtype=torch.bool)
    with torch.no_grad():
        before, *_ = model.vlm(inputs, tokens, nothing_hidden)
        after, *_ = model.vlm(inputs, changed, nothing_hidden)
    assert torch.equal(before[:, :61], after[:, :61])
    assert not torch.allclose(before[:, 61:], after[:, 61:])


def test_a_hidden_token_is_not_seen(model, inputs):
    tokens = torch.zeros(2, 128, dtype=torch.long)
    changed = tokens.clone()
    changed[:, 60] = 1234
    hidden = torch.zeros(2, 128, dtype=torch.bool)
    hidden[:, 60] = True
    with torch.no_grad():
        assert torch.equal(model.vlm(inputs, tokens, hidden)[0], model.vlm(inputs, changed, hidden)[0])


def test_the_expert_sees_the_prefix_and_nothing_after_it(model, inputs, tiny_config):
    prefix_length = IMAGE_TOKENS + 48 + 1
    for keys, values in model.vlm.read_prefix(inputs).cache:
        assert keys.shape == values.shape == (2, tiny_config.heads, prefix_length, tiny_config.head_width)
        assert not keys.requires_grad


def test_a_plan_is_a_pure_function_of_the_observation(model, drives):
    policy, sample = ToyPolicy(model), next(iter(drives.values()))
    first, again = (policy.plan(observe(sample, 1)) for _ in range(2))
    drawn, other = (policy.draw(observe(sample, seed)).xyz[1] for seed in (1, 2))
    assert first.xyz.shape == (64, 3) and first.rotation.shape == (64, 3, 3)
    assert np.array_equal(first.xyz, again.xyz) and not np.array_equal(drawn, other)


def test_nobody_chooses_by_a_sight_that_never_learned(model, drives, monkeypatch):
    monkeypatch.setattr("olt_sft_recipes.toy.policy.choose_plan", lambda plans, *_: np.full((64, 3), 7.0))
    sample = next(iter(drives.values()))
    assert not np.array_equal(ToyPolicy(model).plan(observe(sample, 1)).xyz[:, 0], np.full(64, 7.0))
    model.vlm.sight_taught.fill_(1.0)
    try:
        assert np.array_equal(ToyPolicy(model).plan(observe(sample, 1)).xyz[:, 0], np.full(64, 7.0))
    finally:
        model.vlm.sight_taught.fill_(0.0)


def test_how_long_it_has_stood_is_forgotten_with_the_rollout(model, drives, monkeypatch):
    asked = []
    monkeypatch.setattr(
        "olt_sft_recipes.toy.policy.choose_plan", lambda plans, speed, seen, worth: asked.append(worth) or plans[0]
    )
    seen = replace(observe(next(iter(drives.values())), 1), history_xyz=np.zeros((16, 3)))
    model.vlm.sight_taught.fill_(1.0)
    try:
        policy = ToyPolicy(model)
        for seconds in (0, 10):
            policy.plan(replace(seen, time_us=seconds * 1_000_000))
        policy.reset(0, "another")
        policy.plan(replace(seen, time_us=10_000_000))
    finally:
        model.vlm.sight_taught.fill_(0.0)
    assert asked[0] == asked[2] == WAY_WORTH < asked[1]


def test_an_observation_without_images_is_refused(model, drives):
    blind = observe(next(iter(drives.values())), 0)
    blind = Observation(None, *(getattr(blind, name) for name in list(vars(blind))[1:]))
    with pytest.raises(InputError, match="images"):
        ToyPolicy(model).plan(blind)


def test_a_saved_model_comes_back_equal(model, tmp_path):
    save_model(tmp_path / "policy", model)
    back = read_model(tmp_path / "policy")
    assert all(map(torch.equal, model.state_dict().values(), back.state_dict().values()))


@pytest.mark.parametrize("damage", ["no folder", "no weights", "broken config", "unknown size", "other weights"])
def test_a_damaged_folder_is_told(model, tmp_path, damage):
    folder = tmp_path / "policy"
    if damage != "no folder":
        save_model(folder, model)
    if damage == "no weights":
        (folder / "model-00001-of-00001.safetensors").unlink()
    if damage == "broken config":
        (folder / "config.json").write_text("{")
    if damage == "unknown size":
        (folder / "config.json").write_text(json.dumps({"depth": 3}))
    if damage == "other weights":
        config = model.config.model_copy(update={"layers": 3})
        (folder / "config.json").write_text(config.model_dump_json())
    with pytest.raises(InputError, match="policy"):
        load_toy(str(folder))


FILES = ["config.json", "model.safetensors.index.json", "model-00001-of-00001.safetensors"]


@pytest.mark.parametrize("name", FILES)
def test_a_checkpoint_with_a_damaged_file(fuzzer, model, tmp_path, name):
    save_model(tmp_path / "policy", model)
    fuzzer.run("checkpoint", tmp_path / "policy" / name, tmp_path / "policy")


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_a_checkpoint_with_a_damaged_file_for_long(fuzzer, model, tmp_path, name):
    save_model(tmp_path / "policy", model)
    fuzzer.run("checkpoint", tmp_path / "policy" / name, tmp_path / "policy", seconds=SECONDS)


def test_the_policy_needs_a_folder():
    with pytest.raises(InputError, match="toy:FOLDER"):
        load_toy(None)


def test_before_stage_2_the_expert_plans_what_the_frozen_model_regresses(model, inputs):
    prefix = model.vlm.read_prefix(inputs)
    planned = model.expert.sample(torch.zeros(2, 64, 2), prefix)
    assert torch.allclose(planned, prefix.regressed, atol=1e-5)


def test_draws_of_an_untrained_expert_spread_around_the_regression(model, drives, tiny_config):
    sample = DrivingSamples.gather(list(drives.values())[:1], tiny_config)
    prefix = model.vlm.read_prefix(encode_inputs(sample.images, sample.history, sample.routes, tiny_config))
    prefix = prefix.repeated(400)
    fine = model.expert
    fine.integration_steps, before = 50, fine.integration_steps
    try:
        drawn = fine.sample(torch.randn(400, 64, 2, generator=torch.Generator().manual_seed(0)), prefix)
    finally:
        fine.integration_steps = before
    assert (drawn - prefix.regressed).std().item() == pytest.approx(SPREAD, rel=0.1)
