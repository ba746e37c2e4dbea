import json
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from olt_datasets import compose_mixture, read_clip_tables, write_mixture
from olt_datasets.mixtures.recipe import Recipe
from olt_generator.errors import InputError
from olt_sft_recipes.commands.sft import app
from olt_sft_recipes.preflight import toy_rows
from olt_sft_recipes.preflight.check import check
from olt_sft_recipes.preflight.plan import PreflightPlan, recipe_stages
from olt_sft_recipes.preflight.rows import Verdict


def run(*arguments):
    return CliRunner().invoke(app, ["preflight", *map(str, arguments)])


def test_exit_status_and_json_say_the_same(clean_export, clean_base):
    given = ("--policy", "alpamayo-r1", "--data", clean_export, "--base", clean_base, "--gpu-memory", 80)
    steps = ("--warmup-steps", 1, "--accumulation", 1, "--gpus", 1)
    good = run(*given, *steps, "--json")
    told = json.loads(good.stdout)
    assert good.exit_code == 0 and told["ready"] and told["failed"] == 0 and told["passed"] > 10
    assert {"group", "check", "where", "verdict", "found", "action"} == set(told["rows"][0])
    bad = run(*given, *steps, "--chunk-ids", "0", "--json")
    assert bad.exit_code == 1 and not json.loads(bad.stdout)["ready"]


def test_the_table_shows_every_row(clean_export):
    shown = run("--policy", "alpamayo-2", "--stage", "1", "--data", clean_export)
    assert shown.exit_code == 1
    assert "failed: train chunk files" in shown.stdout and "camera_rear_left_70fov" in shown.stdout
    assert "licence" in shown.stdout and "what to do" in shown.stdout and "6 not checked" in shown.stdout


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--zero", 3), "ZeRO 3"),
        (("--lora-rank", 16), "adapters 43,646,976"),
        (("--lora-rank", 16, "--no-lora-freezes-rest"), "embedding 637,734,912"),
        (("--nodes", 2), "a card of 16"),
        (("--no-gradient-checkpointing",), "activations 35."),
    ],
)
def test_options_reach_the_estimate(options, said):
    rows = json.loads(run("--policy", "alpamayo-r1", "--gpu-memory", 80, *options, "--json").stdout)["rows"]
    assert any(said in f"{row['where']} {row['found']}" for row in rows if row["group"] == "memory")


def test_options_reach_the_steps(clean_export):
    changed = ("--batch", 1, "--epochs", 7, "--learning-rate", 3e-5, "--warmup-steps", 2, "--save-steps", 1)
    rows = json.loads(run("--policy", "alpamayo-r1", "--data", clean_export, *changed, "--json").stdout)["rows"]
    found = next(row["found"] for row in rows if row["check"] == "stage 1 steps")
    assert "x 7 epochs = 7 steps" in found and "3e-05 at most" in found and "warm-up 2" in found


def test_stages_are_chosen():
    rows = json.loads(run("--policy", "alpamayo-r1", "--stage", "1", "--json").stdout)["rows"]
    assert {row["check"] for row in rows if row["group"] == "steps"} == {"stage 1 steps"}


def test_failures_are_refused_in_one_error(plan):
    report = check(replace(plan, chunk_ids="7"))
    with pytest.raises(InputError, match=r"selects nothing.*olt sft preflight"):
        report.refuse()


@pytest.fixture(scope="module")
def mixture(clean_export, tmp_path_factory):
    """Six items of the clips of the export's store."""
    store = clean_export.parent / "store"
    components = [{"name": "nominal", "where": {"kind": "GT"}, "count": 6}]
    recipe = Recipe.model_validate({"name": "t", "description": "T.", "version": 1, "components": components})
    path = tmp_path_factory.mktemp("mixture") / "mixture.json"
    write_mixture(compose_mixture(recipe, read_clip_tables([store]), seed=0, allow_uncompared=True), path)
    return path


def toy(**changes):
    stages = tuple(replace(stage, warmup_steps=1) for stage in recipe_stages("toy"))
    return check(PreflightPlan("toy", stages, gpus=1, **changes))


@pytest.mark.parametrize("source", ["mixture", "store"])
def test_the_toy_is_looked_at_too(source, mixture, clean_export, tmp_path):
    data = mixture if source == "mixture" else clean_export.parent / "store"
    report = toy(data=data, out=tmp_path, seconds=60.0)
    assert not report.failures
    passed = {row.check for row in report.rows if row.verdict is Verdict.PASSED}
    assert {"samples", "verified", "pins", "space for checkpoints and samples"} <= passed


def test_decoded_samples_need_room_on_the_disk(mixture, tmp_path, monkeypatch):
    usage = SimpleNamespace(free=201 << 20)  # enough for checkpoints
    monkeypatch.setattr(toy_rows.shutil, "disk_usage", lambda _: usage)
    needed = [row for row in toy(data=mixture, out=tmp_path).failures if row.check.startswith("space")]
    assert len(needed) == 1 and "GB of decoded samples while it trains" in needed[0].found


def test_a_mixture_whose_samples_are_gone(mixture, tmp_path):
    text = mixture.read_text()
    path = tmp_path / "mixture.json"
    path.write_text(text.replace("/store", "/other"))
    assert any("no such clip store" in row.found for row in toy(data=path).failures)
    path.write_text(text[: len(text) // 2])
    assert any(row.check == "samples" for row in toy(data=path).failures)
    path.unlink()
    assert any(row.found == "no such file or folder" for row in toy(data=path).failures)


def test_help_of_the_command_loads_nothing_heavy():
    heavy = ("torch", "pandas", "polars", "packaging")
    code = f"import sys, olt_sft_recipes.commands.sft; print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
