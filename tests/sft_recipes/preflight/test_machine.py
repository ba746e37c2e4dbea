"""Versions, disk, memory and steps: against planted faults and published numbers."""

import json
import subprocess
from dataclasses import replace
from types import SimpleNamespace

import pytest

from olt_generator.errors import InputError
from olt_sft_recipes.preflight import machine_rows
from olt_sft_recipes.preflight.check import check
from olt_sft_recipes.preflight.memory import SampleTokens, sample_tokens, step_memory
from olt_sft_recipes.preflight.parameters import adapter_parameters, published_sizes
from olt_sft_recipes.preflight.plan import PreflightPlan, StagePlan, recipe_stages
from olt_sft_recipes.preflight.profiles import STAGE1_FIX
from olt_sft_recipes.preflight.rows import Verdict

GIB = 2**30


def rows_of(group, policy="alpamayo-r1", **changes):
    plan = PreflightPlan(policy, changes.pop("stages", recipe_stages(policy)))
    return [row for row in check(replace(plan, **changes)).rows if row.group == group]


def failed(group, **changes):
    return [
        f"{row.check}: {row.found}; {row.action}" for row in rows_of(group, **changes) if row.verdict is Verdict.FAILED
    ]


def test_an_environment_as_the_recipe_pins_it(make_python):
    told = {row.check: row for row in rows_of("versions", python=make_python())}
    assert not [row for row in told.values() if row.verdict is Verdict.FAILED]
    assert told["pins"].found == "20 of 20 packages as alpamayo1_sft pins them"
    assert told["stage 1 loading fix"].verdict is Verdict.NOT_CHECKED


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"torch": "2.9.0"}, "torch is 2.9.0, ==2.8.0 is needed"),
        ({"transformers": "5.23.0"}, "transformers is 5.23.0"),
        ({"deepspeed": "0.19.1"}, "deepspeed is 0.19.1, ==0.18.2"),
        ({"accelerate": "1.11.0"}, "accelerate is 1.11.0, >=1.12.0"),
        ({"hydra__core": None}, "hydra-core is absent"),
        ({"flash__attn": None}, "sdpa"),
        ({"python": "3.11.9"}, "Python 3.11.9, the recipe needs ==3.12.*"),
        ({"found": False}, "alpamayo1_sft cannot be imported"),
    ],
)
def test_versions_that_are_not_pinned(make_python, changes, said):
    assert any(said in each for each in failed("versions", python=make_python(**changes)))


def test_the_recipe_of_1_5_pins_another_deepspeed(make_python):
    assert not failed("versions", policy="alpamayo-1.5", python=make_python("alpamayo-1.5"))
    assert any(
        "deepspeed" in each
        for each in failed("versions", policy="alpamayo-1.5", python=make_python("alpamayo-1.5", deepspeed="0.18.2"))
    )


def test_flash_attention_is_not_asked_for_where_the_checkpoint_takes_another(make_python, folders):
    path = folders["base"] / "config.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"attn_implementation": "sdpa"}))
    python = make_python(flash__attn=None)
    assert not failed("versions", python=python, base=folders["base"])
    assert failed("versions", python=python)


def test_a_recipe_whose_history_lacks_the_loading_fix(make_python, monkeypatch):
    run, answers = subprocess.run, {"merge-base": 1}

    def answer(command, **options):
        if command[0] == "git":
            assert STAGE1_FIX in command
            return SimpleNamespace(returncode=answers["merge-base"])
        return run(command, **options)

    monkeypatch.setattr(subprocess, "run", answer)
    assert any("Stage 2 would train on the base model" in each for each in failed("versions", python=make_python()))
    answers["merge-base"] = 0
    assert not failed("versions", python=make_python())


def test_an_interpreter_that_is_none(tmp_path):
    assert any("no such interpreter" in each for each in failed("versions", python=tmp_path / "python"))
    broken = tmp_path / "broken"
    broken.write_text("#!/bin/sh\necho no\n")
    broken.chmod(0o755)
    assert any("is no Python interpreter" in each for each in failed("versions", python=broken))


def test_parameters_are_those_that_others_counted():
    """8.8 B and 43,646,976 with adapters of rank 16, 1.28 B of embedding and head, 576 M of the image encoder: the
    community recipe's counts of 1.5; 22 GB of the release in bf16."""
    sizes = published_sizes()
    assert round(sizes.language_model / 1e9, 1) == 8.8
    assert adapter_parameters(sizes.text, 16) == 43_646_976
    assert round((sizes.parameters["embedding"] + sizes.parameters["head"]) / 1e9, 2) == 1.28
    assert round(sizes.parameters["visual"] / 1e6) == 576
    assert round(2 * sizes.total / 1e9) == 22


def test_what_adapters_leave_trainable_by_accident():
    first = replace(recipe_stages("alpamayo-r1")[0], lora_rank=16)
    sizes = published_sizes()
    assert sizes.trainable(first) == {"adapters": 43_646_976}
    loose = sizes.trainable(replace(first, lora_freezes_rest=False))
    assert round(sum(loose.values()) / 1e9, 2) == 1.90
    rows = rows_of("memory", stages=(replace(first, lora_freezes_rest=False),), gpu_memory_gib=80.0)
    assert any("freeze them" in row.action for row in rows)


@pytest.mark.parametrize("policy", ["alpamayo-r1", "alpamayo-1.5"])
def test_the_recipe_fits_where_it_was_validated_and_not_on_one_card(policy):
    """Validated by its authors on 8 x H100 80 GB; ZeRO-2's states alone take 16 bytes of each of 8.8 G parameters."""
    assert not failed("memory", policy=policy, gpus=8, gpu_memory_gib=79.6)
    assert any("stage 1 memory" in each for each in failed("memory", policy=policy, gpus=1, gpu_memory_gib=139.0))
    alone = (replace(recipe_stages(policy)[0], lora_rank=16),)
    assert not failed("memory", policy=policy, stages=alone, gpus=1, gpu_memory_gib=79.6)


def test_memory_falls_with_each_stage_of_zero_and_with_checkpointing():
    sizes, tokens = published_sizes(), sample_tokens(4, 48, 128)
    first = recipe_stages("alpamayo-r1")[0]
    whole = [sum(step_memory(sizes, replace(first, zero_stage=zero), tokens, 8).values()) for zero in (1, 2, 3)]
    assert whole == sorted(whole, reverse=True) and whole[0] - whole[1] > 10 * GIB
    kept = step_memory(sizes, replace(first, gradient_checkpointing=False), tokens, 8)
    assert kept["activations"] > 10 * step_memory(sizes, first, tokens, 8)["activations"]
    twice = step_memory(sizes, replace(first, per_device_train_batch_size=2), tokens, 8)
    assert twice["logits"] == 2 * step_memory(sizes, first, tokens, 8)["logits"]


def test_images_of_four_cameras_are_2880_tokens():
    assert sample_tokens(4, 48, 128).images == 2880 and sample_tokens(6, 45, 128).images == 4320
    assert SampleTokens(10, 5).total == 15


@pytest.mark.parametrize("answer", ["81559\n" * 8, "81559\n" * 7, "", None])
def test_cards_that_are_here(monkeypatch, answer):
    def run(command, **options):
        if answer is None:
            raise FileNotFoundError
        return SimpleNamespace(stdout=answer)

    monkeypatch.setattr(machine_rows.subprocess, "run", run)
    verdicts = {row.verdict for row in rows_of("memory", gpus=8) if "memory" in row.check}
    assert verdicts == {Verdict.PASSED if answer == "81559\n" * 8 else Verdict.NOT_CHECKED}


def test_memory_of_alpamayo_2_is_not_guessed():
    (row,) = rows_of("memory", policy="alpamayo-2", gpu_memory_gib=80.0)
    assert row.verdict is Verdict.NOT_CHECKED and "not published" in row.found


def test_checkpoints_that_do_not_fit_on_the_disk(monkeypatch, tmp_path):
    """Stage 1 writes 2 x 2 bytes of weights and 12 of states a parameter, and three are there before one goes."""
    first = recipe_stages("alpamayo-r1")[:1]
    needed = 3 * 16 * published_sizes().language_model

    def free(size):
        monkeypatch.setattr(machine_rows.shutil, "disk_usage", lambda path: SimpleNamespace(free=size))
        return rows_of("disk", stages=first, out=tmp_path / "not" / "there")[0]

    assert free(needed).verdict is Verdict.PASSED
    row = free(needed - 1)
    assert row.verdict is Verdict.FAILED and "3 x 140.8 GB" in row.found and "save_total_limit" in row.action
    assert row.where == str(tmp_path)


def test_steps_of_the_paper(monkeypatch):
    """12,245 samples on 8 devices: 1,149 and 4,593 steps, and a warm-up of 44 % and 2 %."""
    from olt_sft_recipes.preflight.step_rows import step_rows

    plan = PreflightPlan("alpamayo-r1", recipe_stages("alpamayo-r1"), gpus=8)
    first, second = step_rows(plan, 12_245)
    assert "= 1149 steps" in first.found and "warm-up 500 (44 %)" in first.found
    assert "= 4593 steps" in second.found and "(2 %)" in second.found and "1e-06 at the end" in second.found
    assert "2e-08 at first, 1e-05 at most" in first.found and {first.verdict, second.verdict} == {Verdict.PASSED}


@pytest.mark.parametrize(
    ("samples", "changes", "verdict", "said"),
    [
        (100, {}, Verdict.FAILED, "never reaches its peak of 1e-05"),
        (100, {"warmup_steps": 7}, Verdict.NOTE, "the warm-up is 58 % of the run"),
        (3, {"warmup_steps": 1}, Verdict.NOTE, "every epoch is one step"),
        (33, {"warmup_steps": 1}, Verdict.NOTE, "31 of 64 places"),
        (12_245, {"save_steps": 2000}, Verdict.NOTE, "no checkpoint is saved before the last step"),
    ],
)
def test_steps_that_are_not_meant_so(samples, changes, verdict, said):
    from olt_sft_recipes.preflight.step_rows import step_rows

    first = replace(recipe_stages("alpamayo-r1")[0], **changes)
    (row,) = step_rows(PreflightPlan("alpamayo-r1", (first,), gpus=8), samples)
    assert row.verdict is verdict and said in row.found, row.found


def test_stage_2_takes_one_sample_a_device():
    from olt_sft_recipes.preflight.step_rows import step_rows

    second = replace(recipe_stages("alpamayo-r1")[1], per_device_train_batch_size=2)
    (row,) = step_rows(PreflightPlan("alpamayo-r1", (second,)), 12_245)
    assert row.verdict is Verdict.FAILED and "cache" in row.found


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: PreflightPlan("alpamayo", ()),
        lambda: PreflightPlan("toy", (), gpus=0),
        lambda: PreflightPlan("toy", (), gpu_memory_gib=0.0),
        lambda: StagePlan(3),
        lambda: StagePlan(1, num_train_epochs=0),
        lambda: StagePlan(1, learning_rate=1e-7),
        lambda: StagePlan(1, zero_stage=4),
    ],
)
def test_plans_that_make_no_sense(wrong):
    with pytest.raises(InputError):
        wrong()
