"""Launching with a stand-in for torchrun: what runs, what is kept, and every silent failure that is stopped."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from safetensors.numpy import load_file, save_file
from typer.testing import CliRunner

from olt_generator.errors import InputError
from olt_sft_recipes.commands.sft import app
from olt_sft_recipes.preflight.rows import PreflightReport, Row, Verdict

INDEX = "model.safetensors.index.json"
RECIPE = """
name: r
description: All.
version: 1
samples: 10
components:
  - {name: all, where: {kind: GT}, share: 1.0, repeats: 8}
"""


@pytest.fixture(autouse=True)
def ready(monkeypatch):
    """Preflight has tests of its own, and finds no Qwen3-VL and no graphics card here."""
    from olt_sft_recipes.launch import alpamayo

    monkeypatch.setattr(alpamayo, "check", lambda plan: PreflightReport((), 0.0))


@pytest.fixture
def launch(tmp_path, recipes, environment, base, pai):
    """Run `olt sft launch` with everything that it needs, and more arguments; gives what it prints as JSON."""

    def run(*more, policy="alpamayo-r1", fault="", data=("--pai", str(pai))):
        (environment / "fault.txt").write_text(fault)
        arguments = ["launch", "--policy", policy, "--base", str(base), "--recipes", str(recipes), *data]
        arguments += ["--python", str(environment / "python"), "--out", str(tmp_path / "run"), "--gpus", "4", "--json"]
        result = CliRunner().invoke(app, [*arguments, *more], catch_exceptions=True)
        if result.exception is not None:
            raise result.exception
        return json.loads(result.stdout)

    return run


def calls(environment):
    path = environment / "calls.txt"
    return path.read_text().split("\n")[:-1] if path.exists() else []


def test_both_stages_run_and_stage_2_is_given_the_last_checkpoint_by_name(launch, environment, tmp_path):
    told = launch()
    assert calls(environment) == ["sft_stage1 1", "sft_stage2 2"]
    # 23 clips on 4 processes: 6 batches an epoch; by fours 2 steps, three times; one by one 6 steps, three times.
    first, second = (tmp_path / "run" / name for name in ("stage1/checkpoint-6", "stage2/checkpoint-18"))
    assert told["results"]["stage1"]["checkpoint"] == str(first) and first.is_dir()
    assert told["results"]["stage2"]["checkpoint"] == str(second) and second.is_dir()
    assert any(word == f"model.stage1_vlm_checkpoint_path='{first}'" for word in told["stages"][1]["arguments"]) or any(
        word == f"model.stage1_vlm_checkpoint_path={first}" for word in told["stages"][1]["arguments"]
    )
    assert "0 differ" in told["results"]["stage2"]["checked"]
    assert "Num examples = 23" in (tmp_path / "run/logs/stage1.log").read_text()


def test_a_stage_of_ones_own_is_watched_too(launch, stage1_file):
    result = launch("--stage", "1", "--stage1", str(stage1_file()))["results"]["stage1"]
    assert result["samples_logged"] == 23 and "not compared" not in result["checked"]


def test_what_the_log_never_told_is_said_to_be_not_compared(launch):
    result = launch("--stage", "1", fault="quiet")["results"]["stage1"]
    assert result["checked"].endswith("not in the log, so not compared: samples, steps, trained parameters")


def test_the_same_command_keeps_what_is_finished(launch, environment):
    launch()
    told = launch()
    assert len(calls(environment)) == 2 and all(result["kept"] for result in told["results"].values())


def test_an_interrupted_stage_starts_again_and_its_rest_is_put_aside(launch, environment, tmp_path):
    with pytest.raises(InputError, match="CUDA out of memory"):
        launch("--stage", "1", fault="fails")
    rest = tmp_path / "run" / "stage1" / "checkpoint-500"
    rest.mkdir(parents=True)
    launch("--stage", "1")
    assert (tmp_path / "run" / "stage1_interrupted_1" / "checkpoint-500").is_dir()
    assert sorted(path.name for path in (tmp_path / "run" / "stage1").glob("checkpoint-*")) == ["checkpoint-6"]


def test_stage_1_is_kept_when_stage_2_fails(launch, environment):
    with pytest.raises(InputError, match="wrong vision-language model"):
        launch(fault="stage 2 on the base")
    launch()
    assert calls(environment) == ["sft_stage1 1", "sft_stage2 2", "sft_stage2 2"]


def test_another_launch_in_the_same_folder_is_refused(launch):
    launch("--stage", "1")
    with pytest.raises(InputError, match="another launch"):
        launch("--stage", "1", "--chunks", "3-5")


def test_stage_2_goes_on_from_a_stage_1_that_was_launched_alone(launch, environment, tmp_path):
    launch("--stage", "1")
    told = launch("--stage", "2")
    assert told["stage1_checkpoint"] == str(tmp_path / "run/stage1/checkpoint-6")
    assert launch()["results"]["stage2"]["kept"] and len(calls(environment)) == 2


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("no chunk", "selected no chunk"),
        ("fewer chunks", "selected chunks 3 to 4"),
        ("no clip", "no clip to train on"),
        ("token offset", "mixed-up offset"),
        ("token offset in config", "traj_token_start_idx is 152669"),
        ("no label", "first loss is 0"),
        ("nan", "loss is nan"),
        ("no pixel budget", "pixel budget"),
        ("single file", "model.safetensors stands alone"),
        ("no checkpoint", "ended without a checkpoint"),
        ("stops early", "the last checkpoint is checkpoint-5, and checkpoint-6 was to come"),
        ("changes nothing", "Stage 1 changed nothing"),
        ("tensor lost", r"lacks lm_head.weight.*1 tensors missing"),
        ("adapters left", "merge them"),
        ("integers", r"lm_head.weight is I32 \(20, 12\), and F32 \(20, 12\) in"),
        ("another shape", r"lm_head.weight is F32 \(1, 12\), and F32 \(20, 12\) in"),
        ("nothing frozen", "parameters are trained"),
        ("stage 2 on the base", "but the released model's"),
        ("stage 2 on another", "neither Stage 1's nor the base's"),
        ("expert lost", r"lacks expert\..*cannot drive"),
        ("expert unchanged", "Stage 2 changed nothing"),
        ("nan in stage 1", r"stage1/checkpoint-6/model-.*safetensors: .* holds NaN or infinite values"),
        ("nan in stage 2", r"stage2/checkpoint-18/model-.*safetensors: .* holds NaN or infinite values"),
        ("fails", "RuntimeError: CUDA out of memory"),
    ],
)
def test_a_silent_failure_stops_the_launch(launch, fault, said, tmp_path):
    with pytest.raises(InputError, match=said):
        launch(fault=fault)
    assert not (tmp_path / "run/stage2/finished.json").exists()


def test_a_base_without_pixel_budget_is_refused_before_anything_runs(launch, base, environment):
    config = json.loads((base / "config.json").read_text())
    del config["max_pixels"]
    (base / "config.json").write_text(json.dumps(config))
    with pytest.raises(InputError, match=r"'max_pixels': None.*write"):
        launch()
    assert not calls(environment)


def test_stage_2_alone_takes_a_checkpoint_by_name_and_looks_at_it(launch, base, tmp_path):
    with pytest.raises(InputError, match="--stage1-checkpoint"):
        launch("--stage", "2")
    with pytest.raises(InputError, match="Stage 1 changed nothing"):
        launch("--stage", "2", "--stage1-checkpoint", str(base))


def test_a_stage_1_checkpoint_is_not_passed_over_where_stage_1_runs(launch, base, environment):
    with pytest.raises(InputError, match=r"--stage1-checkpoint.*for --stage 2"):
        launch("--stage1-checkpoint", str(base))
    assert not calls(environment)


def test_a_stage_2_that_is_kept_is_held_against_a_stage_1_that_was_trained_anew(launch, environment, base, tmp_path):
    launch()
    (tmp_path / "run/stage1/finished.json").unlink()
    shard = base / "model-00001-of-00002.safetensors"
    save_file({name: value + 1.0 for name, value in load_file(shard).items()}, shard)
    with pytest.raises(InputError, match=r"finished by an earlier launch, and does not fit.*move .*stage2 away"):
        launch()
    assert calls(environment) == ["sft_stage1 1", "sft_stage2 2", "sft_stage1 1"]


def test_a_batch_looks_at_what_it_keeps(launch, base, tmp_path):
    out = str(tmp_path / "run")
    launch("--stage", "1")
    with pytest.raises(InputError, match="Stage 2 is not launched there"):
        CliRunner().invoke(app, ["follow", out, "--stage", "2", "--kept"], catch_exceptions=False)
    launch()
    kept = CliRunner().invoke(app, ["follow", out, "--stage", "2", "--kept"], catch_exceptions=False)
    assert "Stage 2 is finished and kept" in kept.stdout
    shard = next((tmp_path / "run/stage1/checkpoint-6").glob("*.safetensors"))
    save_file({name: value + 1.0 for name, value in load_file(shard).items()}, shard)
    with pytest.raises(InputError, match=r"does not fit.*move .*stage2 away"):
        CliRunner().invoke(app, ["follow", out, "--stage", "2", "--kept"], catch_exceptions=False)
    (tmp_path / "run/stage2/finished.json").unlink()
    with pytest.raises(InputError, match="Stage 2 is not finished; leave --kept out"):
        CliRunner().invoke(app, ["follow", out, "--stage", "2", "--kept"], catch_exceptions=False)


@pytest.mark.parametrize("stage", [1, 2])
def test_what_a_batch_finished_without_olt_is_looked_at_later(launch, environment, tmp_path, stage):
    launch()
    folder = tmp_path / "run" / f"stage{stage}"
    note = json.loads((folder / "finished.json").read_text())
    (folder / "finished.json").write_text(json.dumps(note | {"checked": None}))
    assert launch()["results"][f"stage{stage}"] == note | {"kept": True} and len(calls(environment)) == 2
    shard = next(Path(note["checkpoint"]).glob("*.safetensors"))
    save_file({name: value * float("nan") for name, value in load_file(shard).items()}, shard)
    with pytest.raises(InputError, match=rf"Stage {stage} was finished.*NaN.*move .*stage{stage} away"):
        launch()


def _lose_the_index(base):
    (base / INDEX).unlink()
    return "index.json.*no such file"


def _join_into_one_file(base):
    tensors = {name: value for path in sorted(base.glob("*.safetensors")) for name, value in load_file(path).items()}
    for path in [*base.glob("*.safetensors"), base / INDEX]:
        path.unlink()
    save_file(tensors, base / "model.safetensors")
    return "model.safetensors stands alone"


def _name_a_shard_that_is_not_there(base):
    index = json.loads((base / INDEX).read_text())
    index["weight_map"]["expert.norm.weight"] = "model-00003-of-00003.safetensors"
    (base / INDEX).write_text(json.dumps(index))
    return "model-00003-of-00003.safetensors: cannot be read"


def _cut_a_shard(base):
    path = base / "model-00002-of-00002.safetensors"
    path.write_bytes(path.read_bytes()[:-4])
    return "the file was cut off"


@pytest.mark.parametrize(
    "damage", [_lose_the_index, _join_into_one_file, _name_a_shard_that_is_not_there, _cut_a_shard]
)
def test_a_base_that_is_not_whole_is_told_by_its_file_before_anything_runs(launch, base, environment, damage, tmp_path):
    said = damage(base)
    with pytest.raises(InputError, match=said):
        launch()
    assert not calls(environment) and not (tmp_path / "run").exists()


def test_a_killed_launch_leaves_no_process_and_goes_on(launch, environment, recipes, base, pai, tmp_path):
    (environment / "fault.txt").write_text("hangs")
    words = ["launch", "--policy", "alpamayo-r1", "--base", str(base), "--recipes", str(recipes), "--pai", str(pai)]
    words += ["--python", str(environment / "python"), "--out", str(tmp_path / "run"), "--gpus", "4", "--stage", "1"]
    code = (
        "import sys; from olt_sft_recipes.launch import alpamayo; from olt_sft_recipes.preflight.rows import "
        "PreflightReport; alpamayo.check = lambda plan: PreflightReport((), 0.0)\n"
        "from olt_sft_recipes.commands.sft import app; app(sys.argv[1:])"
    )
    process = subprocess.Popen([sys.executable, "-c", code, *words], stdout=subprocess.DEVNULL)
    while not (environment / "hangs.txt").exists():
        assert process.poll() is None
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    end = time.monotonic() + 20.0
    while any(_runs(path, environment / "torchrun") for path in Path("/proc").glob("[0-9]*")):
        assert time.monotonic() < end
        time.sleep(0.05)
    assert launch("--stage", "1")["results"]["stage1"]["kept"] is False


def _runs(process, program):
    try:
        return str(program).encode() in (process / "cmdline").read_bytes()
    except OSError:
        return False


def test_a_base_of_1_5_is_rewritten_first_and_the_policy_is_handed_to_alpasim(launch, base_of_1_5, tmp_path):
    told = launch(policy="alpamayo-1.5")
    made = tmp_path / "run" / "base"
    assert json.loads((made / "config.json").read_text())["model_type"] == "alpamayo_r1"
    assert f"model.checkpoint_path={made}" in told["stages"][0]["arguments"]
    stage2 = tmp_path / "run/stage2/checkpoint-18"
    assert any("driver.model.checkpoint_path=/mnt/drivers/checkpoint-18" in line for line in told["handoff"])
    result = CliRunner().invoke(app, ["handoff", str(stage2), "--json"], catch_exceptions=False)
    assert json.loads(result.stdout)["commands"] == told["handoff"]
    with pytest.raises(InputError, match="no action expert"):
        CliRunner().invoke(app, ["handoff", str(tmp_path / "run/stage1/checkpoint-6")], catch_exceptions=False)


def test_a_policy_without_recipe_is_refused_in_words(launch):
    with pytest.raises(InputError, match=r"no public SFT recipe.*olt data export"):
        launch(policy="alpamayo-2")


def test_validation_is_evaluated_by_the_recipe(launch, pai):
    told = launch("--chunks", "3-5", "--validation", str(pai), "--validation-chunks", "5-6")
    wanted = {"metric/ade": 2.0072, "metric/min_ade/by_t=0.5": 0.0079, "metric/corner_distance": 6e-05}
    assert told["results"]["evaluation"] == wanted


@pytest.mark.parametrize("fault", ["nan metric", "inf metric"])
def test_a_metric_that_is_not_finite_is_refused_and_the_whole_log_kept(launch, pai, tmp_path, fault):
    data = ("--chunks", "3-5", "--validation", str(pai), "--validation-chunks", "5-6")
    with pytest.raises(InputError, match=r"evaluation\.log: metric/min_ade/by_t=0\.5: not finite"):
        launch(*data, fault=fault)
    assert "corner_distance" in (tmp_path / "run/logs/evaluation.log").read_text()


def test_what_a_file_says_of_the_evaluation_is_said_to_it(launch, stage1_file, pai):
    data = ("--chunks", "3-5", "--validation", str(pai), "--validation-chunks", "5-6")
    given = str(stage1_file({"max_eval_steps": 10}))
    told = launch(*data, "--dry-run", "--stage", "1", "--stage1", given)
    assert "++evaluate.max_eval_steps=10" in told["evaluation"]


def test_a_batch_file_evaluates_too(launch, pai):
    data = ("--chunks", "3-5", "--validation", str(pai), "--validation-chunks", "5-6")
    told = launch(*data, "--dry-run", "--slurm")
    last = told["batch"][told["batch"].rindex("run_on_all evaluation") :]
    assert "alpamayo1_sft.evaluate_hf" in last and "stage2/checkpoint-15" in last and "logs/evaluation.log" in last
    assert "evaluate_hf" not in launch("--dry-run", "--slurm")["batch"]


def test_a_range_of_chunks_selects_what_it_says(launch, pai):
    told = launch("--chunks", "3-5", "--dry-run")
    assert told["data"]["clips"] == 20 and told["data"]["chunk_ids"] == "3-5"
    with pytest.raises(InputError, match="hold no clip"):
        launch("--chunks", "0-3", "--dry-run")
    with pytest.raises(InputError, match="without a dash"):
        launch("--chunks", "3", "--dry-run")


def test_a_dry_run_writes_nothing(launch, environment, tmp_path):
    told = launch("--dry-run")
    assert not (tmp_path / "run").exists() and not calls(environment)
    assert [shell.partition(" ")[0] for shell in told["commands"]] == [str(environment / "torchrun")] * 2


def test_several_nodes_need_a_meeting_place_and_are_not_started_from_one(launch, tmp_path):
    with pytest.raises(InputError, match="--head"):
        launch("--nodes", "2")
    with pytest.raises(InputError, match="on each"):
        launch("--nodes", "2", "--head", "node0")
    script = (tmp_path / "run/commands.sh").read_text()
    assert script.count("--rdzv_endpoint node0:29500") == 2 and script.count("--nnodes 2") == 2
    assert subprocess.run(["bash", "-n"], input=script, text=True, check=False).returncode == 0


def test_several_nodes_find_the_base_rewritten(launch, recipes, base_of_1_5, environment, tmp_path):
    with pytest.raises(InputError, match="on each"):
        launch("--nodes", "2", "--head", "node0", "--stage", "1", policy="alpamayo-1.5")
    assert json.loads((tmp_path / "run/base/config.json").read_text())["model_type"] == "alpamayo_r1"
    (recipes / "scripts/convert_checkpoint.py").write_text("raise SystemExit('on every node at once')")
    assert subprocess.run(["bash", str(tmp_path / "run/commands.sh")], capture_output=True, check=False).returncode == 0
    assert len(calls(environment)) == 1


def test_validation_on_training_clips_is_refused(launch, pai):
    with pytest.raises(InputError, match="judged on what it was trained on"):
        launch("--validation", str(pai))


def test_preflight_is_given_what_will_run(launch, pai, monkeypatch):
    monkeypatch.undo()  # the real one
    rows = launch("--dry-run", "--gpu-memory", "80")["preflight"]["rows"]
    assert {"data", "checkpoint", "steps", "memory"} <= {row["group"] for row in rows}
    assert any(row["group"] == "data" and str(pai) in row["where"] for row in rows)


def test_preflight_is_given_what_is_shipped_where_a_file_does_not_say(launch, stage1_file, monkeypatch):
    plans = _capture(monkeypatch)
    launch("--dry-run", "--stage", "1", "--stage1", str(stage1_file()))
    (stage,) = plans[0].stages
    assert (stage.warmup_steps, stage.min_lr, stage.gradient_checkpointing, stage.zero_stage) == (500, 1e-6, True, 2)


def test_preflight_is_given_the_shipped_base_of_1_5_where_a_file_does_not_say(launch, tmp_path, monkeypatch):
    path = tmp_path / "stage2.yaml"
    path.write_text(
        "defaults: [sft_base, /models@model: ar1_5_expert, _self_]\nmodel: {cotrain_vlm: false}\ntrainer: "
        "{save_steps: 500, num_train_epochs: 3, per_device_train_batch_size: 1, gradient_accumulation_steps: 1, "
        "learning_rate: 1.0e-4}\n"
    )
    plans = _capture(monkeypatch)
    launch("--dry-run", "--stage2", str(path), policy="alpamayo-1.5")
    assert (plans[0].stages[1].zero_stage, plans[0].stages[1].gradient_checkpointing) == (2, True)


def test_preflight_is_given_the_learning_rate_of_adapters(launch, with_lora, monkeypatch):
    plans = _capture(monkeypatch)
    launch("--dry-run", "--lora")
    assert (plans[0].stages[0].learning_rate, plans[0].stages[0].lora_rank) == (1e-4, 16)


def test_preflight_of_stage_2_alone_is_given_what_stage_1_left(launch, monkeypatch, tmp_path):
    launch("--stage", "1")
    plans = _capture(monkeypatch)
    launch("--stage", "2")
    assert [plan.stage1 for plan in plans] == [tmp_path / "run/stage1/checkpoint-6"]


@pytest.mark.parametrize("killed", [False, True])
def test_preflight_looks_at_a_base_that_is_still_to_be_rewritten(launch, base_of_1_5, monkeypatch, tmp_path, killed):
    plans = _capture(monkeypatch)
    if killed:
        (tmp_path / "run" / "base").mkdir(parents=True)
    launch("--dry-run", policy="alpamayo-1.5")
    assert [(plan.base, plan.base_is_rewritten) for plan in plans] == [(base_of_1_5, True)]


def test_what_is_not_ready_is_refused_before_the_export(launch, braking_store, monkeypatch, tmp_path):
    row = Row("versions", "pins", "python", Verdict.FAILED, "torch is 2.7", "run uv sync")
    monkeypatch.setattr("olt_sft_recipes.launch.alpamayo.check", lambda plan: PreflightReport((row,), 0.0))
    recipe = tmp_path / "r.yaml"
    recipe.write_text(RECIPE)
    data = ("--recipe", str(recipe), "--stores", str(braking_store), "--allow-uncompared")
    with pytest.raises(InputError, match="tokens of 5 samples saturate") as saturated:
        launch(data=data)
    enough = str(saturated.value).rpartition(" --most-saturated ")[2]
    with pytest.raises(InputError, match=r"torch is 2\.7"):
        launch("--most-saturated", enough, data=data)
    assert not (tmp_path / "run").exists()


def _capture(monkeypatch):
    plans = []

    def look(plan):
        plans.append(plan)
        return PreflightReport((), 0.0)

    monkeypatch.setattr("olt_sft_recipes.launch.alpamayo.check", look)
    return plans


def test_people_read_what_will_run_and_what_ran(recipes, environment, base, pai, tmp_path):
    arguments = ["launch", "--policy", "alpamayo-1.5", "--base", str(base), "--recipes", str(recipes)]
    arguments += ["--pai", str(pai), "--python", str(environment / "python"), "--out", str(tmp_path / "run")]
    shown = CliRunner().invoke(app, [*arguments, "--gpus", "4", "--dry-run"], catch_exceptions=False).stdout
    assert "23 clips, chunks 3-6" in shown and "not counted because" in shown
    assert "+models@model=ar1_5_base" in shown and "include_camera_ids" in shown
    ran = CliRunner().invoke(app, [*arguments, "--gpus", "4"], catch_exceptions=False).stdout
    assert "0 differ" in ran and "driver.model.model_type=alpamayo1_5_recipes_sft" in ran
