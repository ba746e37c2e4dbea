"""A small clone of the public recipes, checkpoints, data and a stand-in for torchrun, all made here."""

import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from safetensors.numpy import save_file

from ...straight_clips import straight_clip, write_clips

# The configurations as docs/formats/sft_recipes.md and the recipes' README tell their keys and values.
BASE = {
    "defaults": [
        {"/vla_processor@data.train_dataset.vla_preprocess_args": "default"},
        {"/vla_processor@data.val_dataset.vla_preprocess_args": "default"},
    ],
    "data": {
        "collate_fn": {"_target_": "collate"},
        "train_dataset": {
            "_target_": "PAIDataset",
            "local_dir": "???",
            "chunk_ids": "0-99",
            "use_default_keyframe": True,
            "vla_preprocess_args": {"generation_mode": False},
        },
        "val_dataset": {
            "_target_": "PAIDataset",
            "local_dir": "???",
            "chunk_ids": "99-100",
            "use_default_keyframe": True,
            "vla_preprocess_args": {"generation_mode": True},
        },
    },
    "paths": {"output_dir": "./output_sft"},
    "callbacks": {},
    "evaluate": {"max_eval_steps": -1, "torch_dtype": "bfloat16"},
    "trainer": {
        "output_dir": "${paths.output_dir}",
        "per_device_train_batch_size": 1,
        "per_device_eval_batch_size": 2,
        "gradient_accumulation_steps": 1,
        "learning_rate": 1e-4,
        "warmup_steps": 100,
        "logging_steps": 5,
        "save_steps": 500,
        "save_total_limit": 2,
        "num_train_epochs": 3,
        "bf16": True,
        "dataloader_pin_memory": True,
        "dataloader_num_workers": 2,
        "remove_unused_columns": False,
        "report_to": "none",
        "lr_scheduler_type": "cosine_warmup_with_min_lr",
        "lr_scheduler_kwargs": {"min_lr": 1e-6},
        "deepspeed": "configs/deepspeed/zero2.json",
        "gradient_checkpointing": True,
        "gradient_checkpointing_kwargs": {"use_reentrant": False},
    },
}
STAGE1 = {
    "trainer": {
        "lr_multiplier": {"vlm.model.visual": 0.1},
        "ddp_find_unused_parameters": False,
        "gradient_accumulation_steps": 4,
        "learning_rate": 1e-5,
        "warmup_steps": 500,
    },
    "evaluate": {"eval_ckpt": None},
}
STAGE2 = {
    "trainer": {"gradient_checkpointing": False, "deepspeed": None, "ddp_find_unused_parameters": True},
    "evaluate": {"eval_ckpt": None},
}
MODELS = {
    "base": {"_target_": "Stage1", "checkpoint_path": "???", "vlm_name_or_path": "Qwen/Qwen3-VL-8B-Instruct"},
    "expert": {
        "_target_": "Stage2",
        "pretrained_model_name_or_path": "nvidia/Alpamayo",
        "dtype": "auto",
        "cotrain_vlm": False,
        "stage1_vlm_checkpoint_path": None,
    },
}
PROCESSOR = {"components_order": ["image", "traj_history", "prompt", "traj_future"], "include_camera_ids": False}
LORA = {"r": 16, "alpha": 32, "dropout": 0.05, "target_submodule": "vlm", "freeze_non_adapted": False}


def _write_configs(folder, name, processor):
    def write(path, content):
        target = folder / "configs" / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(yaml.safe_dump(content, sort_keys=False))

    write("sft_base.yaml", BASE)
    write("vla_processor/default.yaml", processor)
    for model, content in MODELS.items():
        write(f"models/{name}_{model}.yaml", content)
    if name == "ar1":
        stages = (("stage1", "base", STAGE1), ("stage2", "expert", STAGE2))
        for stage, model, content in stages:
            defaults = ["sft_base", {"/models@model": f"ar1_{model}"}, "_self_"]
            write(f"sft_{stage}.yaml", {"defaults": defaults, **content, "paths": {"output_dir": f"output_{stage}"}})
    write("deepspeed/zero2.json", {"zero_optimization": {"stage": 2}})


@pytest.fixture
def recipes(tmp_path):
    """A clone: both recipes with their configurations, and the script that rewrites a base."""
    clone = tmp_path / "a clone"
    _write_configs(clone / "recipes" / "alpamayo1_sft", "ar1", PROCESSOR)
    _write_configs(clone / "recipes" / "alpamayo1_5_sft", "ar1_5", PROCESSOR | {"include_frame_nums": False})
    (clone / "scripts").mkdir()
    (clone / "scripts" / "convert_checkpoint.py").write_text(
        "import json, shutil, sys, pathlib\n"
        "source, target = (pathlib.Path(sys.argv[sys.argv.index(x) + 1]) for x in ('--input', '--output'))\n"
        "shutil.copytree(source, target, dirs_exist_ok=True)\n"
        "config = json.loads((target / 'config.json').read_text()) | {'model_type': 'alpamayo_r1'}\n"
        "(target / 'config.json').write_text(json.dumps(config))\n"
    )
    return clone


@pytest.fixture
def with_lora(recipes):
    """The same with a group of adapters, as forks have it."""
    for package in ("alpamayo1_sft", "alpamayo1_5_sft"):
        path = recipes / "recipes" / package / "configs" / "lora" / "default.yaml"
        path.parent.mkdir()
        path.write_text(yaml.safe_dump(LORA))
    return recipes


@pytest.fixture
def stage1_file(tmp_path):
    """Write a file of Stage 1 of R1 with as few values as can be, and more."""

    def write(evaluate=None, **trainer):
        values = {
            "num_train_epochs": 1,
            "per_device_train_batch_size": 1,
            "gradient_accumulation_steps": 4,
            "learning_rate": 1e-5,
            "save_steps": 500,
        }
        path = tmp_path / "stage1.yaml"
        content = {"defaults": ["sft_stage1", "_self_"], "trainer": values | trainer, "evaluate": evaluate or {}}
        path.write_text(yaml.safe_dump(content, sort_keys=False))
        return path

    return write


@pytest.fixture
def environment(tmp_path):
    """Folder with `python` and a `torchrun` that only looks like one."""
    folder = tmp_path / "environment" / "bin"
    folder.mkdir(parents=True)
    script = (Path(__file__).with_name("fake_torchrun.py")).read_text()
    (folder / "torchrun").write_text(f"#!{sys.executable}\n{script}")
    (folder / "torchrun").chmod(0o755)
    (folder / "python").symlink_to(sys.executable)
    return folder


def _stack(prefix, width, layers, rng):
    shapes = {}
    for layer in range(layers):
        here = f"{prefix}layers.{layer}."
        shapes |= {f"{here}self_attn.{name}_proj.weight": (8, width) for name in "qkv"}
        shapes |= {f"{here}self_attn.o_proj.weight": (width, 8)}
        shapes |= {f"{here}self_attn.{name}_norm.weight": (4,) for name in "qk"}
        shapes |= {f"{here}mlp.{name}_proj.weight": (16, width) for name in ("gate", "up")}
        shapes |= {f"{here}mlp.down_proj.weight": (width, 16)}
        shapes |= {f"{here}{name}_layernorm.weight": (width,) for name in ("input", "post_attention")}
    return shapes | {f"{prefix}norm.weight": (width,)}


@pytest.fixture
def base(tmp_path):
    """A released checkpoint in small, whose file has the names of the real one."""
    rng = np.random.default_rng(0)
    shapes = _stack("vlm.model.language_model.", 12, 2, rng) | _stack("expert.", 8, 2, rng)
    shapes |= {
        "vlm.model.language_model.embed_tokens.weight": (20, 12),
        "vlm.lm_head.weight": (20, 12),
        "vlm.model.visual.patch_embed.proj.weight": (6, 3, 2, 2, 2),
        "vlm.model.visual.pos_embed.weight": (4, 6),
        "vlm.model.visual.blocks.0.norm1.weight": (6,),
        "vlm.model.visual.blocks.0.mlp.linear_fc1.weight": (10, 6),
        "action_in_proj.norm.weight": (8,),
        "action_out_proj.weight": (2, 8),
    }
    tensors = {name: rng.normal(size=shape).astype("f4") for name, shape in shapes.items()}
    folder = tmp_path / "Alpamayo"
    folder.mkdir()
    names = sorted(tensors)
    parts = {f"model-{part + 1:05d}-of-00002.safetensors": names[part::2] for part in (0, 1)}
    for file, of in parts.items():
        save_file({name: tensors[name] for name in of}, folder / file)
    weights = {name: file for file, of in parts.items() for name in of}
    (folder / "model.safetensors.index.json").write_text(json.dumps({"weight_map": weights}))
    config = {
        "model_type": "alpamayo_r1",
        "min_pixels": 163_840,
        "max_pixels": 196_608,
        "vocab_size": 20,
        "traj_vocab_size": 4000,
        "traj_token_start_idx": 151_669,
        "tokens_per_history_traj": 48,
        "tokens_per_future_traj": 128,
        "include_camera_ids": True,
        "include_frame_nums": True,
    }
    (folder / "config.json").write_text(json.dumps(config))
    return folder


@pytest.fixture
def base_of_1_5(base):
    """The same as one of Alpamayo 1.5, which is to be rewritten."""
    config = json.loads((base / "config.json").read_text()) | {"model_type": "alpamayo1_5"}
    (base / "config.json").write_text(json.dumps(config))
    return base


@pytest.fixture
def pai(tmp_path):
    """A folder in PhysicalAI-AV layout as far as a launch reads it: 23 clips in chunks 3 to 5, without sample times."""
    folder = tmp_path / "pai"
    folder.mkdir()
    (folder / "features.csv").write_text("feature\n")
    ids = pd.Index([f"clip{number:02d}" for number in range(23)], name="clip_id")
    chunks = [3 + number // 10 for number in range(23)]
    pd.DataFrame({"chunk": chunks}, index=ids).to_parquet(folder / "clip_index.parquet")
    (folder / "chunk_of_clips.json").write_text(
        json.dumps(chunks)
    )  # for the stand-in, which starts faster without pandas
    return folder


@pytest.fixture(scope="session")
def braking_store(tmp_path_factory):
    """Two clips at 20 m/s, of which the second brakes from 2.5 s on at 9 m/s², beyond what tokens can say."""
    times = 0.1 * np.arange(90)
    slowing = np.clip(times - 2.5, 0.0, 20.0 / 9.0)
    braking = 20.0 * times - 9.0 * slowing * (times - 2.5 - 0.5 * slowing)
    clips = [straight_clip("steady", along=20.0 * times), straight_clip("braking", along=braking)]
    return write_clips(tmp_path_factory.mktemp("stores") / "drives", clips)
