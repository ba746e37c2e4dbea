"""The toy by the same command; what it does is tested where it is trained."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from typer.testing import CliRunner

from olt_datasets import compose_mixture, read_clip_tables, write_mixture
from olt_datasets.mixtures.recipe import parse_recipe
from olt_generator.errors import InputError
from olt_sft_recipes.commands import launch as launching
from olt_sft_recipes.commands.mixtures import choose_mixture
from olt_sft_recipes.commands.sft import app
from olt_sft_recipes.launch import toy
from olt_sft_recipes.training import two_stages
from olt_sft_recipes.training.stage_config import StageConfig
from olt_toolkit.rigs.contracts import DEFAULT_CONTRACT

from ...straight_clips import straight_clip, write_clips


@pytest.fixture
def asked(monkeypatch):
    """What the toy is launched with, and which mixture was asked for; nothing is trained."""
    seen = {}

    def launch_toy(mixture, out, **settings):
        seen.update(settings, mixture=mixture, out=out)
        return {"policy": str(out / "policy")}

    monkeypatch.setattr(toy, "launch_toy", launch_toy)
    monkeypatch.setattr(launching, "choose_mixture", lambda *arguments: arguments)
    return seen


def test_the_toy_takes_a_recipe_stores_stages_and_processes(asked, tmp_path):
    words = ["launch", "--policy", "toy", "--recipe", "nv_ood_syn", "--stores", "drives", "--stage", "2", "--seed", "5"]
    words += ["--processes", "2", "--out", str(tmp_path), "--dry-run", "--json"]
    result = CliRunner().invoke(app, words, catch_exceptions=False)
    assert json.loads(result.stdout) == {"policy": str(tmp_path / "policy")}
    assert asked["stage"] == "2" and asked["processes"] == 2 and asked["seed"] == 5 and asked["dry_run"] is True
    assert asked["mixture"][1] == "nv_ood_syn" and toy.HELD_OUT_SCENES in asked["mixture"]


def test_seeds_of_the_stages_count_unless_one_is_given(monkeypatch):
    trained = []
    monkeypatch.setattr(
        two_stages, "MixtureDataset", lambda *_, **__: SimpleNamespace(load_batch=None, name_sample=None)
    )
    monkeypatch.setattr(two_stages, "train_two_stages", lambda stages, *_: trained.append([s.seed for s in stages]))
    mixture: Any = SimpleNamespace(epoch=None)
    stages = StageConfig(stage=1, seed=3), StageConfig(stage=2, seed=4)
    for seed in (None, 0, 5):
        two_stages.train_on_mixture(mixture, stages, seed, Path("out"))
    assert trained == [[3, 4], [0, 0], [5, 5]]


def test_no_seed_is_given_where_none_is_asked_for(asked, tmp_path):
    CliRunner().invoke(app, ["launch", "--policy", "toy", "--out", str(tmp_path), "--json"], catch_exceptions=False)
    assert asked["seed"] is None
    with pytest.raises(InputError, match="--seed"):
        words = ["launch", "--policy", "alpamayo-r1", "--base", "b", "--recipes", "r", "--pai", "p", "--seed", "1"]
        CliRunner().invoke(app, words, catch_exceptions=False)


@pytest.mark.parametrize("option", [["--gpus", "1"], ["--slurm"], ["--lora"], ["--base", "x"], ["--nodes", "1"]])
def test_what_is_of_alpamayo_is_refused_for_the_toy(asked, option):
    with pytest.raises(InputError, match=option[0]):
        CliRunner().invoke(app, ["launch", "--policy", "toy", *option], catch_exceptions=False)
    assert not asked


def test_processes_are_of_the_toy(asked):
    with pytest.raises(InputError, match="--processes"):
        CliRunner().invoke(app, ["launch", "--policy", "alpamayo-r1", "--processes", "2"], catch_exceptions=False)


def test_stores_without_clips_to_judge_by_take_nothing_from_those_that_have_some(tmp_path):
    held_out = [straight_clip(f"held out {number}", split="val") for number in range(20)]
    stores = [write_clips(tmp_path / "judged", held_out)]
    stores += [write_clips(tmp_path / name, [straight_clip(name)]) for name in ("nominal", "long_tail")]
    alone, among = (toy.validation_of(each, DEFAULT_CONTRACT, ()) for each in (stores[:1], stores))
    assert 32 <= len(among.samples) <= 64 and len({sample.clip_id for sample in among.samples}) == 20
    assert among.identity(1) == alone.identity(1)


def write_straight_mixture(store, path, samples=4):
    """A mixture of all clips of a store of straight drives."""
    parts = [{"name": "all", "where": {"kind": "GT"}, "share": 1.0, "repeats": samples}]
    recipe = {"name": "straight", "description": "", "version": 1, "samples": samples, "components": parts}
    mixture = compose_mixture(parse_recipe(recipe, "test"), read_clip_tables([store]), 0, allow_uncompared=True)
    write_mixture(mixture, path)
    return mixture


def test_a_mixture_of_scenes_that_judge_is_refused(tmp_path):
    path = tmp_path / "mixture.json"
    write_straight_mixture(write_clips(tmp_path / "store", [straight_clip("shown")]), path)
    assert len(choose_mixture(path, None, [], None, False, ["another"])) == 4
    with pytest.raises(InputError, match=r"mixture\.json: trains on shown, which is kept to judge by"):
        choose_mixture(path, None, [], None, False, ["another", "shown"])


@pytest.mark.parametrize(
    ("words", "match"),
    [
        (["--judge-on", "store"], "--judge-on .*no clip of split val"),
        (["--judge-scene", "nominel:1"], "nominel"),
        (["--stores", "nowhere"], "--stores"),
    ],
)
def test_what_does_nothing_is_refused_before_anything_is_trained(tmp_path, monkeypatch, words, match):
    monkeypatch.chdir(tmp_path)
    write_straight_mixture(write_clips(tmp_path / "store", [straight_clip("trained on")]), tmp_path / "mixture.json")
    with pytest.raises(InputError, match=match):
        CliRunner().invoke(app, ["train", "--mixture", "mixture.json", "--out", "out", *words], catch_exceptions=False)
    assert not (tmp_path / "out").exists()


def test_a_store_that_was_built_again_is_trained_on_anew_and_one_that_was_moved_is_not(tmp_path, tiny_config):
    def train(store, out):
        mixture = write_straight_mixture(store, tmp_path / "mixture.json")
        stages = [StageConfig(stage=stage, num_train_epochs=1, warmup_steps=0) for stage in (1, 2)]
        return two_stages.train_on_mixture(mixture, (stages[0], stages[1]), None, out, model_config=tiny_config)

    first = train(write_clips(tmp_path / "first", [straight_clip("drive")]), tmp_path / "out")
    assert train((tmp_path / "first").rename(tmp_path / "moved"), tmp_path / "out") == first
    again = train(write_clips(tmp_path / "again", [straight_clip("drive", grey=120)]), tmp_path / "out")
    assert again[0].losses != first[0].losses
