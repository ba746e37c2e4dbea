import json
import re

import polars as pl
import pytest
from typer.testing import CliRunner

from olt_datasets.commands.mix import app
from olt_datasets.mixtures.mixture import compose_mixture
from olt_datasets.mixtures.mixture_file import MIXTURE_SUFFIXES, read_mixture
from olt_datasets.mixtures.recipe import find_recipe
from olt_datasets.tables.clip_frame import read_clip_tables
from olt_generator.errors import InputError
from olt_toolkit.clips.table import CLIP_TABLE


def run(*arguments):
    """Run `olt mix` as its frame does; gives the exit status and standard output, and lets InputError through."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout


@pytest.fixture
def stores(write_store, make_clip):
    nominal = [make_clip(number, samples=10) for number in range(6)]
    work_zones = [make_clip(100 + number, kind="Syn", category="work_zone", samples=10) for number in range(3)]
    return ["--stores", write_store(*nominal, name="gt"), "--stores", write_store(*work_zones, name="syn")]


@pytest.fixture(params=MIXTURE_SUFFIXES)
def plan(stores, tmp_path, request):
    path = (tmp_path / "mixture").with_suffix(request.param)
    run("compose", "toy_nominal_long_tail", *stores, "--out", path)
    return path


def test_compose_shows_what_was_asked_and_got(stores):
    status, out = run("compose", "toy_nominal_long_tail", *stores, "--seed", 3, "--json")
    summary = json.loads(out)
    assert status == 0
    assert [(part["asked"], part["got"], part["distinct"]) for part in summary["components"]] == [
        (256, 256, 60),
        (256, 256, 30),
    ]
    assert (summary["seed"], summary["file"]) == (3, None)
    assert summary["by_kind"] == {"GT": {"got": 256, "distinct": 60}, "Syn": {"got": 256, "distinct": 30}}
    status, out = run("compose", "toy_nominal_long_tail", *stores)
    assert status == 0 and "512 samples per epoch" in out and "work_zone" in out


def test_written_mixture_gives_the_same_batches(plan, stores):
    composed = compose_mixture(find_recipe("toy_nominal_long_tail"), read_clip_tables(stores[1::2]), seed=0)
    written = read_mixture(plan)
    assert list(written.epoch(1, 8)) == list(composed.epoch(1, 8))
    assert written.describe() == composed.describe()


def test_composing_twice_writes_the_same_bytes(plan, stores):
    before = plan.read_bytes()
    run("compose", "toy_nominal_long_tail", "--stores", stores[3], "--stores", stores[1], "--out", plan)
    assert plan.read_bytes() == before


def test_refused_mixture_leaves_nothing_behind(stores, tmp_path):
    recipe = tmp_path / "greedy.yaml"
    recipe.write_text("name: greedy\ndescription: ''\nversion: 1\ncomponents: [{name: all, count: 1000}]\n")
    out = tmp_path / "out" / "mixture.json"
    with pytest.raises(InputError, match=r"component 'all' \{\} asks for 1000 samples"):
        run("compose", recipe, *stores, "--out", out)
    with pytest.raises(InputError, match=re.escape("give a name that ends in .json or .parquet")):
        run("compose", "toy_nominal", *stores, "--out", out.with_suffix(".txt"))
    assert not out.parent.exists()


def test_show_tells_a_mixture_from_a_recipe(plan):
    status, out = run("show", plan, "--json")
    assert status == 0 and json.loads(out)["samples_per_epoch"] == 512
    status, out = run("show", "toy_nominal_long_tail", "--json")
    assert status == 0 and [part["share"] for part in json.loads(out)["components"]] == [0.5, 0.5]
    assert "long_tail" in run("show", plan)[1] and "long_tail" in run("show", "toy_nominal_long_tail")[1]


def test_check_lists_shortages_and_leaks(stores, write_store, make_clip):
    status, out = run("check", "toy_nominal_long_tail", *stores, "--json")
    assert status == 0 and json.loads(out)["accepted"]
    twin = make_clip(200, kind="front_only", split="test", scene_id="scene_1", samples=0)
    status, out = run("check", "toy_nominal", *stores, "--stores", write_store(twin, name="twin"), "--json")
    findings = json.loads(out)
    assert status == 1 and not findings["accepted"]
    (leak,) = findings["leaks"]
    assert leak["scene_id"] == "scene_1" and leak["detail"].startswith("its GT clips in split train")
    status, out = run("check", "toy_nominal_long_tail", *stores[:2])
    assert status == 1 and "refused" in out and "'long_tail'" in out
    (shortage,) = json.loads(run("check", "toy_nominal_long_tail", *stores[:2], "--json")[1])["shortages"]
    assert (shortage["component"], shortage["asked"], shortage["clips"]) == ("long_tail", 256, 0)
    assert shortage["split_holds"] == [{"kind": "GT", "category": "nominal", "source": "world", "clips": 6}]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda plan: plan.update(version=2), "version is 2, this release reads 3; compose it again"),
        (lambda plan: plan.pop("seed"), "seed: Field required"),
        (lambda plan: plan.update(more=1), "more: Extra inputs are not permitted"),
        (lambda plan: plan["available"].pop(), "file: Value error, the recipe and the mixture differ"),
        (lambda plan: plan["recipe"]["components"][0].update(share=0.4), "recipe: Value error, the shares sum to 0.9"),
        (lambda plan: plan["distinct"].insert(0, plan["distinct"].pop() + 1), "samples: some are missing"),
        (lambda plan: plan["samples"]["clip_id"].__setitem__(3, None), "samples: some are missing"),
        (lambda plan: plan["samples"]["t0_us"].reverse(), "samples: not those that were composed"),
        (lambda plan: plan["samples"]["t0_us"].pop(), "not a mixture ("),
        (lambda plan: plan["samples"]["t0_us"].__setitem__(3, "soon"), "not a mixture ("),
        (lambda plan: plan.update(samples=[1, 2]), "not a mixture ("),
    ],
)
def test_damaged_mixture_is_refused_by_field(stores, tmp_path, change, message):
    plan = tmp_path / "mixture.json"
    run("compose", "toy_nominal_long_tail", *stores, "--out", plan)
    content = json.loads(plan.read_text())
    change(content)
    plan.write_text(json.dumps(content))
    with pytest.raises(InputError, match=re.escape(f"{plan}: {message}")):
        read_mixture(plan)


@pytest.mark.parametrize("suffix", MIXTURE_SUFFIXES)
def test_files_that_hold_no_mixture_are_refused(stores, tmp_path, suffix):
    path = tmp_path / f"mixture{suffix}"
    with pytest.raises(InputError, match="cannot read this mixture"):
        run("show", path)
    for content in (b"no mixture", b"[]", b""):
        path.write_bytes(content)
        with pytest.raises(InputError, match="not a mixture"):
            run("show", path)
    table = stores[1] / CLIP_TABLE
    with pytest.raises(InputError, match="not a mixture"):
        run("show", table)


def test_compose_counts_steps_for_the_stages_that_are_given(stores):
    training = json.loads(run("compose", "toy_nominal", *stores, "--json")[1])["training"]
    assert {stage: numbers["total_steps"] for stage, numbers in training.items()} == {"8x1x4x3": 48, "8x1x1x3": 192}
    training = json.loads(run("compose", "toy_nominal", *stores, "--stage", "2x3x1x5", "--json")[1])["training"]
    assert training["2x3x1x5"] | {"steps_per_epoch": 86, "total_steps": 430, "padded_samples": 4} == training["2x3x1x5"]
    assert "2x3x1x5" in run("compose", "toy_nominal", *stores, "--stage", "2x3x1x5")[1]
    with pytest.raises(InputError, match="stage 'all': write DEVICESx"):
        run("compose", "toy_nominal", *stores, "--stage", "all")


def test_compose_draws_its_shares(stores, tmp_path):
    pictures = [tmp_path / "one.png", tmp_path / "two.png"]
    for picture in pictures:
        run("compose", "toy_nominal_long_tail", *stores, "--picture", picture)
    assert pictures[0].read_bytes()[:4] == b"\x89PNG" and pictures[0].read_bytes() == pictures[1].read_bytes()


def test_a_base_model_is_composed_of_nothing(stores, tmp_path):
    out = tmp_path / "base.json"
    status, text = run("compose", "base_r1", *stores, "--out", out, "--picture", tmp_path / "base.png", "--json")
    summary = json.loads(text)
    assert status == 0 and (summary["samples_per_epoch"], summary["components"], summary["by_kind"]) == (0, [], {})
    assert run("show", out)[0] == 0 and run("show", "base_r1")[0] == 0
    with pytest.raises(InputError, match="recipe base_r1 has no samples to train on"):
        read_mixture(out).epoch(0, 32)


def test_diff_tells_recipes_samples_and_shares_apart(stores, tmp_path):
    paths = [tmp_path / "nominal.json", tmp_path / "long_tail.parquet"]
    for path, recipe in zip(paths, ("toy_nominal", "toy_nominal_long_tail"), strict=True):
        run("compose", recipe, *stores, "--out", path)
    only = tmp_path / "only.parquet"
    found = json.loads(run("diff", *paths, "--out", only, "--json")[1])
    assert found["samples"] == {"both": 60, "only_first": 0, "only_second": 30}
    assert found["components"]["long_tail"] == {"both": 0, "only_first": 0, "only_second": 30}
    assert found["recipe"]["components.nominal.share"] == [1.0, 0.5]
    assert found["recipe"]["components.long_tail.repeats"] == [None, 16]
    assert found["by_kind"] == {"GT": [1.0, 0.5], "Syn": [0.0, 0.5]}
    samples = pl.read_parquet(only)
    assert (
        samples["mixture"].unique().to_list() == ["second"] and set(samples["kind"]) == {"Syn"} and len(samples) == 30
    )
    text = run("diff", *paths)[1]
    assert "+50.00%" in text and "long_tail" in text
    same = json.loads(run("diff", paths[0], paths[0], "--json")[1])
    assert same["recipe"] == {} and same["samples"] == {"both": 60, "only_first": 0, "only_second": 0}
