"""`olt data`: from a data set to a split, checked table and a store of built clips."""

import json

import polars as pl
import pytest
from polars.testing import assert_frame_equal
from typer.testing import CliRunner

from olt_datasets.commands.data import app
from olt_datasets.commands.mix import app as mix
from olt_datasets.tables.clip_frame import SHARES, read_clip_tables
from olt_generator.errors import InputError
from olt_toolkit.rigs.rig import POLICY_CAMERAS

from ..toy_drives import ToyDataset, make_drive


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=True)


@pytest.fixture
def toy(open_toy):
    """Two drives of fifteen seconds with true views, and the options that open them."""
    drives = {key: make_drive(key, 150, true_views=POLICY_CAMERAS) for key in ("a", "b")}
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
    assert (summary["clips"], summary["clips_with_samples"], summary["samples"]) == (6, 4, 4)
    unsplit = run("build", table, "--root", root, "--kind", "GT", "--out", store, *options)
    assert "run `olt data split` before" in str(unsplit.exception)
    unused = run("build", table, "--root", root, "--kind", "GT", "--out", store, "--front", "as-is", *options)
    assert "--front: clips of kind GT take true views" in str(unused.exception)

    result = run("split", table, "--rule", "seen", "--test", 0.5, "--out", table, "--json")
    assert {name: json.loads(result.stdout)[name] for name in ("clips", "scenes", "samples")} == {
        "clips": {"train": 2, "test": 4},
        "scenes": {"train": 2, "test": 2},
        "samples": {"train": 2, "test": 2},
    }
    result = run("check", table)
    assert result.exit_code == 0
    assert result.stdout.startswith("no leaks in what was compared\nclips by split: 2 train, 4 test\n")
    assert "near-duplicate: 8 pairs of clips" in result.stdout
    result = run(
        *("build", table, "--root", root, "--kind", "GT", "--out", store),
        *("--width", 64, "--height", 36, "--json", *options),
    )
    assert result.exit_code == 0, result.output
    assert [clip["state"] for clip in json.loads(result.stdout)["clips"]] == ["built"] * 6
    of_the_files = ("store", "checksum", "fingerprint", "doubts", "build_options")
    of_the_files += ("acceleration_noise", "acceleration_noise_basis", "action_errors", *SHARES)
    built, indexed = (read_clip_tables([path]).drop(of_the_files) for path in (store, table))
    assert_frame_equal(built, indexed)
    assert read_clip_tables([store])["doubts"].to_list() == [[]] * 6
    assert read_clip_tables([table])["doubts"].to_list() == [None] * 6


def test_damaged_drives_are_listed_at_the_end(toy, tmp_path):
    dataset, root, options = toy
    dataset.broken = ("bad",)
    result = run("index", root, "--out", tmp_path / "clips.parquet", "--keep-going", *options)
    assert isinstance(result.exception, InputError)
    assert "failed: bad: bad: poses are missing" in result.stdout
    assert "1 of 3 drives could not be used" in str(result.exception)
    assert read_clip_tables([tmp_path / "clips.parquet"]).height == 6


def test_a_table_is_not_clean_for_want_of_something_to_compare(toy, tmp_path):
    """No fingerprints, images of a wall, one split only: each is said, and taken as it is where that is asked for."""
    dataset, root, options = toy
    table = tmp_path / "clips.parquet"

    def check(*more):
        result = run("check", table, *more)
        return result.exit_code, result.stdout

    run("index", root, "--out", table, "--frames", 30, "--no-fingerprints", *options)
    status, out = check()
    assert (status, out.splitlines()[0]) == (1, "nothing was compared: no clip is in a split")
    run("split", table, "--rule", "external", "--source", "toy", "--out", table)
    status, out = check()
    assert (status, out.splitlines()[0]) == (1, "nothing was compared: all clips are in split test")
    assert run("check", table, "--allow-uncompared").exit_code == 0

    run("split", table, "--rule", "seen", "--test", 0.5, "--out", table)
    status, out = check()
    assert status == 1 and "near-duplicate: 0 pairs" in out and "8 not compared, 6 clips with no fingerprint" in out
    dataset.looks = {"a": None}
    run("index", root, "--out", table, "--frames", 30, *options)
    status, out = check()
    assert status == 1 and "near-duplicate: 2 pairs" in out and "3 clips with images too plain to compare" in out
    assert check("--allow-uncompared")[0] == 0
    listed = json.loads(check("--json")[1])
    assert (listed["clean"], listed["complete"], listed["leaks"]) == (False, False, [])
    assert [each["compared"] for each in listed["comparisons"]] == [0, 0, 8, 2]


def test_leaks_are_listed_with_exit_status_1(write_store, make_clip):
    store = write_store(make_clip(1), make_clip(2, scene_id="scene_1", kind="Syn", split="test"), make_clip(3))
    result = run("check", store, "--held-out", "scene_3", "--external", "world")
    assert result.exit_code == 1
    assert result.stdout.startswith("4 leaks: 1 held out, 2 external, 1 twin\n")
    listed = json.loads(run("check", store, "--json").stdout)
    assert (listed["clean"], [leak["rule"] for leak in listed["leaks"]]) == (False, ["twin"])
    assert listed["leak_counts"] == {"twin": 1}


def test_all_leaks_are_written_where_a_report_tells_the_first_alone(write_store, make_clip, tmp_path, monkeypatch):
    monkeypatch.setattr("olt_datasets.tables.leak_listing.TOLD", 2)
    pairs = [
        make_clip(2 * scene + (split == "test"), scene_id=f"s{scene}", split=split)
        for scene in range(5)
        for split in ("train", "test")
    ]
    store, out = write_store(*pairs), tmp_path / "leaks.parquet"
    result = run("check", store, "--external", "world", "--leaks", out)
    assert result.exit_code == 1
    assert result.stdout.startswith("10 leaks: 5 external, 5 overlap\n  external: scene s0: ")
    assert f"  and 6 more; {out} lists them" in result.stdout.splitlines()
    rows = pl.read_parquet(out)
    assert rows["rule"].value_counts().sort("rule").rows() == [("external", 5), ("overlap", 5)]
    first = rows.filter(rule="overlap").sort("scene_id").to_dicts()[0]
    assert (first["scene_id"], first["split"], first["split_other"], first["pairs"]) == ("s0", "train", "test", 1)
    assert (first["clip_id"][-1], first["clip_id_other"][-1], first["scene_id_other"]) == ("0", "1", "s0")
    for name, message in (("leaks.csv", "give a name that ends in .parquet"), ("clips.parquet", "another name")):
        refused = run("check", store / "clips.parquet", "--leaks", store / name)
        assert message in str(refused.exception)
    assert read_clip_tables([store]).height == 10


@pytest.mark.parametrize(("recipe", "samples"), [("base_r1", 0), ("nv_ood_syn", 12_248), ("gt_longtail", 13_248)])
def test_the_recipes_of_the_paper_compose_from_a_fake_table(tmp_path, recipe, samples):
    table = tmp_path / "fake.parquet"
    assert run("fake", table, "--clips", 100_000).exit_code == 0
    result = CliRunner().invoke(mix, ["compose", recipe, "--stores", str(table), "--json"])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["samples_per_epoch"] == samples
