"""`olt data`: from a data set to a split, checked table and a store of built clips."""

import json

import pytest
from polars.testing import assert_frame_equal
from typer.testing import CliRunner

from olt_datasets.commands.data import app
from olt_datasets.commands.mix import app as mix
from olt_datasets.tables.clip_frame import read_clip_tables
from olt_generator.errors import InputError
from olt_toolkit.rigs.rig import POLICY_CAMERAS

from ..toy_drives import ToyDataset, make_drive


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=True)


@pytest.fixture
def toy(open_toy):
    """Two drives of ten seconds with true views, and the options that open them."""
    drives = {key: make_drive(key, 100, true_views=POLICY_CAMERAS) for key in ("a", "b")}
    place, dataset = open_toy(ToyDataset(drives))
    return dataset, place.path, ("--cache", place.cache, "--workers", 1)


def test_sources_are_listed_with_their_terms():
    result = run("sources")
    assert result.exit_code == 0, result.output
    for name in ("pav", "nuscenes", "kitti_raw", "non-commercial"):
        assert name in result.stdout.lower()


def test_from_a_data_set_to_built_clips(toy, tmp_path):
    _, root, options = toy
    table, store = tmp_path / "clips.parquet", tmp_path / "store"
    result = run("index", root, "--out", table, "--frames", 30, "--t0", "keyframe", "--json", *options)
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert (summary["clips"], summary["clips_with_samples"], summary["samples"]) == (4, 2, 2)
    unsplit = run("build", table, "--root", root, "--kind", "GT", "--out", store, *options)
    assert "run `olt data split` before" in str(unsplit.exception)
    unused = run("build", table, "--root", root, "--kind", "GT", "--out", store, "--front", "as-is", *options)
    assert "--front: clips of kind GT take true views" in str(unused.exception)

    result = run("split", table, "--rule", "seen", "--test", 0.5, "--out", table, "--json")
    assert json.loads(result.stdout)["clips"] == {"train": 2, "test": 2}
    assert run("check", table).stdout == "no leaks\n"
    result = run(
        *("build", table, "--root", root, "--kind", "GT", "--out", store),
        *("--width", 64, "--height", 36, "--json", *options),
    )
    assert result.exit_code == 0, result.output
    assert [clip["state"] for clip in json.loads(result.stdout)["clips"]] == ["built"] * 4
    of_the_files = ("store", "checksum", "fingerprint", "doubts", "build_options")
    built, indexed = (read_clip_tables([path]).drop(of_the_files) for path in (store, table))
    assert_frame_equal(built, indexed)
    assert read_clip_tables([store])["doubts"].to_list() == [[]] * 4
    assert read_clip_tables([table])["doubts"].to_list() == [None] * 4


def test_damaged_drives_are_listed_at_the_end(toy, tmp_path):
    dataset, root, options = toy
    dataset.broken = ("bad",)
    result = run("index", root, "--out", tmp_path / "clips.parquet", "--keep-going", *options)
    assert isinstance(result.exception, InputError)
    assert "failed: bad: bad: poses are missing" in result.stdout
    assert "1 of 3 drives could not be used" in str(result.exception)
    assert read_clip_tables([tmp_path / "clips.parquet"]).height == 4


def test_leaks_are_listed_with_exit_status_1(write_store, make_clip):
    store = write_store(make_clip(1), make_clip(2, scene_id="scene_1", kind="Syn", split="test"), make_clip(3))
    result = run("check", store, "--held-out", "scene_3", "--external", "world")
    assert result.exit_code == 1
    assert result.stdout.startswith("4 leaks: 1 held out, 2 external, 1 twin\n")
    listed = json.loads(run("check", store, "--json").stdout)
    assert (listed["clean"], [leak["rule"] for leak in listed["leaks"]]) == (False, ["twin"])


@pytest.mark.parametrize(("recipe", "samples"), [("base_r1", 0), ("nv_ood_syn", 12_248), ("gt_longtail", 13_248)])
def test_the_recipes_of_the_paper_compose_from_a_fake_table(tmp_path, recipe, samples):
    table = tmp_path / "fake.parquet"
    assert run("fake", table, "--clips", 100_000).exit_code == 0
    result = CliRunner().invoke(mix, ["compose", recipe, "--stores", str(table), "--json"])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["samples_per_epoch"] == samples
