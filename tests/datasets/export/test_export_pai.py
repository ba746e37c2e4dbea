import json
import os
import shutil
import warnings

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from olt_datasets.commands.data import app
from olt_datasets.export.contents import contents_of_mixture, contents_of_stores
from olt_datasets.export.pai import export_pai
from olt_datasets.mixtures.dataset import MixtureBatchSampler, MixtureDataset
from olt_datasets.mixtures.mixture import compose_mixture
from olt_datasets.mixtures.mixture_file import write_mixture
from olt_datasets.mixtures.recipe import Recipe
from olt_datasets.tables.clip_frame import read_clip_tables
from olt_generator.errors import InputError
from olt_toolkit.clips.clip import make_clip_id
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.policy.sample import SampleKey
from olt_toolkit.rigs.rig import CROSS_LEFT, POLICY_CAMERAS

IMAGE_SIZE = (320, 576)
A, B, C, D, E = (make_clip_id(name) for name in "abcde")
HELD_OUT, SHORT = make_clip_id("held out"), make_clip_id("short")


@pytest.fixture(scope="module")
def whole(stores, tmp_path_factory):
    """Both stores, whole: summary and folder."""
    out = tmp_path_factory.mktemp("whole") / "pai"
    return export_pai(contents_of_stores(stores, "train"), out), out


@pytest.fixture(scope="module")
def mixture(stores):
    """Eight items of four clips: more than one time of a clip, and one sample drawn twice as often as the others."""
    components = [
        {"name": "nominal", "where": {"kind": "GT"}, "count": 6},
        {"name": "long_tail", "where": {"kind": "Syn"}, "count": 20, "repeats": 2},
    ]
    recipe = Recipe.model_validate(
        {"name": "test", "description": "Test.", "version": 1, "split": "train", "components": components}
    )
    return compose_mixture(recipe, read_clip_tables(list(stores)), seed=0, allow_uncompared=True)


@pytest.fixture(scope="module")
def mixed(mixture, tmp_path_factory):
    out = tmp_path_factory.mktemp("mixed") / "pai"
    return export_pai(contents_of_mixture(mixture), out), out


def test_every_clip_of_the_split_that_gives_samples_is_listed_and_no_other(whole, recipe_reader):
    summary, out = whole
    assert sorted(recipe_reader(out).clip_ids) == sorted([A, B, C, D, E])
    assert summary["left_out"] == [
        {"what": "clips", "why": "of split val", "count": 1, "total": 7, "seconds": None},
        {"what": "GT clips", "why": "no policy sample", "count": 1, "total": 7, "seconds": None},
    ]
    members = b"".join(path.read_bytes() for path in out.rglob("*.zip"))
    assert HELD_OUT.encode() not in members and SHORT.encode() not in members


def test_chunk_ranges_select_components(whole, mixed, recipe_reader):
    summary, out = whole
    assert {name: part["chunk_ids"] for name, part in summary["components"].items()} == {"real": "0-2", "made": "2-3"}
    assert set(recipe_reader(out, "0-2").clip_ids) == {A, B, C} and set(recipe_reader(out, "2-3").clip_ids) == {D, E}
    summary, out = mixed
    kinds = {info.clip_id: info.kind for info in ClipStore(out).clips()}
    for name, kind in {"nominal": "GT", "long_tail": "Syn"}.items():
        part = summary["components"][name]
        selected = recipe_reader(out, part["chunk_ids"]).clip_ids
        assert {kinds[clip_id] for clip_id in selected} == {kind} and len(selected) == part["clips"]


def test_whole_chunks_are_linked_and_others_packed(whole, stores):
    summary, out = whole
    assert {how: part["count"] for how, part in summary["chunks"].items()} == {"linked": 2, "copied": 0, "packed": 1}
    name = "labels/egomotion/egomotion.chunk_{:04d}.zip"
    assert os.path.samefile(out / name.format(0), stores[0] / name.format(0))
    assert not (out / name.format(1)).samefile(stores[0] / name.format(1))
    assert os.path.samefile(out / name.format(2), stores[1] / name.format(0))


def test_another_file_system_gets_copies(stores, tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(18, "Invalid cross-device link")

    monkeypatch.setattr(os, "link", refuse)
    summary = export_pai(contents_of_stores([stores[1]], "train"), tmp_path / "pai")
    assert summary["chunks"]["copied"]["count"] == 1
    name = "camera/camera_front_wide_120fov/camera_front_wide_120fov.chunk_0000.zip"
    assert (tmp_path / "pai" / name).read_bytes() == (stores[1] / name).read_bytes()


@pytest.mark.parametrize("which", ["whole", "mixed"])
def test_the_devkit_reads_every_clip_without_a_warning(
    which, request, stores, open_devkit, recipe_reader, public_sample
):
    _, out = request.getfixturevalue(which)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        devkit, ours, recipes = open_devkit(out), ClipStore(out), recipe_reader(out)
        assert sorted(devkit.clip_index.index) == sorted(recipes.clip_ids)
        assert devkit.chunk_feature_presence[list(POLICY_CAMERAS)].all(axis=None)
        for clip_id in recipes.clip_ids:
            cameras = {name: devkit.get_clip_feature(clip_id, name) for name in POLICY_CAMERAS}
            motion = devkit.get_clip_feature(clip_id, devkit.features.LABELS.EGOMOTION)
            t0_us = recipes.keyframe(clip_id)
            sample = ours.load_sample(SampleKey(str(out), clip_id, t0_us))
            for name, public in public_sample(motion, cameras, t0_us).items():
                np.testing.assert_allclose(getattr(sample, name), public, atol=1e-5)
            lenses = devkit.get_clip_feature(clip_id, "camera_intrinsics").camera_models
            assert set(lenses.keys()) == set(POLICY_CAMERAS)
            assert set(devkit.get_clip_feature(clip_id, "sensor_extrinsics").sensor_poses) == set(POLICY_CAMERAS)
            assert devkit.get_clip_feature(clip_id, "vehicle_dimensions").wheelbase == 2.85


def test_the_torch_dataset_yields_the_dict_of_the_public_loader(mixture, mixed):
    torch = pytest.importorskip("torch")
    row = next(iter(MixtureBatchSampler(mixture, 4)))[0]
    item = MixtureDataset(mixture, IMAGE_SIZE)[row]
    # docs/formats/physicalai_av.md, after the recipes' dataset has removed the first axis of the ego tensors
    expected = {
        "image_frames": ((4, 4, 3, *IMAGE_SIZE), torch.uint8),
        "camera_indices": ((4,), torch.int64),
        "ego_history_xyz": ((1, 16, 3), torch.float32),
        "ego_history_rot": ((1, 16, 3, 3), torch.float32),
        "ego_future_xyz": ((1, 64, 3), torch.float32),
        "ego_future_rot": ((1, 64, 3, 3), torch.float32),
        "relative_timestamps": ((4, 4), torch.float32),
        "absolute_timestamps": ((4, 4), torch.int64),
    }
    # The route is the one field that the public loader has not.
    assert item.keys() == expected.keys() | {"t0_us", "clip_id", "route_xy"}
    assert {name: (tuple(item[name].shape), item[name].dtype) for name in expected} == expected
    assert item["camera_indices"].tolist() == [0, 1, 2, 6] and (item["t0_us"], item["clip_id"]) == (
        int(mixture.samples["t0_us"][row]),
        mixture.samples["clip_id"][row],
    )


def test_the_recipes_find_every_file_and_time_by_their_rules(mixed, recipe_reader, read_parquet_bytes):
    _, out = mixed
    reader = recipe_reader(out)
    for clip_id in reader.clip_ids:
        t0_us = reader.keyframe(clip_id)
        assert t0_us > 1_600_000 and t0_us + 6_400_000 <= 20_000_000
        ego_us = read_parquet_bytes(reader.members(clip_id, "egomotion")["egomotion"])["timestamp"]
        assert ego_us.iloc[0] <= t0_us - 1_500_000 and ego_us.iloc[-1] >= t0_us + 6_400_000
        for camera in POLICY_CAMERAS:
            shown_us = read_parquet_bytes(reader.members(clip_id, camera)["frame_timestamps"])["timestamp"]
            assert shown_us.iloc[0] <= t0_us - 300_000 and shown_us.iloc[-1] >= t0_us
        assert len(reader.table(clip_id, "camera_intrinsics")) == len(reader.table(clip_id, "sensor_extrinsics")) == 4
        vehicle = reader.table(clip_id, "vehicle_dimensions")
        assert vehicle.rear_axle_to_bbox_center / vehicle.length > 0


def test_every_sample_of_a_mixture_is_one_clip_of_the_export(mixture, mixed, stores, recipe_reader):
    summary, out = mixed
    reader, exported = recipe_reader(out), ClipStore(out)
    wanted = sorted(key for part in mixture.components for key in part.samples.select("clip_id", "t0_us").rows())
    assert len(reader.clip_ids) == len(wanted) == 16
    assert summary["further_uses"] == 16 - len({clip_id for clip_id, _ in wanted})
    first = {
        clip_id: exported.read_frames(clip_id, CROSS_LEFT, np.array([1_400_000]))[0] for clip_id in reader.clip_ids
    }
    shown = {(20 * round(first[clip_id].mean() / 20), reader.keyframe(clip_id)) for clip_id in reader.clip_ids}
    grey = {A: 20, B: 40, C: 60, D: 80, E: 100}
    assert shown == {(grey[clip_id], t0_us) for clip_id, t0_us in wanted}


def test_what_the_public_readers_cannot_do_is_said(mixed, whole):
    (note,) = mixed[0]["notes"]
    assert note.startswith("long_tail: 20 items of 10 samples per epoch") and "0.625 and not 0.7692" in note
    assert whole[0]["notes"] == [] and whole[0]["clips_with_default_keyframe"] == 0


def test_the_devkit_takes_splits_from_their_own_file(whole, stores, open_devkit, tmp_path):
    _, out = whole
    devkit = open_devkit(out)
    assert devkit.clip_index["split"].tolist() == ["train"] * 5 and devkit.split_name == "default"
    splits = pd.read_parquet(out / "splits/default.parquet")
    assert splits.columns.tolist() == ["split"] and splits.index.tolist() == devkit.clip_index.index.tolist()
    # The file goes before the index, as the devkit's release 0.2.3 has it.
    changed = tmp_path / "changed"
    shutil.copytree(out, changed)
    splits.assign(split="val").to_parquet(changed / "splits/default.parquet")
    shutil.rmtree(tmp_path / "cache")
    assert open_devkit(changed).clip_index["split"].tolist() == ["val"] * 5


def test_country_and_licence_are_carried_along(whole, open_devkit):
    summary, out = whole
    assert open_devkit(out).data_collection["country"].tolist() == ["DE"] * 5
    assert summary["licences"] == {"CC BY 4.0": 5}


def test_an_interrupted_export_leaves_no_folder_and_goes_on(stores, tmp_path, monkeypatch):
    from olt_datasets.export import pai

    contents, out = contents_of_stores(stores, "train"), tmp_path / "pai"
    write_chunk = pai.write_chunk

    def stop_at_the_third(root, chunk, keep_going):
        if chunk.number == 2:
            raise KeyboardInterrupt
        return write_chunk(root, chunk, keep_going)

    monkeypatch.setattr(pai, "write_chunk", stop_at_the_third)
    with pytest.raises(KeyboardInterrupt):
        export_pai(contents, out)
    assert not out.exists()
    (kept,) = tmp_path.iterdir()
    before = (kept / "labels/egomotion/egomotion.chunk_0001.zip").stat().st_ino
    monkeypatch.setattr(pai, "write_chunk", write_chunk)
    summary = export_pai(contents, out)
    assert summary["clips"] == 5
    assert (out / "labels/egomotion/egomotion.chunk_0001.zip").stat().st_ino == before
    assert [path.name for path in tmp_path.iterdir()] == ["pai"]
    assert not list(out.glob(".*"))
    assert export_pai(contents, out) == summary


def test_another_export_in_the_same_place_is_refused(whole, stores):
    with pytest.raises(InputError, match="exists already"):
        export_pai(contents_of_stores([stores[0]], "train"), whole[1])


def test_a_full_disk_names_the_file(stores, tmp_path, monkeypatch):
    from olt_datasets.export import chunks

    def fill(archive, name, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(chunks, "add_member", fill)
    with pytest.raises(
        InputError, match=r"camera_cross_left_120fov\.chunk_0001\.zip: cannot be written \(No space left"
    ):
        export_pai(contents_of_stores([stores[0]], "train"), tmp_path / "pai")
    assert not list(tmp_path.rglob("*.chunk_0001.zip"))


@pytest.fixture
def damaged_store(stores, tmp_path):
    """The first store with one byte of clip b's first video changed, and that clip's id."""
    root = tmp_path / "damaged"
    shutil.copytree(stores[0], root)
    path = root / "camera/camera_cross_left_120fov/camera_cross_left_120fov.chunk_0000.zip"
    data = bytearray(path.read_bytes())
    data[data.index(f"{B}.camera_cross_left_120fov.timestamps.parquet".encode()) + 80] ^= 0xFF
    path.write_bytes(data)
    return root


def test_a_damaged_clip_stops_the_export_and_is_named(damaged_store, tmp_path):
    with pytest.raises(InputError, match=f"{B}.*is damaged"):
        export_pai(contents_of_stores([damaged_store], "train"), tmp_path / "pai")
    assert not (tmp_path / "pai").exists()


def test_damaged_clips_are_left_out_and_listed_where_asked(damaged_store, tmp_path, recipe_reader):
    out = tmp_path / "pai"
    summary = export_pai(contents_of_stores([damaged_store], "train"), out, keep_going=True)
    assert list(summary["failures"]) == [B] and "is damaged" in summary["failures"][B]
    assert set(recipe_reader(out).clip_ids) == {A, C}
    assert summary["components"]["damaged"]["clips"] == 2


@pytest.mark.slow
def test_the_same_export_gives_the_same_bytes_with_any_number_of_workers(mixture, mixed, tmp_path):
    out = tmp_path / "pai"
    export_pai(contents_of_mixture(mixture), out, workers=2)
    files = {path.relative_to(out) for path in out.rglob("*") if path.is_file()}
    assert files == {path.relative_to(mixed[1]) for path in mixed[1].rglob("*") if path.is_file()}
    for file in files - {type(out)("export.json")}:
        assert (out / file).read_bytes() == (mixed[1] / file).read_bytes(), file


def test_command_prints_ranges_for_the_recipes(mixture, stores, tmp_path):
    mixture_file, out = tmp_path / "mixture.json", tmp_path / "pai"
    write_mixture(mixture, mixture_file)
    result = CliRunner().invoke(app, ["export", str(mixture_file), "--out", str(out), "--workers", "1"])
    assert result.exit_code == 0, result.output
    assert 'data.train_dataset.chunk_ids="0-2" data.train_dataset.use_default_keyframe=false' in result.output
    result = CliRunner().invoke(app, ["export", *map(str, stores), "--out", str(tmp_path / "two"), "--json"])
    assert json.loads(result.stdout)["components"]["made"] == {"clips": 2, "chunk_ids": "2-3"}


def test_wrong_inputs_are_refused(stores, tmp_path):
    with pytest.raises(InputError, match="no clip is left"):
        contents_of_stores(stores, "test")
    with pytest.raises(InputError, match="two stores are called real"):
        contents_of_stores([stores[0], stores[0]], "train")
    copy = tmp_path / "copy"
    shutil.copytree(stores[1], copy)
    with pytest.raises(InputError, match="would be listed 2 times"):
        contents_of_stores([stores[1], copy], "train")
