"""A small export, checkpoint folders in the real format, and an environment that answers as the recipe's would."""

import json
import shutil
import stat
import sys
from dataclasses import replace

import pytest
import torch
from safetensors.torch import save_file

from olt_datasets import contents_of_stores, export_pai
from olt_sft_recipes.preflight.check import check
from olt_sft_recipes.preflight.plan import PreflightPlan, recipe_stages
from olt_sft_recipes.preflight.profiles import PROFILES
from olt_toolkit.rigs.contracts import find_contract

from ...straight_clips import straight_clip, write_clips

WIDTH, LAYERS, HEADS, HEAD = 8, 3, 2, 4


def _export(folder, policy, *chunks):
    """Straight drives of 12.5 s with images from 4.6 to 5.4 s, so that 5.1 s is a sample, in the recipe's layout."""
    contract = find_contract(policy)
    clips = [[straight_clip(name, 126, slice(46, 55), cameras=contract.cameras) for name in names] for names in chunks]
    store = write_clips(folder / "store", *clips)
    export_pai(contents_of_stores([store], "train", contract), folder / "pai", verify=False)
    return folder / "pai"


@pytest.fixture(scope="session")
def clean_export(tmp_path_factory):
    """Three clips in two chunks, in the recipe's layout; not to be changed."""
    return _export(tmp_path_factory.mktemp("export"), "alpamayo-r1", ["a", "b"], ["c"])


@pytest.fixture(scope="session")
def wide_export(tmp_path_factory):
    """One clip with the six cameras of Alpamayo 2."""
    return _export(tmp_path_factory.mktemp("wide"), "alpamayo-2", ["a"])


@pytest.fixture
def export(clean_export, tmp_path):
    """A copy of it that may be damaged."""
    return _copy(clean_export, tmp_path / "pai")


def _copy(source, target):
    shutil.copytree(source, target, symlinks=False)
    for path in target.rglob("*"):
        path.chmod(path.stat().st_mode | stat.S_IWUSR)
    return target


def layer(prefix, width, inner):
    """The tensors of one decoder layer of Qwen3, as shapes."""
    heads, keys = HEADS * HEAD, HEAD
    return {
        f"{prefix}.self_attn.q_proj.weight": (heads, width),
        f"{prefix}.self_attn.k_proj.weight": (keys, width),
        f"{prefix}.self_attn.v_proj.weight": (keys, width),
        f"{prefix}.self_attn.o_proj.weight": (width, heads),
        f"{prefix}.self_attn.q_norm.weight": (HEAD,),
        f"{prefix}.self_attn.k_norm.weight": (HEAD,),
        f"{prefix}.mlp.gate_proj.weight": (inner, width),
        f"{prefix}.mlp.up_proj.weight": (inner, width),
        f"{prefix}.mlp.down_proj.weight": (width, inner),
        f"{prefix}.input_layernorm.weight": (width,),
        f"{prefix}.post_attention_layernorm.weight": (width,),
    }


def tensor_shapes(rows=155_697):
    """Shapes of a whole, tiny release by name."""
    shapes = {"vlm.model.language_model.embed_tokens.weight": (rows, 2), "vlm.lm_head.weight": (rows, 2)}
    for number in range(LAYERS):
        shapes |= layer(f"vlm.model.language_model.layers.{number}", WIDTH, 24)
        shapes |= layer(f"expert.layers.{number}", 4, 12)
        block = f"vlm.model.visual.blocks.{number}"
        shapes |= {f"{block}.norm1.weight": (6,), f"{block}.mlp.linear_fc1.weight": (16, 6)}
    return shapes | {
        "vlm.model.language_model.norm.weight": (WIDTH,),
        "vlm.model.visual.patch_embed.proj.weight": (6, 3, 2, 2, 2),
        "vlm.model.visual.pos_embed.weight": (9, 6),
        "expert.norm.weight": (4,),
        "action_in_proj.norm.weight": (4,),
        "action_out_proj.weight": (2, 4),
    }


def write_checkpoint(folder, shapes, config, shards=3, seed=0, dtype=torch.bfloat16):
    """A folder with config, index and shards, of drawn weights."""
    folder.mkdir(parents=True)
    generator = torch.Generator().manual_seed(seed)
    names, files = sorted(shapes), {}
    for number in range(shards):
        file = f"model-{number + 1:05d}-of-{shards:05d}.safetensors"
        of_shard = names[number::shards]
        tensors = {name: torch.rand(shapes[name], generator=generator).to(dtype) for name in of_shard}
        save_file(tensors, folder / file, metadata={"format": "pt"})
        files |= dict.fromkeys(of_shard, file)
    index = {"metadata": {"total_size": 0}, "weight_map": files}
    (folder / "model.safetensors.index.json").write_text(json.dumps(index))
    (folder / "config.json").write_text(json.dumps(config))
    return folder


def release_config(policy="alpamayo-r1"):
    """The part of the released configuration that is public."""
    config = {
        "model_type": "alpamayo_r1",
        "vlm_backend": "qwenvl3",
        "traj_tokenizer_cfg": {"num_bins": 3000},
        "hist_traj_tokenizer_cfg": {"num_bins": 1000},
        "traj_vocab_size": 4000,
        "tokens_per_history_traj": 48,
        "tokens_per_future_traj": 128,
        "model_dtype": "bfloat16",
        "attn_implementation": "flash_attention_2",
        "min_pixels": 163_840,
        "max_pixels": 196_608,
        "add_special_tokens": True,
    }
    if policy != "alpamayo-2":
        return config
    config |= {"model_type": "alpamayo2", "tokens_per_history_traj": 45}
    config |= {"history_vocab_size": 1000, "future_vocab_size": 3000}
    config["hist_traj_tokenizer_cfg"]["pad_origin_at_beginning"] = False
    return config


@pytest.fixture(scope="session")
def clean_base(tmp_path_factory):
    return write_checkpoint(tmp_path_factory.mktemp("release") / "base", tensor_shapes(), release_config())


@pytest.fixture(scope="session")
def clean_stage1(tmp_path_factory):
    shapes = {name: shape for name, shape in tensor_shapes().items() if name.startswith("vlm.")}
    return write_checkpoint(tmp_path_factory.mktemp("run") / "checkpoint-7", shapes, release_config(), 2, seed=1)


@pytest.fixture(scope="session")
def clean_vlm(tmp_path_factory):
    """Processor and tokenizer with as many words as Qwen3-VL has."""
    folder = tmp_path_factory.mktemp("vlm") / "qwen"
    folder.mkdir()
    vocabulary = {f"w{number}": number for number in range(151_643)}
    added = [{"id": 151_643 + number, "content": f"<|special{number}|>"} for number in range(26)]
    (folder / "tokenizer.json").write_text(json.dumps({"model": {"vocab": vocabulary}, "added_tokens": added}))
    for name in ("config.json", "tokenizer_config.json", "preprocessor_config.json"):
        (folder / name).write_text(json.dumps({"name": name}))
    return folder


@pytest.fixture
def folders(clean_base, clean_stage1, clean_vlm, tmp_path):
    """Copies of base, stage 1 and vocabulary that may be damaged, by name."""
    return {
        "base": _copy(clean_base, tmp_path / "base"),
        "stage1": _copy(clean_stage1, tmp_path / "checkpoint-7"),
        "vlm": _copy(clean_vlm, tmp_path / "qwen"),
    }


@pytest.fixture
def make_python(tmp_path):
    """An interpreter that says that it has these packages: the recipe's, with changes; None takes one out."""

    def make(policy="alpamayo-r1", python="3.12.7", found=True, **changes):
        recipe = PROFILES[policy].recipe
        versions = {name: pin.lstrip("=>") or "0.1" for name, pin in recipe.pins.items()}
        versions["torch"] += "+cu128"
        versions |= {name.replace("__", "-"): version for name, version in changes.items()}
        versions = {name: version for name, version in versions.items() if version is not None}
        package = tmp_path / "recipes" / recipe.package
        package.mkdir(parents=True, exist_ok=True)
        where = {
            name: str(package / "__init__.py") if found else None
            for name in (recipe.package, "alpamayo", "alpamayo_r1")
        }
        answer = json.dumps({"python": python, "versions": versions, "found": where})
        path = tmp_path / f"python-{len(list(tmp_path.glob('python-*')))}"
        path.write_text(f"#!{sys.executable}\nprint({answer!r})\n")
        path.chmod(0o755)
        return path

    return make


@pytest.fixture
def plan(clean_export, clean_base, clean_stage1, clean_vlm, tmp_path):
    """A plan in which nothing is wrong: both stages on three clips, of which a warm-up of one step."""
    short = {"warmup_steps": 1, "gradient_accumulation_steps": 1, "save_steps": 2}
    stages = tuple(replace(stage, **short) for stage in recipe_stages("alpamayo-r1"))
    return PreflightPlan(
        policy="alpamayo-r1",
        stages=stages,
        data=clean_export,
        chunk_ids="0-1",
        val_data=clean_export,
        val_chunk_ids="1-2",
        base=clean_base,
        stage1=clean_stage1,
        vlm=clean_vlm,
        out=tmp_path / "out",
        gpus=1,
        gpu_memory_gib=80.0,
        seconds=60.0,
    )


@pytest.fixture
def failed(plan):
    """The rows that fail where the clean plan is changed so, as `check: where: found; action`."""

    def look(**changes):
        report = check(replace(plan, **changes))
        return [f"{row.check}: {row.where}: {row.found}; {row.action}" for row in report.failures]

    return look
