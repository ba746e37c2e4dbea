"""One drive has one identity: whatever its file is called, wherever it lies, and by whatever command it is read."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from olt_datasets.commands.data import app as data
from olt_datasets.commands.mix import app as mix
from olt_datasets.tables.clip_frame import read_clip_tables
from olt_generator.errors import InputError
from olt_generator.seeds import make_generator
from olt_generator.video import write_video
from olt_sft_recipes.commands.sft import app as sft
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.commands.clip import app as clip
from olt_toolkit.recordings.drives import open_dataset

SIZE = ("--width", 96, "--height", 54)


def film(path: Path, seed: int = 0, frames: int = 10) -> Path:
    """A video of a still picture of its own."""
    picture = make_generator("film", seed).integers(0, 256, (54, 96, 3)).astype(np.uint8)
    write_video(path, np.repeat(picture[None], frames, axis=0), 10.0)
    return path


def run(app, *arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=True)


def run_json(app, *arguments):
    result = run(app, *arguments, "--json")
    assert result.exit_code == 0, result.output + str(result.exception)
    return json.loads(result.stdout)


def scenes_of(path: Path) -> set[str]:
    dataset = open_dataset(path)
    return {dataset.drive(key).scene_id for key in dataset.keys()}  # noqa: SIM118 - a data set is no dict


def index(root, out: Path, *options) -> dict:
    cache = out.parent / "cache"
    return run_json(data, "index", root, "--out", out, "--seconds", 1, "--workers", 1, "--cache", cache, *options)


def test_a_video_is_the_same_wherever_it_lies_and_whatever_it_is_called(tmp_path, monkeypatch):
    path = film(tmp_path / "day1" / "front" / "0001.mp4")
    scenes = scenes_of(path)
    copy = tmp_path / "elsewhere" / "renamed.MP4"
    copy.parent.mkdir()
    shutil.copy(path, copy)
    (tmp_path / "link.mp4").symlink_to(path)
    (tmp_path / "folder").symlink_to(path.parent)
    up = tmp_path / "day1" / ".." / "day1" / "front" / ".." / "front"
    for each in (copy, copy.parent, tmp_path / "link.mp4", tmp_path / "folder", up, up / "0001.mp4"):
        assert scenes_of(each) == scenes
    monkeypatch.chdir(path.parent)
    for text in (".", "0001.mp4", "./", "../front//"):
        assert scenes_of(Path(text)) == scenes
    table = tmp_path / "clips.parquet"
    for root in (f"{path.parent}{os.sep}", ".", path):
        index(root, table)
        assert set(read_clip_tables([table])["scene_id"]) == scenes


def test_two_videos_of_one_name_are_two(tmp_path):
    first, second = film(tmp_path / "day1" / "front" / "0001.mp4"), film(tmp_path / "day2" / "front" / "0001.mp4", 1)
    assert scenes_of(first) != scenes_of(second)
    both = index(tmp_path, tmp_path / "clips.parquet", "--source", "video")
    assert (both["clips"], both["copies"]) == (2, {})
    longer = film(tmp_path / "longer.mp4", frames=11)
    assert scenes_of(first) != scenes_of(longer)


def test_what_is_in_the_file_beside_the_pictures_changes_nothing(tmp_path):
    av = pytest.importorskip("av")
    path, titled = film(tmp_path / "a.mp4"), tmp_path / "titled.mov"
    with av.open(str(path)) as source, av.open(str(titled), "w", options={"movflags": "faststart"}) as target:
        target.metadata["title"] = "On the road"
        stream = target.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.size:
                packet.stream = stream
                target.mux(packet)
    assert titled.read_bytes() != path.read_bytes()
    assert scenes_of(titled) == scenes_of(path)


def test_a_clip_has_one_id_by_every_command(tmp_path):
    path = film(tmp_path / "drives" / "town.mp4")
    table, store = tmp_path / "clips.parquet", tmp_path / "store"
    index(path.parent, table)
    run_json(data, "split", table, "--rule", "external", "--source", "video", "--out", table)
    build = ("build", table, "--root", path.parent, "--kind", "Syn", "--out", store, "--workers", 1, *SIZE)
    (made,) = run_json(data, *build, "--cache", tmp_path / "cache")["clips"]
    alone = run_json(clip, "build", path, "--out", tmp_path / "alone", *SIZE)["clip"]
    (indexed,) = read_clip_tables([table]).to_dicts()
    assert alone["clip_id"] == made["clip_id"] != indexed["clip_id"]  # front_only there, Syn here
    assert alone["scene_id"] == indexed["scene_id"] == made["summary"]["clip"]["scene_id"]
    assert alone["origin"]["recording"] == "town"
    assert made["summary"]["clip"]["origin"]["recording"] == "town.mp4"
    assert alone["build_options"] != made["summary"]["clip"]["build_options"]  # only the sample times asked for
    # A store that is trained on, and the same drive in the test set.
    result = run(data, "check", table, tmp_path / "alone", "--json")
    leaks = json.loads(result.stdout)["leaks"]
    assert result.exit_code == 1
    assert ("twin", alone["scene_id"]) in {(leak["rule"], leak["scene_id"]) for leak in leaks}


def test_a_clip_is_in_the_split_that_its_data_set_tells(tmp_path):
    root = tmp_path / "nexar"
    for split, look in (("train", "town"), ("test", "field")):
        film(root / split / "00001.mp4", look)
        columns = {"train": "id,time_of_event,time_of_alert,target\n00001,,,0\n", "test": "id\n00001\n"}
        (root / f"{split}.csv").write_text(columns[split])
    run_json(clip, "build", root, "--out", tmp_path / "store", *SIZE)
    built = read_clip_tables([tmp_path / "store"]).select("recording", "split").sort("recording").rows()
    assert built == [("test/00001", "test"), ("train/00001", "train")]
    again = run(clip, "build", root, "--out", tmp_path / "store", *SIZE)
    assert (again.exit_code, again.stdout.count("found")) == (0, 2), again.stdout


def test_a_copy_in_the_test_set_is_found_by_its_id(tmp_path):
    path = film(tmp_path / "train" / "a.mp4")
    (tmp_path / "test").mkdir()
    shutil.copy(path, tmp_path / "test" / "b.mp4")
    tables = []
    for split in ("train", "test"):
        table = tmp_path / f"{split}.parquet"
        index(tmp_path / split, table)
        rows = pq.read_table(table)
        rows = rows.set_column(rows.schema.get_field_index("split"), "split", pa.array([split] * len(rows)))
        pq.write_table(rows, table)
        tables.append(table)
    result = run(data, "check", *tables, "--json")
    assert result.exit_code == 1
    assert {leak["rule"] for leak in json.loads(result.stdout)["leaks"]} == {"overlap"}


def test_copies_in_one_folder_are_one_clip_and_are_listed(tmp_path):
    folder, store = tmp_path / "drives", tmp_path / "store"
    film(folder / "a.mp4")
    shutil.copy(folder / "a.mp4", folder / "b.mp4")
    (folder / "c.mp4").symlink_to("a.mp4")
    assert index(folder, tmp_path / "clips.parquet")["copies"] == {"b.mp4": "a.mp4", "c.mp4": "a.mp4"}
    told = run(data, "index", folder, "--out", tmp_path / "again.parquet", "--seconds", 1, "--workers", 1).stdout
    assert "left out: b.mp4: the same recording as a.mp4" in told
    build = ("build", folder, "--out", store, "--workers", 1, *SIZE)
    results = run_json(clip, *build)["recordings"]
    assert [result["state"] for result in results] == ["built", "found", "found"]
    assert results[1]["message"] == f"the same recording as {folder / 'a.mp4'}"
    assert len(ClipStore(store).clips()) == 1
    assert "left out: b.mp4: the same recording as" in run(clip, *build).stdout


def test_two_clips_of_one_name_have_their_own_pictures_and_are_told_apart(tmp_path):
    for day in range(2):
        film(tmp_path / "drives" / f"day{day}" / "0001.mp4", day)
    store = tmp_path / "store"
    run_json(clip, "build", tmp_path / "drives" / "day0", "--out", store, *SIZE, "--workers", 1)
    run_json(clip, "build", tmp_path / "drives" / "day1" / "0001.mp4", "--out", store, *SIZE)
    assert [info.name for info in ClipStore(store).clips()] == ["0001", "0001"]
    assert len(list((store / "previews").glob("0001-*.webp"))) == 2
    error = str(run(clip, "inspect", store, "0001").exception)
    assert "2 clips are called '0001', give the id of one" in error
    for info in ClipStore(store).clips():
        assert f"{info.clip_id} (Syn of scene {info.scene_id})" in error


def test_a_store_holds_a_clip_built_in_one_way(tmp_path):
    path, store = film(tmp_path / "drives" / "town.mp4"), tmp_path / "store"
    folder = ("build", path.parent, "--out", store, "--workers", 1)
    assert [each["state"] for each in run_json(clip, *folder, *SIZE)["recordings"]] == ["built"]
    assert [each["state"] for each in run_json(clip, *folder, *SIZE)["recordings"]] == ["found"]
    for other, words in (
        ((*SIZE[:3], 56), "--height 54 (now 56)"),
        ((*SIZE, "--fov", 90), "--fov not given (now 90.0)"),
        ((*SIZE, "--category", "animal"), "--category unlabelled (now animal)"),
    ):
        for source in (folder, ("build", path, "--out", store)):
            error = run(clip, *source, *other).exception
            assert isinstance(error, InputError)
            assert "already holds the clip 'town'" in str(error)
            assert words in str(error)
    assert len(ClipStore(store).clips()) == 1


def test_a_prepared_clip_of_an_interrupted_run_is_built_again_with_other_options(tmp_path, monkeypatch):
    folder, store = film(tmp_path / "drives" / "town.mp4").parent, tmp_path / "store"
    build = ("build", folder, "--out", store, "--workers", 1)

    def interrupt(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(ClipStore, "commit", interrupt)
        assert run(clip, *build, *SIZE).exit_code != 0
    assert [each["state"] for each in run_json(clip, *build, "--width", 64, "--height", 36)["recordings"]] == ["built"]
    (info,) = ClipStore(store).clips()
    assert info.build_options is not None
    assert json.loads(info.build_options)["width"] == 64
    assert ClipStore(store).read_camera(info.clip_id, next(iter(info.views))).camera.width == 64


def test_another_recording_in_the_place_of_the_one_that_was_indexed_is_refused(tmp_path):
    path, table = film(tmp_path / "drives" / "town.mp4"), tmp_path / "clips.parquet"
    index(path.parent, table)
    run_json(data, "split", table, "--rule", "external", "--source", "video", "--out", table)
    film(path, seed=1)
    build = ("build", table, "--root", path.parent, "--kind", "Syn", "--out", tmp_path / "store", "--workers", 1)
    error = str(run(data, *build, *SIZE).exception)
    assert "town.mp4 is video/" in error
    assert "give the data set that was indexed, or index this one" in error


def test_scenes_that_no_clip_shows_cannot_be_held_out(write_store, make_clip, tmp_path):
    store = write_store(make_clip(1), make_clip(2))
    error = str(run(data, "check", store, "--held-out", "scene_1", "--held-out", "kitti/old").exception)
    assert "--held-out: no clip shows 'kitti/old', so this holds nothing out" in error
    recipe = tmp_path / "mine.yaml"
    component = "{name: all, where: {kind: any}, share: 1.0}"
    recipe.write_text(f"name: mine\nversion: 1\ndescription: all\nheld_out_scenes: [gone]\ncomponents: [{component}]\n")
    for command in ("compose", "check"):
        error = str(run(mix, command, recipe, "--stores", store).exception)
        assert "recipe mine: held_out_scenes: no clip shows 'gone'" in error


@pytest.fixture
def old(write_store, make_clip):
    """A store and a table as version 4 wrote them: other columns, and a fingerprint of another form."""
    store = write_store(make_clip(1))
    rows = pq.read_table(store / "clips.parquet").drop_columns(["action_errors", "build_options"])
    place = rows.schema.get_field_index("fingerprint")
    rows = rows.set_column(place, "fingerprint", pa.array([[1, 2]], pa.list_(pa.uint64())))
    rows = rows.replace_schema_metadata({"table_version": "4"})
    for path in (store / "clips.parquet", store.parent / "old.parquet"):
        pq.write_table(rows, path)
    return store.parent


COMMANDS = (
    (clip, "inspect STORE"),
    (clip, "inspect STORE town"),
    (clip, "views STORE town --out OUT"),
    (clip, "score STORE town"),
    (data, "label TABLE --labels LABELS --out OUT.parquet"),
    (data, "split TABLE --rule seen --out OUT.parquet"),
    (data, "check TABLE"),
    (data, "check STORE"),
    (data, "build TABLE --root OUT --kind GT --out OUT"),
    (data, "export STORE --out OUT"),
    (mix, "compose RECIPE --stores STORE"),
    (mix, "check RECIPE --stores TABLE"),
    (mix, "align TABLE --target kind=Syn"),
    (sft, "train --recipe RECIPE --stores STORE --out OUT"),
    (sft, "evaluate --policy constant_velocity --stores STORE"),
)


@pytest.mark.parametrize(("app", "text"), COMMANDS, ids=[text for _, text in COMMANDS])
def test_tables_of_older_releases_are_refused_by_version(old, tmp_path, app, text):
    (old / "labels.csv").write_text("clip_id,category\nx,animal\n")
    places = {"STORE": old / "store", "TABLE": old / "old.parquet", "LABELS": old / "labels.csv", "OUT": old / "out"}
    words = [str(places.get(word, word)) for word in text.replace("RECIPE", "toy_nominal").split()]
    result = run(app, *[word.replace("OUT.parquet", str(old / "out.parquet")) for word in words])
    assert isinstance(result.exception, InputError), result.output
    assert "table_version is 4, this release reads 5; build or index the clips again" in str(result.exception)
    assert not (old / "out.parquet").exists()


def test_an_index_is_not_written_over_a_table_of_an_older_release(old, tmp_path):
    film(tmp_path / "drives" / "town.mp4")
    before = (old / "old.parquet").read_bytes()
    result = run(data, "index", tmp_path / "drives", "--out", old / "old.parquet", "--workers", 1)
    assert "table_version is 4" in str(result.exception)
    assert (old / "old.parquet").read_bytes() == before


def test_a_clip_is_not_added_to_a_store_of_an_older_release(old, tmp_path):
    film(tmp_path / "drives" / "town.mp4")
    for source in (tmp_path / "drives", tmp_path / "drives" / "town.mp4"):
        result = run(clip, "build", source, "--out", old / "store", *SIZE)
        assert "table_version is 4" in str(result.exception)
