import json
import re

import pytest
from typer.testing import CliRunner

from olt_datasets.clip_table import read_clip_tables
from olt_datasets.commands.mix import app
from olt_datasets.mixture import compose_mixture
from olt_datasets.plan import read_plan
from olt_datasets.recipe import builtin_recipe
from olt_generator.errors import InputError


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


@pytest.fixture
def plan(stores, tmp_path):
    path = tmp_path / "mixture.json"
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
    composed = compose_mixture(builtin_recipe("toy_nominal_long_tail"), read_clip_tables(stores[1::2]), seed=0)
    written = read_plan(plan)
    assert written.epoch(1, 8) == composed.epoch(1, 8)
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
    with pytest.raises(InputError, match=re.escape("give a name that ends in .json")):
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
    assert findings["leaks"] == ["scene scene_1: its GT clips are in split train, its front_only clips in test"]
    status, out = run("check", "toy_nominal_long_tail", *stores[:2])
    assert status == 1 and "refused" in out and "'long_tail'" in out


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda plan: plan.update(version=2), "version: Input should be 1"),
        (lambda plan: plan.pop("seed"), "seed: Field required"),
        (lambda plan: plan.update(more=1), "more: Extra inputs are not permitted"),
        (lambda plan: plan["stores"].pop(), "file: Value error, a sample is of a store that is not listed"),
        (lambda plan: plan["components"].pop(), "file: Value error, the recipe and the plan differ"),
        (
            lambda plan: plan["components"][0]["samples"]["t0_us"].pop(),
            "components.0.samples: Value error, the columns",
        ),
        (lambda plan: plan["recipe"]["components"][0].update(share=0.4), "recipe: Value error, the shares sum to 0.9"),
    ],
)
def test_damaged_mixture_is_refused_by_field(plan, change, message):
    content = json.loads(plan.read_text())
    change(content)
    plan.write_text(json.dumps(content))
    with pytest.raises(InputError, match=re.escape(f"{plan}: {message}")):
        read_plan(plan)


def test_files_that_hold_no_mixture_are_refused(tmp_path):
    path = tmp_path / "mixture.json"
    with pytest.raises(InputError, match="cannot read this mixture"):
        run("show", path)
    path.write_text("not json")
    with pytest.raises(InputError, match="Invalid JSON"):
        run("show", path)
