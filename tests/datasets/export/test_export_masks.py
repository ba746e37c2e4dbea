"""Masks and camera contracts in exports."""

import os

import numpy as np
import pandas as pd
import polars as pl
import pytest

from olt_datasets.export.contents import contents_of_mixture, contents_of_stores
from olt_datasets.export.lerobot import export_lerobot
from olt_datasets.export.pai import export_pai
from olt_datasets.mixtures.mixture import compose_mixture
from olt_datasets.mixtures.recipe import Recipe
from olt_datasets.tables.clip_frame import read_clip_tables
from olt_generator.errors import InputError
from olt_toolkit.clips.clip import make_clip_id
from olt_toolkit.clips.origin_files import decode_origin
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.policy.sample import SampleKey
from olt_toolkit.rigs.contracts import find_contract
from olt_toolkit.rigs.rig import CROSS_LEFT, FRONT_WIDE, REAR_LEFT

FOUR, SIX = make_clip_id("four"), make_clip_id("six")
TWO = find_contract("alpamayo-2")
TIMES_US = np.array([1_400_000, 2_100_000])
MASK_CHUNK = f"pixel_origin/{CROSS_LEFT}.pixel_origin/{CROSS_LEFT}.pixel_origin.chunk_0000.zip"


def compose(table):
    component = {"name": "all", "where": {"kind": "Syn"}, "count": 4}
    fields = {"name": "test", "description": "Test.", "version": 1, "split": "train", "components": [component]}
    return compose_mixture(Recipe.model_validate(fields), table, seed=0, allow_uncompared=True)


def test_masks_of_a_whole_chunk_are_linked(masked_store, tmp_path, open_devkit):
    out = tmp_path / "pai"
    summary = export_pai(contents_of_stores([masked_store], "train"), out)
    assert summary["chunks"]["linked"]["count"] == 1
    assert summary["rig"] == "alpamayo-r1"
    assert os.path.samefile(out / MASK_CHUNK, masked_store / MASK_CHUNK)
    ClipStore(out).check(SIX, (2_000_000,))
    interface = open_devkit(out)
    assert interface.clip_index.index.tolist() == [FOUR, SIX]
    assert not any("pixel_origin" in name for name in interface.chunk_feature_presence.columns)


def test_masks_are_packed_under_the_ids_of_the_export(masked_store, tmp_path):
    out = tmp_path / "pai"
    export_pai(contents_of_mixture(compose(read_clip_tables([masked_store]))), out)
    exported, source = ClipStore(out), ClipStore(masked_store)
    assert len(exported.clips()) > 2  # further uses have ids of their own
    for info in exported.clips():
        expected = source.read_origin(make_clip_id(info.name), CROSS_LEFT, TIMES_US)
        np.testing.assert_array_equal(exported.read_origin(info.clip_id, CROSS_LEFT, TIMES_US), expected)
        exported.check(info.clip_id, info.sample_t0_us)


def test_only_clips_with_all_cameras_of_the_rig_are_exported(masked_store, tmp_path):
    contents = contents_of_stores([masked_store], "train", TWO)
    assert [item.clip_id for item in contents.items] == [SIX]
    (omission,) = contents.left_out
    assert (omission.why, omission.count, omission.total) == ("not all cameras of alpamayo-2", 1, 2)
    summary = export_pai(contents, tmp_path / "pai")
    assert (summary["rig"], summary["clips"]) == ("alpamayo-2", 1)
    origin = ClipStore(tmp_path / "pai").read_origin(SIX, REAR_LEFT, TIMES_US)
    np.testing.assert_array_equal(origin.mean(axis=(1, 2)) * 64, [0, 7])


def test_stores_without_a_clip_for_the_rig_are_refused_with_the_reason(stores):
    with pytest.raises(InputError, match=r"no clip is left to export; .*not all cameras of alpamayo-2"):
        contents_of_stores([stores[1]], "train", TWO)


@pytest.fixture(scope="module")
def six(masked_store, tmp_path_factory):
    """A mixture of the clip with six cameras alone, and its export for Alpamayo 2."""
    table = read_clip_tables([masked_store])
    mixture = compose(table.filter(pl.col("clip_id") == SIX))
    out = tmp_path_factory.mktemp("six") / "pai"
    return mixture, export_pai(contents_of_mixture(mixture, TWO), out), out


def test_the_devkit_reads_the_six_cameras_of_a_mixture(six, masked_store, open_devkit, public_sample):
    _, summary, out = six
    assert (summary["rig"], summary["clips"]) == ("alpamayo-2", 4)
    devkit, ours = open_devkit(out), ClipStore(out)
    assert devkit.chunk_feature_presence[list(TWO.cameras)].all(axis=None)
    for info in ours.clips():
        key = SampleKey(str(out), info.clip_id, info.sample_t0_us[0])
        sample = ours.load_sample(key, contract=TWO)
        assert sample.camera_indices.tolist() == [0, 1, 2, 3, 5, 6]
        cameras = {name: devkit.get_clip_feature(info.clip_id, name) for name in TWO.cameras}
        motion = devkit.get_clip_feature(info.clip_id, devkit.features.LABELS.EGOMOTION)
        for name, public in public_sample(motion, cameras, key.t0_us).items():
            np.testing.assert_allclose(getattr(sample, name), public, atol=1e-5)


def test_the_loader_gives_the_six_cameras_of_a_mixture(six):
    pytest.importorskip("torch")
    from olt_datasets.mixtures.dataset import MixtureBatchSampler, MixtureDataset

    mixture, _, _ = six
    row = next(iter(MixtureBatchSampler(mixture, 4)))[0]
    item = MixtureDataset(mixture, None, contract=TWO, with_origin=True)[row]
    assert item["camera_indices"].tolist() == [0, 1, 2, 3, 5, 6]
    assert tuple(item["image_frames"].shape[:2]) == tuple(item["image_origin"].shape[:2]) == (6, 4)


def test_samples_keep_their_action_errors(six, masked_store):
    """Each use of a clip in the export has the error of its own time alone."""
    _, summary, out = six
    info = ClipStore(masked_store).info(SIX)
    known = dict(zip(info.sample_t0_us, info.action_errors, strict=True))
    for use in ClipStore(out).clips():
        assert use.action_errors == (known[use.sample_t0_us[0]],)
    assert summary["action_errors"]["samples"] == 4 and summary["samples_without_action_error"] == 0


def test_a_mixture_keeps_its_shares_or_is_refused(masked_store):
    with pytest.raises(InputError, match=f"{FOUR} has no {REAR_LEFT}, .*build the clips with --rig alpamayo-2"):
        contents_of_mixture(compose(read_clip_tables([masked_store])), TWO)


def test_masks_lie_beside_the_videos_of_a_lerobot_set(masked_store, tmp_path):
    out = tmp_path / "set"
    summary = export_lerobot(contents_of_stores([masked_store], "train", TWO), out, image_size=(18, 32))
    assert summary["rig"] == "alpamayo-2"
    cameras = sorted(path.name.removeprefix("observation.images.") for path in (out / "videos").iterdir())
    assert cameras == sorted(TWO.cameras)
    masks = sorted(path.name for path in (out / "masks").iterdir())
    assert masks == [f"observation.images.{camera}" for camera in (CROSS_LEFT, REAR_LEFT)]
    runs = decode_origin((out / "masks" / masks[0] / "chunk-000/file-000.parquet").read_bytes(), "here")
    frames = pd.read_parquet(out / "data/chunk-000/file-000.parquet")
    assert (runs.height, runs.width, len(runs.timestamps_us)) == (18, 32, len(frames))
    # Frame k of the clip, at 1.4 + k / 10 s, has k seen columns of 64.
    number = (runs.timestamps_us - 1_400_000) // 100_000
    seen = runs.masks(np.arange(len(frames)))[:, 0].sum(axis=1)
    np.testing.assert_allclose(seen, number / 2, atol=0.51)
    assert not (out / "masks" / f"observation.images.{FRONT_WIDE}").exists()
