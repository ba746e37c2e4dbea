"""Nothing is said to be wrong where nothing is wrong, and what could not be looked at is told."""

import json
from dataclasses import replace

import pytest

from olt_sft_recipes.preflight.check import check
from olt_sft_recipes.preflight.plan import PreflightPlan, recipe_stages
from olt_sft_recipes.preflight.rows import Verdict

from .conftest import release_config, tensor_shapes, write_checkpoint


def test_a_clean_launch_passes(plan, make_python):
    report = check(replace(plan, python=make_python()))
    assert not report.failures and report.to_dict()["ready"]
    groups = {row.group for row in report.rows if row.verdict is Verdict.PASSED}
    assert groups == {"data", "checkpoint", "versions", "disk", "memory", "steps"}
    report.refuse()


def test_every_row_says_what_was_found_and_failures_what_to_do(plan):
    report = check(replace(plan, chunk_ids="7", base=None, vlm=None, gpus=9))
    assert report.failures
    assert all(row.found and row.where for row in report.rows)
    assert all(row.action for row in report.failures)
    assert all("not checked because" in row.found for row in report.rows if row.verdict is Verdict.NOT_CHECKED)


def test_nothing_given_is_nothing_passed_but_memory_of_published_sizes():
    report = check(PreflightPlan("alpamayo-r1", recipe_stages("alpamayo-r1"), gpu_memory_gib=80.0))
    assert {row.check for row in report.rows if row.verdict is Verdict.PASSED} == {"stage 1 memory", "stage 2 memory"}
    assert not report.failures


@pytest.mark.parametrize("part", ["data", "base", "vlm", "stage1", "python", "out", "gpu_memory_gib", "val_data"])
def test_what_is_not_given_is_not_checked(plan, make_python, part, monkeypatch):
    monkeypatch.setenv("PATH", "")
    whole = replace(plan, python=make_python())
    before, after = check(whole), check(replace(whole, **{part: None}))
    passed = [{row.check for row in report.rows if row.verdict is Verdict.PASSED} for report in (before, after)]
    assert passed[1] < passed[0]
    # Without headers, memory and disk are told by the published sizes, which one card of 80 GiB does not hold.
    assert {row.group for row in after.failures} <= ({"memory", "disk"} if part == "base" else set())


def test_the_profile_of_alpamayo_2_takes_six_cameras_and_45_tokens(plan, wide_export, clean_export, tmp_path):
    base = write_checkpoint(tmp_path / "two", tensor_shapes(155_776), release_config("alpamayo-2"))
    changes = {"policy": "alpamayo-2", "base": base, "stage1": None, "chunk_ids": None, "val_data": None}
    report = check(replace(plan, data=wide_export, **changes))
    assert not report.failures
    told = {row.check: row.found for row in report.rows}
    assert "45 history" in told["trajectory tokens"] and "6 cameras" in told["train features.csv"]
    assert "no public SFT recipe" in told["pins"]
    narrow = check(replace(plan, data=clean_export, **changes))
    assert any("camera_rear_left_70fov" in row.found for row in narrow.failures)


def test_a_base_of_alpamayo_1_5_must_be_rewritten_first(plan, make_python, tmp_path):
    config = release_config() | {"model_type": "alpamayo1_5"}
    base = write_checkpoint(tmp_path / "newer", tensor_shapes(), config)
    python = make_python("alpamayo-1.5")
    report = check(replace(plan, policy="alpamayo-1.5", base=base, python=python, stage1=None))
    assert [row.check for row in report.failures] == ["model type"]
    assert "convert_checkpoint.py to-a1" in report.failures[0].action
    rewritten = replace(plan, policy="alpamayo-1.5", base=base, python=python, stage1=None, base_is_rewritten=True)
    assert not check(rewritten).failures
    (base / "config.json").write_text(json.dumps(config | {"max_pixels": None}))
    assert [row.check for row in check(rewritten).failures] == ["pixel limits"]
    assert not check(replace(plan, policy="alpamayo-1.5", python=python)).failures


def test_preflight_writes_nothing(plan):
    before = sorted(plan.data.rglob("*")), sorted(plan.base.rglob("*"))
    check(plan)
    assert before == (sorted(plan.data.rglob("*")), sorted(plan.base.rglob("*"))) and not plan.out.exists()
