"""Faults planted into checkpoint folders and vocabularies: each is found."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file

from olt_generator.errors import InputError
from olt_sft_recipes.preflight.check import check
from olt_sft_recipes.preflight.plan import PreflightPlan, recipe_stages
from olt_sft_recipes.preflight.rows import Verdict
from olt_sft_recipes.preflight.safetensors_files import read_header, same_start

from .conftest import release_config, tensor_shapes, write_checkpoint

SHARD = "model-00002-of-00003.safetensors"
INDEX = "model.safetensors.index.json"
LAYER = "vlm.model.language_model.layers.1.mlp.up_proj.weight"


def failures(stages=None, **folders):
    plan = PreflightPlan("alpamayo-r1", recipe_stages("alpamayo-r1"), gpus=8, **folders)
    rows = check(plan if stages is None else replace(plan, stages=stages)).rows
    failed = [row for row in rows if row.group == "checkpoint" and row.verdict is Verdict.FAILED]
    return [f"{row.check}: {row.where}: {row.found}; {row.action}" for row in failed]


def edit_json(path, change):
    content = json.loads(path.read_text())
    path.write_text(json.dumps(change(content) or content))


def edit_shard(folder, change, shard=SHARD):
    tensors = load_file(folder / shard)
    change(tensors)
    save_file(tensors, folder / shard)


def test_clean_folders_have_no_failures(folders):
    assert not failures(**folders)


def test_a_shard_that_is_missing_cut_off_or_longer(folders):
    path = folders["base"] / SHARD
    content = path.read_bytes()
    path.unlink()
    assert any("base shards" in each and SHARD in each for each in failures(**folders))
    path.write_bytes(content[:-1])
    assert any("its header says" in each and "cut off" in each for each in failures(**folders))
    path.write_bytes(content + b"\0")
    assert any("something was appended" in each for each in failures(**folders))


def test_an_index_that_is_missing(folders):
    (folders["base"] / INDEX).unlink()
    assert any(each.startswith("base index") and "no such file" in each for each in failures(**folders))


def test_a_single_file_without_index_is_refused_and_beside_one_too(folders):
    stage1 = folders["stage1"]
    tensors = {}
    for path in sorted(stage1.glob("model-*.safetensors")):
        tensors |= load_file(path)
    save_file(tensors, stage1 / "model.safetensors")
    assert any("stage 1 stray file" in each and "instead of the shards" in each for each in failures(**folders))
    for path in [*stage1.glob("model-*.safetensors"), stage1 / INDEX]:
        path.unlink()
    found = failures(**folders)
    assert any("stands alone" in each and "small shard size" in each for each in found)


@pytest.mark.parametrize(
    "name", [LAYER, "vlm.model.language_model.layers.2.mlp.up_proj.weight", "expert.layers.0.mlp.up_proj.weight"]
)
def test_a_tensor_that_neither_shards_nor_index_have(tmp_path, name):
    shapes = tensor_shapes()
    del shapes[name]
    base = write_checkpoint(tmp_path / "base", shapes, release_config())
    assert any(each.startswith("base layers") and f"{name} is missing" in each for each in failures(base=base))


def test_a_layer_that_is_missing_whole(tmp_path):
    shapes = {name: shape for name, shape in tensor_shapes().items() if ".language_model.layers.1." not in name}
    base = write_checkpoint(tmp_path / "base", shapes, release_config())
    assert any("layer 1 of 3 is missing" in each for each in failures(base=base))


def test_tensors_that_index_and_shard_do_not_share(folders):
    edit_shard(folders["base"], lambda tensors: tensors.pop(next(iter(tensors))))
    assert any("it lacks" in each for each in failures(**folders))
    edit_shard(folders["base"], lambda tensors: tensors.update(strange=torch.zeros(2)))
    assert any("tensors differ" in each for each in failures(**folders))


@pytest.mark.parametrize("prefix", ["vlm.", "expert.", "action_in_proj.", "action_out_proj."])
def test_a_part_of_the_release_that_is_missing(tmp_path, prefix):
    shapes = {name: shape for name, shape in tensor_shapes().items() if not name.startswith(prefix)}
    base = write_checkpoint(tmp_path / "base", shapes, release_config())
    assert any(f"no tensor {prefix}*" in each for each in failures(base=base))


@pytest.mark.parametrize("name", ["vlm.lm_head.weight", "expert.norm.weight", "vlm.model.visual.pos_embed.weight"])
def test_a_tensor_outside_of_layers_that_is_missing(tmp_path, name):
    shapes = tensor_shapes()
    del shapes[name]
    base = write_checkpoint(tmp_path / "base", shapes, release_config())
    assert any(f"no tensor {name}" in each for each in failures(base=base))


def test_a_last_layer_that_is_missing_whole(tmp_path):
    shapes = {name: shape for name, shape in tensor_shapes().items() if ".language_model.layers.2." not in name}
    base = write_checkpoint(tmp_path / "base", shapes, release_config())
    assert any("2 of vlm.model.language_model.layers, 3 of expert.layers" in each for each in failures(base=base))


def test_weights_of_another_type_than_the_configuration_says(tmp_path):
    base = write_checkpoint(tmp_path / "base", tensor_shapes(), release_config(), dtype=torch.float32)
    assert any(each.startswith("base dtype") and "is F32" in each for each in failures(base=base))


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("min_pixels", None, "min_pixels is None, not 163840"),
        ("max_pixels", 1_000_000, "max_pixels is 1000000"),
        ("tokens_per_history_traj", 45, "tokens_per_history_traj is 45, not 48"),
        ("tokens_per_future_traj", 64, "tokens_per_future_traj is 64"),
        ("traj_vocab_size", 768, "traj_vocab_size is 768"),
        ("traj_token_start_idx", 151_643, "traj_token_start_idx is 151643"),
        ("traj_tokenizer_cfg", {"num_bins": 1000}, "traj_tokenizer_cfg.num_bins is 1000"),
        ("hist_traj_tokenizer_cfg", None, "hist_traj_tokenizer_cfg is absent"),
        ("add_special_tokens", False, "has 155697 rows, not 155675"),
        ("vocab_size", 151_936, "vocab_size is 151936"),
        ("model_type", "qwen3_vl", "model_type is 'qwen3_vl'"),
    ],
)
def test_a_configuration_that_is_not_the_releases(folders, key, value, said):
    edit_json(folders["base"] / "config.json", lambda content: content | {key: value})
    found = failures(**folders)
    assert any(said in each for each in found), found


def test_limits_of_pixels_that_are_absent(folders):
    edit_json(folders["base"] / "config.json", lambda content: content.pop("max_pixels") and None)
    assert any("max_pixels is absent" in each and "2,040 tokens" in each for each in failures(**folders))


def test_stage_2_alone_needs_stage_1(clean_base):
    assert any(
        each.startswith("stage 1: --stage1") for each in failures((recipe_stages("alpamayo-r1")[1],), base=clean_base)
    )


def test_a_stage_1_that_is_the_base_or_did_not_train(folders):
    assert any(
        "did not train, or this is the base" in each for each in failures(base=folders["base"], stage1=folders["base"])
    )


def test_a_stage_1_that_lacks_a_tensor_or_has_other_shapes(folders):
    edit_json(folders["stage1"] / INDEX, lambda content: content["weight_map"].pop(LAYER) and None)
    for path in folders["stage1"].glob("*.safetensors"):
        edit_shard(folders["stage1"], lambda tensors: tensors.pop(LAYER, None), path.name)
    assert any("stage 1 fits" in each and "1 of" in each and "are missing" in each for each in failures(**folders))


@pytest.mark.parametrize("dtype", [torch.int32, torch.float64])
def test_a_stage_1_of_a_type_that_is_no_type_of_weights(folders, dtype):
    for path in folders["stage1"].glob("*.safetensors"):
        save_file({name: tensor.to(dtype) for name, tensor in load_file(path).items()}, path)
    assert any(each.startswith("stage 1 fits") and "the base has BF16" in each for each in failures(**folders))


@pytest.mark.parametrize("folder", ["base", "stage1"])
@pytest.mark.parametrize("change", [{"max_pixels": None}, {"min_pixels": "163840"}, {"max_pixels": 163_840}])
def test_a_pixel_budget_in_only_one_of_two_configurations(folders, folder, change):
    edit_json(folders[folder] / "config.json", lambda content: content | change)
    (found,) = failures(**folders)
    assert found.startswith("pixel limits" if folder == "base" else "stage 1 pixel limits") and "write both" in found


@pytest.mark.parametrize(
    "change",
    [
        {"traj_token_start_idx": 151_936},  # behind the padded vocabulary of Qwen
        {"traj_vocab_size": 768},
        {"hist_traj_tokenizer_cfg": {"num_bins": 3000}},
        {"tokens_per_history_traj": 45},
    ],
)
def test_a_stage_1_whose_tokens_are_not_those_of_the_base(folders, change):
    for name in ("base", "stage1"):
        edit_json(folders[name] / "config.json", lambda content: content | {"traj_token_start_idx": 151_669})
    assert not failures(**folders)
    edit_json(folders["stage1"] / "config.json", lambda content: content | change)
    (found,) = failures(**folders)
    assert found.startswith("stage 1 tokens") and next(iter(change)) in found and "in the base" in found


def test_a_stage_1_that_is_the_base_in_another_type_did_not_train(folders, tmp_path):
    tensors = {}
    for path in sorted(folders["base"].glob("*.safetensors")):
        tensors |= {name: tensor.float() for name, tensor in load_file(path).items() if name.startswith("vlm.")}
    stage1 = folders["stage1"]
    for path in stage1.glob("*.safetensors"):
        save_file({name: tensors[name] for name in load_file(path)}, path)
    (found,) = failures(**folders)
    assert found.startswith("stage 1 trained") and "did not train, or this is the base" in found
    for path in stage1.glob("*.safetensors"):
        save_file({name: tensor * 1.01 for name, tensor in load_file(path).items()}, path)
    assert not failures(**folders)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_stage_1_whose_weights_are_not_finite(folders, value):
    def spoil(tensors):
        for tensor in tensors.values():
            tensor.view(-1)[0] = value

    for path in folders["stage1"].glob("*.safetensors"):
        edit_shard(folders["stage1"], spoil, path.name)
    (found,) = failures(**folders)
    assert found.startswith("stage 1 trained") and "16 tensors hold NaN or infinite values, as lm_head.weight" in found


@pytest.mark.parametrize(
    ("state", "verdict", "said"),
    [
        ({"global_step": 7, "max_steps": 7}, Verdict.PASSED, "step 7 of 7"),
        ({"global_step": 7, "max_steps": 1149}, Verdict.NOTE, "step 7 of 1149: not its last"),
        ({"global_step": 1149, "max_steps": 1149}, Verdict.FAILED, "called checkpoint-7, and was written at step 1149"),
        ({}, Verdict.NOT_CHECKED, "neither global_step"),
        ([], Verdict.NOT_CHECKED, "neither global_step"),
    ],
)
def test_how_far_stage_1_was_trained_is_told(folders, state, verdict, said):
    (folders["stage1"] / "trainer_state.json").write_text(json.dumps(state))
    plan = PreflightPlan("alpamayo-r1", recipe_stages("alpamayo-r1"), **folders)
    (row,) = [row for row in check(plan).rows if row.check == "stage 1 finished"]
    assert row.verdict is verdict and said in row.found


def test_a_stage_1_with_adapters_must_be_merged(folders):
    adapter = "vlm.model.language_model.layers.{}.self_attn.q_proj.lora_A.default.weight"
    shard = "model-00002-of-00002.safetensors"
    names = [adapter.format(layer) for layer in range(3)]
    edit_shard(folders["stage1"], lambda tensors: tensors.update({name: torch.zeros(2, 2) for name in names}), shard)
    edit_json(
        folders["stage1"] / INDEX, lambda content: content["weight_map"].update(dict.fromkeys(names, shard)) and None
    )
    (found,) = failures(**folders)
    assert found.startswith("stage 1 adapters") and "3 tensors" in found and "merge them" in found


def test_an_index_that_lacks_the_expert_though_a_shard_holds_it(folders):
    def lose(content):
        names = content["weight_map"]
        return {"weight_map": {name: file for name, file in names.items() if not name.startswith("expert.")}}

    edit_json(folders["base"] / INDEX, lose)
    assert any(
        "base shards" in each and "holds, and the index does not, expert." in each for each in failures(**folders)
    )


def test_an_index_that_names_a_shard_which_is_not_there(folders):
    def rename(content):
        content["weight_map"]["expert.norm.weight"] = "model-00004-of-00004.safetensors"

    edit_json(folders["base"] / INDEX, rename)
    found = failures(**folders)
    assert any("base shards" in each and "model-00004-of-00004.safetensors" in each for each in found)


@settings(max_examples=50)
@given(hnp.arrays(np.float32, st.integers(1, 40), elements=st.floats(-1e4, 1e4, width=32)))
def test_starts_of_tensors_are_compared_at_the_coarser_precision(tmp_path_factory, values):
    path = tmp_path_factory.mktemp("types") / "some.safetensors"
    whole = torch.from_numpy(values)
    types = {"whole": torch.float32, "brain": torch.bfloat16, "half": torch.float16}
    save_file({name: whole.to(dtype) for name, dtype in types.items()}, path)
    stored = read_header(path)
    for name, dtype in types.items():
        assert same_start(stored["whole"], stored[name], 64) and same_start(stored[name], stored["whole"], 64)
        other = (whole + 1.0 + whole.abs()).to(dtype)
        save_file({"other": other}, path.with_name("other.safetensors"))
        assert not same_start(stored["whole"], read_header(path.with_name("other.safetensors"))["other"], 64)


def test_names_of_stage_1_without_prefix_are_taken_too(folders):
    stage1 = folders["stage1"]
    for path in stage1.glob("*.safetensors"):
        save_file({name.removeprefix("vlm."): tensor for name, tensor in load_file(path).items()}, path)
    edit_json(
        stage1 / INDEX,
        lambda content: {"weight_map": {k.removeprefix("vlm."): v for k, v in content["weight_map"].items()}},
    )
    assert not failures(**folders)


@pytest.mark.parametrize("name", ["tokenizer.json", "tokenizer_config.json", "preprocessor_config.json", "config.json"])
def test_a_file_of_the_processor_that_is_missing(folders, name):
    (folders["vlm"] / name).unlink()
    assert any(each.startswith("vlm processor") and name in each for each in failures(**folders))


def test_a_vocabulary_that_moves_the_trajectory_tokens(folders):
    path = folders["vlm"] / "tokenizer.json"
    whole = path.read_text()
    edit_json(path, lambda content: content["added_tokens"].pop() and None)
    assert any("<i0> has or would get id 151668" in each for each in failures(**folders))
    path.write_text(whole)
    edit_json(path, lambda content: content["added_tokens"].append({"id": 151_669, "content": "<i0>"}))
    assert any("1 of 4000 trajectory tokens are in it already" in each for each in failures(**folders))
    path.write_text(whole)
    ids = [{"id": 151_669 + number, "content": f"<i{number}>"} for number in range(4000)]
    edit_json(path, lambda content: content["added_tokens"].extend(ids))
    assert not failures(**folders)
    edit_json(path, lambda content: content["added_tokens"][-1].update(id=160_000))
    assert any("do not follow each other" in each for each in failures(**folders))


@settings(max_examples=15)
@given(data=st.data())
def test_any_file_that_is_missing_or_cut_off_is_found(clean_base, clean_stage1, clean_vlm, tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("damaged")
    clean = {"base": clean_base, "stage1": clean_stage1, "vlm": clean_vlm}
    name = data.draw(st.sampled_from(sorted(clean)))
    copy = shutil.copytree(clean[name], folder / name)
    path = data.draw(st.sampled_from(sorted(copy.iterdir())))
    size = path.stat().st_size
    kept = data.draw(st.none() | st.integers(0, size - 1))
    content = path.read_bytes()
    path.unlink()
    if kept is not None:
        path.write_bytes(content[:kept])
    assert failures(**{name: copy})


@settings(max_examples=200)
@given(place=st.integers(0, 400), byte=st.integers(0, 255), cut=st.integers(0, 60))
def test_headers_are_refused_as_the_library_refuses_them(tmp_path_factory, place, byte, cut):
    """What this reader takes the library takes too, with the same names, types and shapes."""
    path = tmp_path_factory.mktemp("header") / "some.safetensors"
    save_file({"a": torch.ones(2, 3), "b": torch.zeros(4, dtype=torch.bfloat16)}, path)
    content = bytearray(path.read_bytes())
    content[place % len(content)] = byte
    path.write_bytes(content[: len(content) - (cut if cut < 20 else 0)])
    try:
        with safe_open(path, "pt") as file:
            known = {name: tuple(file.get_slice(name).get_shape()) for name in file.keys()}  # noqa: SIM118
    except SafetensorError:
        known = None
    try:
        found = {name: tensor.shape for name, tensor in read_header(path).items()}
    except InputError:
        found = None
    assert found is None or found == known
    if not cut and bytes(content) == path.read_bytes() and known is not None and found is None:
        assert place % len(content) < 8 + int.from_bytes(content[:8], "little")  # stricter in the header alone
