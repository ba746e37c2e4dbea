"""`olt data verify`, on stores, mixtures and exports; builds and exports look for themselves."""

import json
import shutil
import zipfile

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from olt_datasets.benchmarks.store_surgery import change_motion, chunk_path
from olt_datasets.benchmarks.verified_clips import write_clean_store
from olt_datasets.commands.data import app
from olt_datasets.export.contents import contents_of_stores
from olt_datasets.export.lerobot import export_lerobot
from olt_datasets.export.pai import export_pai
from olt_datasets.mixtures.mixture import compose_mixture
from olt_datasets.mixtures.mixture_file import write_mixture
from olt_datasets.mixtures.recipe import RECIPE_VERSION, Component, Recipe
from olt_datasets.tables.clip_frame import read_clip_tables
from olt_generator.errors import InputError
from olt_toolkit.clips.pai_layout import CAMERA_INTRINSICS, EGOMOTION, STORED, VIDEO
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.table import CLIP_TABLE
from olt_toolkit.rigs.rig import FRONT_WIDE

from ...published_features import write_published_features

SIZE = (36, 64)


def run(*arguments):
    result = CliRunner().invoke(app, ["verify", *map(str, arguments), "--workers", "1"])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return write_clean_store(tmp_path_factory.mktemp("verify") / "store", 7, 3).root


@pytest.fixture(scope="module")
def lerobot(store, tmp_path_factory):
    out = tmp_path_factory.mktemp("lerobot") / "set"
    export_lerobot(contents_of_stores([store], "train"), out, image_size=SIZE)
    return out


@pytest.fixture
def bad_store(store, tmp_path):
    shutil.copytree(store, tmp_path / "bad")
    first = ClipStore(store).clips()[0].clip_id
    change_motion(tmp_path / "bad", first, lambda table: table.assign(x=100.0 * table["x"]))
    return tmp_path / "bad"


def test_a_good_store(store):
    status, out = run(store)
    assert status == 0
    assert "0 failed" in out and "along the heading" in out
    status, out = run(store, "--json", "--checks", "motion,times")
    summary = json.loads(out)
    assert (status, summary["clips"], summary["failed"], summary["failures"]) == (0, 2, 0, [])
    assert summary["checks"]["speed"]["passed"] == 2 and "video decodes" not in summary["checks"]


def test_a_bad_store_is_told_with_file_number_and_advice(bad_store):
    status, out = run(bad_store)
    assert status == 1
    assert "failed: speed:" in out and "egomotion" in out and "metres" in out and "at most 70" in out


def test_what_is_not_there_or_not_known(tmp_path, store):
    with pytest.raises(InputError, match="nothing that can be verified"):
        run(tmp_path)
    with pytest.raises(InputError, match="no checks colours"):
        run(store, "--checks", "colours")


def test_a_lerobot_set_without_a_column_that_is_needed_is_refused(lerobot, tmp_path):
    shutil.copytree(lerobot, tmp_path / "bad")
    _change_data(lambda table: table.drop_columns(["task_index"]))(tmp_path / "bad")
    with pytest.raises(InputError, match="column task_index is missing"):
        run(tmp_path / "bad")


def test_a_check_that_was_asked_for_and_could_be_made_nowhere_is_no_success(lerobot):
    status, out = run(lerobot, "--checks", "images")
    assert status == 1 and "not compared" in out


def test_a_mixture_is_verified_in_its_stores(store, tmp_path):
    recipe = Recipe(name="all", description="", version=RECIPE_VERSION, components=(Component(name="all", share=1.0),))
    write_mixture(compose_mixture(recipe, read_clip_tables([store]), seed=0), tmp_path / "mixture.json")
    status, out = run(tmp_path / "mixture.json", "--json", "--checks", "files,times")
    summary = json.loads(out)
    assert status == 0 and summary["clips"] == 2 and summary["checks"]["samples of the mixture"]["passed"] == 1


def test_exports_look_for_themselves_and_leave_nothing_where_they_fail(bad_store, tmp_path):
    contents = contents_of_stores([bad_store], "train")
    for name, export in (("pai", export_pai), ("lerobot", export_lerobot)):
        with pytest.raises(InputError, match=r"speed.*nothing was exported"):
            export(contents, tmp_path / name)
        assert [path.name for path in tmp_path.iterdir()] == ["bad"]
        assert export(contents, tmp_path / name, verify=False)["verification"] is None
        shutil.rmtree(tmp_path / name)


def test_an_export_keeps_its_checksums_under_other_names(store, tmp_path):
    summary = export_pai(contents_of_stores([store], "train"), tmp_path / "pai")
    assert summary["verification"]["passed"] > 100
    status, out = run(tmp_path / "pai", "--checks", "files,tables", "--json")
    assert status == 0 and json.loads(out)["checks"]["checksums"]["passed"] == 24


def test_a_good_lerobot_set(lerobot):
    status, out = run(lerobot, "--json")
    checks = json.loads(out)["checks"]
    assert status == 0
    for check in (
        "statistics",
        "image statistics",
        "history continues future",
        "checksums",
        "video decodes",
        "rows of episodes",
    ):
        assert checks[check]["passed"] > 0 and checks[check]["failed"] == 0


def _change_info(root):
    path = root / "meta/info.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"total_frames": 7}))


def _change_stats(root):
    path = root / "meta/stats.json"
    stats = json.loads(path.read_text())
    stats["action"]["mean"][0] += 100.0
    path.write_text(json.dumps(stats))


def _change_data(change):
    def plant(root):
        (path,) = root.glob("data/*/*.parquet")
        table = pq.read_table(path)
        pq.write_table(change(table), path)

    return plant


def _changed_vectors(name, change):
    def on_table(table):
        column = table[name].combine_chunks()
        values = column.flatten().to_numpy().reshape(len(table), -1, 4).copy()
        changed = pa.FixedSizeListArray.from_arrays(pa.array(change(values).ravel()), column.type.list_size)
        return table.set_column(table.schema.get_field_index(name), name, changed)

    return _change_data(on_table)


def _swap_videos(root):
    first, second = sorted((root / "videos").rglob("*.mp4"))[:2]
    data = first.read_bytes()
    first.write_bytes(second.read_bytes())
    second.write_bytes(data)


def _cut_video(root):
    path = sorted((root / "videos").rglob("*.mp4"))[0]
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


@pytest.mark.parametrize(
    ("plant", "checks", "group"),
    [
        (_change_info, {"number of frames"}, "tables"),
        (_change_stats, {"statistics"}, "tables"),
        (_change_data(lambda table: table.slice(1)), {"number of frames", "rows of episodes"}, "tables"),
        (_change_data(lambda table: table.drop_columns(["is_sample"])), {"columns"}, "tables"),
        (
            _changed_vectors("observation.state", lambda values: values[:, ::-1]),
            {"history ends at the origin"},
            "motion",
        ),
        (_changed_vectors("action", lambda values: values[:, ::-1]), {"speed", "history continues future"}, "motion"),
        (
            _changed_vectors("action", lambda values: np.roll(values, 10, axis=0)),
            {"history continues future"},
            "motion",
        ),
        (_changed_vectors("action", lambda values: values * np.float32(100)), {"speed"}, "motion"),
        (_changed_vectors("action", lambda values: values * np.nan), {"finite"}, "tables"),
        (_swap_videos, {"checksums"}, "files"),
        (_cut_video, {"video decodes", "frames for timestamps"}, "videos"),
        (lambda root: (root / "meta/extra.json").write_text("{}"), {"no other files"}, "files"),
        (lambda root: sorted((root / "videos").rglob("*.mp4"))[0].unlink(), {"video file"}, "videos"),
    ],
)
def test_faults_in_a_lerobot_set_are_found(lerobot, tmp_path, plant, checks, group):
    shutil.copytree(lerobot, tmp_path / "bad")
    plant(tmp_path / "bad")
    status, out = run(tmp_path / "bad", "--checks", group, "--json")
    found = {each["check"] for each in json.loads(out)["failures"]}
    assert status == 1 and checks <= found


@pytest.fixture
def published(store, tmp_path):
    shutil.copytree(store, tmp_path / "published")
    (tmp_path / "published" / CLIP_TABLE).unlink()
    return tmp_path / "published"


def test_a_published_folder_is_looked_at_and_what_is_not_told_is_named(published):
    status, out = run(published, "--json")
    checks = json.loads(out)["checks"]
    assert status == 0 and json.loads(out)["clips"] == 2
    assert checks["along the heading"]["passed"] + checks["along the heading"]["not_compared"] == 2
    assert checks["video decodes"]["passed"] == 8 and checks["safe member names"]["passed"] == 5
    assert checks["clip table"]["not_compared"] == 1
    assert not {"checksums", "duration", "sample times"} & set(checks)


def test_a_published_table_of_features_names_more_than_ours(published):
    write_published_features(published)
    status, out = run(published, "--json")
    assert status == 0 and json.loads(out)["checks"]["features"]["passed"] == 1


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            f"{{clip_id}}.{FRONT_WIDE}.mp4",
            f"{{clip_id}}.{FRONT_WIDE}.mkv",
            f"name other files than the layout's, as {FRONT_WIDE}",
        ),
        ("chunk_id:04", "chunk_id:05", "name other files than the layout's"),
        ("frame_timestamps", "times", "name other files than the layout's"),
        ("chunk_id:04", "chunk_id:09999999999", "paths cannot be made"),
        ("{clip_id}.lidar", "../{clip_id}.lidar", "leads out of the folder"),
        ("egomotion,labels", "egomotion.online,labels", "name other files than the layout's, as egomotion"),
    ],
)
def test_a_published_table_that_leads_elsewhere(published, old, new, said):
    write_published_features(published)
    path = published / "features.csv"
    path.write_text(path.read_text().replace(old, new))
    status, out = run(published, "--checks", "tables", "--json")
    (failure,) = json.loads(out)["failures"]
    assert status == 1 and failure["check"] == "features" and said in failure["detail"], failure


def test_a_published_folder_with_a_fault(published, store):
    clip = ClipStore(store).clips()[0].clip_id
    chunk = chunk_path(published, FRONT_WIDE)
    with zipfile.ZipFile(chunk) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = STORED[FRONT_WIDE].member(VIDEO, clip)
    members[name] = members[name][: len(members[name]) // 2]
    with zipfile.ZipFile(chunk, "w") as archive:
        for each, data in members.items():
            archive.writestr(each, data)
    status, out = run(published, "--checks", "videos")
    assert status == 1 and "failed: video decodes" in out and clip in out


def test_a_folder_that_was_fetched_in_part_is_looked_at_in_part(published):
    for name in (CAMERA_INTRINSICS, FRONT_WIDE):
        chunk_path(published, name).unlink()
    status, out = run(published, "--json")
    checks = json.loads(out)["checks"]
    assert status == 0
    assert checks["chunk file"]["not_compared"] >= 2 and checks["cameras and calibration"]["not_compared"] == 2
    assert checks["speed"]["passed"] == 2 and "video decodes" not in checks
    chunk_path(published, EGOMOTION).unlink()
    status, out = run(published, "--json")
    assert status == 0 and json.loads(out)["clips"] == 0
    assert json.loads(out)["checks"]["clips of the index"]["not_compared"] == 1


def test_an_export_that_goes_on_leaves_out_clips_that_fail(bad_store, tmp_path):
    first = ClipStore(bad_store).clips()[0].clip_id
    contents = contents_of_stores([bad_store], "train")
    summary = export_pai(contents, tmp_path / "pai", keep_going=True)
    assert list(summary["failures"]) == [first] and "speed" in summary["failures"][first]
    assert summary["clips"] == 1 and first not in ClipStore(tmp_path / "pai")
    summary = export_lerobot(contents, tmp_path / "lerobot", keep_going=True)
    assert list(summary["failures"]) == [first] and summary["clips"] == 1


def test_an_export_of_which_every_clip_fails_is_refused(bad_store, tmp_path):
    second = ClipStore(bad_store).clips()[1].clip_id
    change_motion(bad_store, second, lambda table: table.assign(x=100.0 * table["x"]))
    with pytest.raises(InputError, match=r"every clip failed verification.*speed"):
        export_pai(contents_of_stores([bad_store], "train"), tmp_path / "pai", keep_going=True)
    assert not (tmp_path / "pai").exists()


@pytest.mark.parametrize("fault", ["levels to 255", "spread doubled", "missing"])
def test_image_statistics_of_a_lerobot_set_are_held_against_its_frames(lerobot, tmp_path, fault):
    shutil.copytree(lerobot, tmp_path / "bad")
    path = tmp_path / "bad" / "meta" / "stats.json"
    stats = json.loads(path.read_text())
    of_front = stats[f"observation.images.{FRONT_WIDE}"]
    if fault == "levels to 255":
        of_front["mean"] = (255.0 * np.array(of_front["mean"])).tolist()
    elif fault == "spread doubled":
        of_front["std"] = (2.0 * np.array(of_front["std"])).tolist()
    else:
        del of_front["mean"]
    path.write_text(json.dumps(stats))
    status, out = run(tmp_path / "bad", "--checks", "videos")
    assert status == 1 and "failed: image statistics" in out and FRONT_WIDE in out
