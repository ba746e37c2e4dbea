"""Stands in for torchrun with a recipe: prints such logs and writes such folders, or commits one of its silent faults.

`fault.txt` beside it names the fault. Arithmetic and reader are those of docs/formats/sft_recipes.md.
"""

import json
import math
import sys
import time
from pathlib import Path

import numpy as np
from safetensors.numpy import load_file, save_file

HERE = Path(__file__).resolve().parent
FAULT = (HERE / "fault.txt").read_text().strip() if (HERE / "fault.txt").exists() else ""
ARGUMENTS = sys.argv[1:]
OVERRIDES = {}
for word in ARGUMENTS:
    if "=" in word:
        key, _, value = word.lstrip("+").partition("=")
        OVERRIDES[key] = value.strip("'")


def read_tensors(folder):
    index = json.loads((folder / "model.safetensors.index.json").read_text())["weight_map"]
    return {name: value for shard in sorted(set(index.values())) for name, value in load_file(folder / shard).items()}


def write_checkpoint(folder, tensors, config):
    folder.mkdir(parents=True)
    if FAULT == "no pixel budget":
        config = {key: value for key, value in config.items() if not key.endswith("_pixels")}
    if FAULT == "token offset in config":
        config = config | {"traj_token_start_idx": config["traj_token_start_idx"] + 1000}
    (folder / "config.json").write_text(json.dumps(config))
    if FAULT == "single file":
        save_file(tensors, folder / "model.safetensors")
    else:
        names = sorted(tensors)
        parts = (names[::2], names[1::2])
        files = {name: f"model-{part + 1:05d}-of-00002.safetensors" for part in (0, 1) for name in parts[part]}
        for part in (0, 1):
            save_file(
                {name: tensors[name] for name in parts[part]}, folder / f"model-{part + 1:05d}-of-00002.safetensors"
            )
        (folder / "model.safetensors.index.json").write_text(json.dumps({"weight_map": files}))
    (folder / "trainer_state.json").write_text("{}")


def log(text):
    print(text, flush=True)


def main():
    name = ARGUMENTS[ARGUMENTS.index("--config-name") + 1]
    if "evaluate_hf" in " ".join(ARGUMENTS):
        endless = {"nan metric": "nan", "inf metric": "inf"}.get(FAULT, "0.0079")
        log(f"val/metric/ade              2.0072\nval/metric/min_ade/by_t=0.5 {endless}")
        log("val/metric/corner_distance  6e-05")
        return
    stage = 2 if "model.stage1_vlm_checkpoint_path" in OVERRIDES else 1
    with (HERE / "calls.txt").open("a") as calls:
        calls.write(f"{name} {stage}\n")
    folder = Path(OVERRIDES["data.train_dataset.local_dir"])
    first, end = map(int, OVERRIDES["data.train_dataset.chunk_ids"].split("-"))
    chunks = [] if FAULT == "no chunk" else list(range(first, end - (FAULT == "fewer chunks")))
    log(f"[INFO] Loading from {folder} with chunk_ids: {chunks}")
    numbers = json.loads((folder / "chunk_of_clips.json").read_text())
    clips = 0 if FAULT == "no clip" else sum(first <= number < end for number in numbers)
    processes = int(ARGUMENTS[ARGUMENTS.index("--nproc_per_node") + 1])
    batches = math.ceil(clips / processes)
    epochs = int(OVERRIDES["trainer.num_train_epochs"])
    steps = epochs * math.ceil(batches / int(OVERRIDES["trainer.gradient_accumulation_steps"]))
    base = Path(OVERRIDES["model.checkpoint_path" if stage == 1 else "model.pretrained_model_name_or_path"])
    config, tensors = json.loads((base / "config.json").read_text()), read_tensors(base)
    mine = {name: value for name, value in tensors.items() if name.startswith("vlm.") == (stage == 1)}
    trained = sum(value.size for value in (tensors if FAULT == "nothing frozen" else mine).values())
    if OVERRIDES.get("trainer.log_level") == "info" and FAULT != "quiet":
        log(f"[INFO|trainer.py:2519]   Num examples = {clips:,}")
        log(f"[INFO|trainer.py:2527]   Total optimization steps = {steps:,}")
        log(f"[INFO|trainer.py:2528]   Number of trainable parameters = {trained:,}")
    start = {"token offset": 9.31, "no label": 0.0}.get(FAULT, 1.668)
    log(f"{{'loss': {start}, 'grad_norm': 0.9368, 'learning_rate': 1e-08, 'epoch': 0.5}}")
    if FAULT == "nan":
        log("{'loss': nan, 'grad_norm': nan, 'learning_rate': 1e-08, 'epoch': 1.0}")
    if FAULT == "hangs":
        (HERE / "hangs.txt").write_text("")
        time.sleep(600)
    if FAULT == "fails":
        log("Traceback (most recent call last):\nRuntimeError: CUDA out of memory\n[launcher] worker 0 failed")
        raise SystemExit(1)
    rise = np.float32(0.0 if FAULT == "changes nothing" else 0.125)
    if stage == 1:
        result = {name: value + rise for name, value in mine.items()}
        if FAULT == "tensor lost":
            result.pop(sorted(result)[0])
        if FAULT == "integers":
            result = {name: value.astype(np.int32) for name, value in result.items()}
        if FAULT == "another shape":
            result |= {name: value[:1] for name, value in result.items()}
        if FAULT == "adapters left":
            adapter = "vlm.model.language_model.layers.{}.self_attn.q_proj.lora_A.default.weight"
            result |= {adapter.format(layer): np.zeros((2, 2), "f4") for layer in (0, 1)}
    else:
        given = Path(OVERRIDES["model.stage1_vlm_checkpoint_path"])
        vlm = {} if FAULT == "stage 2 on the base" else read_tensors(given)
        result = tensors | vlm | {name: value + rise for name, value in mine.items()}
        if FAULT == "stage 2 on another":
            result |= {name: value + 1 for name, value in vlm.items()}
        if FAULT == "expert lost":
            result = {name: value for name, value in result.items() if not name.startswith("expert.")}
        if FAULT == "expert unchanged":
            result |= mine
    if f"nan in stage {stage}" == FAULT:
        result |= {name: value * np.float32("nan") for name, value in mine.items()}
    output = Path(OVERRIDES["paths.output_dir"])
    if FAULT != "no checkpoint":
        write_checkpoint(output / f"checkpoint-{steps - (FAULT == 'stops early')}", result, config)
    log(f"100%|##########| {steps}/{steps} [00:01<00:00,  1.0it/s]")
    log("{'loss': 0.5, 'grad_norm': 0.9, 'learning_rate': 1e-07, 'epoch': 3.0}")


main()
