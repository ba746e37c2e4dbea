"""Faults planted into an export: each is found, where it is, with advice."""

import io
import json
import zipfile
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_datasets import contents_of_stores, export_pai
from olt_sft_recipes.preflight.check import check
from olt_sft_recipes.preflight.data_rows import spread
from olt_sft_recipes.preflight.plan import PreflightPlan, recipe_stages
from olt_sft_recipes.preflight.recipe_folder import selected_numbers
from olt_sft_recipes.preflight.rows import Verdict
from olt_toolkit.clips.clip import make_clip_id

from ...published_features import write_published_features
from ...straight_clips import straight_clip, write_clips

TELE = "camera_front_tele_30fov"


def look(data, **changes):
    """Rows about the training data alone."""
    plan = PreflightPlan("alpamayo-r1", recipe_stages("alpamayo-r1"), data=data, seconds=60.0, gpus=1)
    rows = check(replace(plan, **changes)).rows
    return [row for row in rows if row.group == "data"]


def failures(data, **changes):
    return [
        f"{row.check}: {row.where}: {row.found}; {row.action}"
        for row in look(data, **changes)
        if row.verdict is Verdict.FAILED
    ]


def edit_features(export, change):
    table = pd.read_csv(export / "features.csv", dtype=str)
    change(table.set_index("feature", drop=False)).to_csv(export / "features.csv", index=False)


def edit_index(export, change):
    path = export / "clip_index.parquet"
    change(pd.read_parquet(path)).to_parquet(path)


def edit_member(export, name, change, chunk=0, folder="camera"):
    """Rewrite a chunk's archive; `change` takes a member's name and bytes and gives new bytes, or None to drop it."""
    path = export / folder / name / f"{name}.chunk_{chunk:04d}.zip"
    with zipfile.ZipFile(path) as archive:
        members = {member: archive.read(member) for member in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for member, content in members.items():
            if (new := change(member, content)) is not None:
                archive.writestr(member, new)


def edit_motion(export, change):
    def edit(member, content):
        buffer = io.BytesIO()
        change(pd.read_parquet(io.BytesIO(content))).to_parquet(buffer)
        return buffer.getvalue()

    edit_member(export, "egomotion", edit, folder="labels")


def test_a_clean_export_has_no_failures(clean_export):
    rows = look(clean_export, chunk_ids="0-2")
    assert not [row for row in rows if row.verdict is Verdict.FAILED]
    told = {row.check: row.found for row in rows}
    assert told["train chunks"].startswith("3 of 3 clips") and told["train clips"].startswith("3 of 3 clips opened")
    assert "images of 3 decoded (36 x 64)" in told["train clips"] and told["verified"].startswith("3 of 3 clips")


def test_a_published_table_of_features_is_read(export):
    write_published_features(export)
    assert not failures(export)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda table: table.drop(TELE), f"no row {TELE} in directory camera"),
        (lambda table: table.replace({"directory": {"labels": "ego"}}), "no row egomotion in directory labels"),
        (lambda table: table.assign(clip_files_in_zip=table["clip_files_in_zip"].fillna("{}")), "must name members"),
        (lambda table: table.replace("frame_timestamps", "times", regex=True), "no member 'frame_timestamps'"),
        (lambda table: table.replace("camera/", "../camera/", regex=True), "leads out of the folder"),
        (lambda table: table.replace("chunk_id:04d", "chunk", regex=True), "paths cannot be made"),
        (lambda table: table.replace(":04d", ":099999999d", regex=True), "paths cannot be made"),
        (lambda table: table.drop(columns="directory"), "column directory is missing"),
        (lambda table: pd.concat([table, table.iloc[:1]]), "a feature is there twice"),
    ],
)
def test_faults_of_the_feature_table(export, change, said):
    edit_features(export, change)
    assert any(each.startswith("train features.csv") and said in each for each in failures(export))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda index: index.reset_index(), "its index is"),
        (lambda index: index.astype({"chunk": float}), "column chunk is float64"),
        (lambda index: pd.concat([index, index.iloc[:1]]), "more than once"),
        (lambda index: index.drop(columns="chunk"), "column chunk is missing"),
        (lambda index: index.assign(clip_is_valid=[True, False, True]), "1 clips are not valid"),
        (lambda index: index.assign(split=["train", "test", "train"]), "1 clips are of split test"),
        (lambda index: index.assign(chunk=[0, 0, 0]), "members are missing"),
    ],
)
def test_faults_of_the_clip_index(export, change, said):
    edit_index(export, change)
    found = failures(export)
    assert any(said in each for each in found), found


@pytest.mark.parametrize(
    ("chunk_ids", "said"),
    [
        ("1", "without '-' selects nothing"),
        ("5-9", "no clip has these chunks"),
        ("1-1", "no clip has these chunks"),
        ("0-5", "3 of its 5 chunks have no clip, as 2"),
        ("a-b", "two whole numbers"),
    ],
)
def test_a_selection_that_takes_not_what_it_says(clean_export, chunk_ids, said):
    assert any(each.startswith("train chunks") and said in each for each in failures(clean_export, chunk_ids=chunk_ids))


def test_the_last_number_of_a_selection_does_not_count(clean_export):
    (row,) = [row for row in look(clean_export, chunk_ids="0-1") if row.check == "train chunks"]
    assert row.verdict is Verdict.NOTE and "2 of 3 clips" in row.found and "chunk 1 (1 clips) is left out" in row.found
    assert "0-2" in row.action


@pytest.mark.parametrize(
    ("chunks", "chunk_ids", "verdict", "said", "action"),
    [
        ([0, 0, 1], "1-2", Verdict.NOTE, "chunk 0 (2 clips) is left out, for chunks count from 0", "0-2"),
        ([1, 1, 1], "0-1", Verdict.FAILED, "0 of 3 clips are selected", "1-2"),
        ([1, 1, 2], "1-2", Verdict.NOTE, "2 of 3 clips are selected", "1-3"),
        ([0, 1, 1], "0-1", Verdict.NOTE, "1 of 3 clips are selected", "0-2"),
        ([0, 0, 4], "0-5", Verdict.NOTE, "3 of its 5 chunks have no clip, as 1", ""),
        ([0, 0, 4], "0-6", Verdict.FAILED, "4 of its 6 chunks have no clip, as 1", "0-5"),
        ([3, 3, 4], "2-5", Verdict.FAILED, "1 of its 3 chunks have no clip, as 2", "3-5"),
        ([3, 3, 4], "3-5", Verdict.PASSED, "3 of 3 clips are selected, of chunks 3 to 4", ""),
    ],
)
def test_ranges_that_are_off_by_one_or_have_gaps(export, chunks, chunk_ids, verdict, said, action):
    edit_index(export, lambda index: index.assign(chunk=chunks))
    (row,) = [row for row in look(export, chunk_ids=chunk_ids) if row.check == "train chunks"]
    assert row.verdict is verdict and said in row.found and action in row.action


@pytest.fixture(scope="session")
def braking_export(tmp_path_factory):
    """17 clips at 20 m/s, one of which brakes by 9 m/s² from 6 s on: beyond what tokens can say."""
    times = 0.1 * np.arange(126)
    slowing = np.clip(times - 6.0, 0.0, 20.0 / 9.0)
    braking = 20.0 * times - 9.0 * slowing * (times - 6.0 - 0.5 * slowing)
    along = {f"steady {number}": 20.0 * times for number in range(16)} | {"braking": braking}
    clips = [straight_clip(name, 126, slice(46, 55), along=path) for name, path in along.items()]
    folder = tmp_path_factory.mktemp("braking")
    export_pai(contents_of_stores([write_clips(folder / "store", clips)], "train"), folder / "pai", verify=False)
    return folder / "pai"


@pytest.mark.parametrize(("allowed", "verdict"), [(0.005, Verdict.FAILED), (0.02, Verdict.NOTE)])
def test_tokens_that_saturate_in_one_sample_of_17(braking_export, allowed, verdict):
    (row,) = [
        row for row in look(braking_export, most_saturated=allowed, clips=1) if row.check == "train saturated tokens"
    ]
    assert row.verdict is verdict and "in 1 of 17 samples of 17" in row.found
    assert make_clip_id("braking") in row.found and make_clip_id("braking") in row.action


def test_nothing_saturates_in_a_steady_drive(clean_export):
    (row,) = [row for row in look(clean_export) if row.check == "train saturated tokens"]
    assert row.verdict is Verdict.PASSED and "0 of 384 (0.00%), in 0 of 3 samples of 3" in row.found


@given(st.integers(0, 50), st.integers(0, 50))
def test_selected_numbers_are_those_of_the_readers_rule(first, last):
    assert list(selected_numbers(f"{first}-{last}")) == list(range(first, last))
    assert not list(selected_numbers(f"{first}"))


def test_clips_that_are_trained_on_and_validated_with(clean_export):
    changes = {"val_data": clean_export, "val_chunk_ids": "1-2"}
    assert any("1 clips are trained on and validated with" in each for each in failures(clean_export, **changes))
    assert not failures(clean_export, chunk_ids="0-1", **changes)


def test_a_keyframe_that_motion_or_images_do_not_cover(export):
    edit_motion(export, lambda table: table[table["timestamp"] < 11_400_000])
    assert any("needs 3.6 s to 11.5 s" in each for each in failures(export))


def test_event_times_are_taken_only_where_they_are_asked_for(export):
    early = [np.array([1_500_000])] * 3
    edit_index(export, lambda index: index.assign(event_t0s=early))
    assert not [each for each in failures(export) if each.startswith("train clips")]
    assert any("is not after 1.6 s" in each for each in failures(export, use_default_keyframe=False))
    edit_index(export, lambda index: index.drop(columns="event_t0s"))
    assert any("no column event_t0s" in each for each in failures(export, use_default_keyframe=False))


def test_a_video_with_too_few_frames_or_of_no_frames(export):
    edit_member(export, TELE, lambda name, content: content[: len(content) // 2] if name.endswith(".mp4") else content)
    assert any(each.startswith("train clips") and TELE in each for each in failures(export))


def test_fewer_frames_than_timestamps(export):
    def edit(name, content):
        if name.endswith(".mp4"):
            return content
        times = pd.read_parquet(io.BytesIO(content))["timestamp"].tolist()
        buffer = io.BytesIO()
        pd.DataFrame({"timestamp": [*times, times[-1] + 100_000]}).to_parquet(buffer)
        return buffer.getvalue()

    edit_member(export, TELE, edit)
    assert any("9 frames for 10 timestamps" in each for each in failures(export))


def test_a_member_that_is_missing(export):
    edit_member(export, TELE, lambda name, content: None if name.startswith(make_clip_id("b")) else content)
    assert any("2 members are missing" in each and TELE in each for each in failures(export))


def test_what_data_verify_finds_is_told(export):
    edit_motion(export, lambda table: table.assign(y=table["y"] + 3.0 * (table["timestamp"] > 5_000_000)))
    assert any(each.startswith("verified") and "failed" in each for each in failures(export))


def test_a_folder_that_is_none(tmp_path):
    found = failures(tmp_path / "nothing")
    assert any("features.csv" in each for each in found) and any(each.startswith("verified") for each in found)


@pytest.fixture(scope="module")
def needed(clean_export):
    """The files that the recipe opens for a sample, and the tables of calibration."""
    kinds = ("camera", "labels", "calibration")
    named = [
        clean_export / name for name in ("features.csv", "clip_index.parquet", "metadata/feature_presence.parquet")
    ]
    return named + sorted(path for kind in kinds for path in (clean_export / kind).rglob("*") if path.is_file())


@pytest.fixture(scope="module")
def clean_rows(clean_export):
    return {(row.check, row.found.replace(str(clean_export), "")) for row in look(clean_export)}


@settings(max_examples=20)
@given(data=st.data())
def test_any_file_that_is_missing_or_cut_off_is_found(clean_export, clean_rows, needed, tmp_path_factory, data):
    path = data.draw(st.sampled_from(needed))
    kept = data.draw(st.none() | st.floats(0.0, 0.97))
    folder = tmp_path_factory.mktemp("links") / "pai"
    for each in (each for each in clean_export.rglob("*") if each.is_file()):
        (folder / each.relative_to(clean_export)).parent.mkdir(parents=True, exist_ok=True)
        (folder / each.relative_to(clean_export)).hardlink_to(each)
    damaged = folder / path.relative_to(clean_export)
    content = damaged.read_bytes()
    damaged.unlink()
    if kept is not None:
        damaged.write_bytes(content[: int(kept * len(content))])
    rows = look(folder)
    # A table of features that is cut between two rows of calibration lacks nothing that a sample needs.
    odd = {Verdict.FAILED, Verdict.NOTE} if path.name == "features.csv" else {Verdict.FAILED}
    assert any(row.verdict in odd and (row.check, row.found.replace(str(folder), "")) not in clean_rows for row in rows)


@given(st.integers(0, 60), st.integers(1, 70))
def test_what_is_opened_is_spread(length, count):
    items = list(range(length))
    chosen = spread(items, count)
    assert len(set(chosen)) == len(chosen) == min(length, count) and set(chosen) <= set(items)
    if count >= 2 and length > 1:
        assert {0, length - 1} <= set(chosen)


def test_time_that_runs_out_is_told(clean_export):
    told = {row.check: row.found for row in look(clean_export, seconds=0.0)}
    assert told["train clips"].startswith("1 of 3 clips opened") and told["verified"].startswith("1 of 3 clips")


def test_licences_of_an_export_are_told(clean_export, export):
    plan = PreflightPlan("alpamayo-r1", recipe_stages("alpamayo-r1"), data=clean_export)
    assert any(row.found == "3 clips: CC BY 4.0" for row in check(plan).rows if row.group == "licence")
    (export / "export.json").write_text(json.dumps({"clips": 3}))
    rows = check(replace(plan, data=export)).rows
    assert any("tells no licences" in row.found for row in rows if row.group == "licence")
