"""Samples that are kept decoded are those of the stores."""

import copy
from dataclasses import replace

import numpy as np
import pytest

from olt_datasets.mixtures.sample_cache import FRAMES, CacheOptions, SampleCache
from olt_generator.errors import InputError
from olt_toolkit import ClipStore
from olt_toolkit.policy.sample import SampleKey
from olt_toolkit.rigs.contracts import DEFAULT_CONTRACT

OPTIONS = CacheOptions((16, 24), DEFAULT_CONTRACT, True)


@pytest.fixture
def stores(real_store):
    return dict.fromkeys(("other", "store"), ClipStore(real_store))


@pytest.fixture
def keys(stores):
    with_samples = [info for info in stores["store"].clips() if info.sample_t0_us and len(info.views) == 4]
    return [
        SampleKey(store, info.clip_id, time)
        for store in ("store", "other")
        for info in with_samples
        for time in info.sample_t0_us[:5]
    ]


def assert_equal_samples(found, wanted):
    for name, value in vars(wanted).items():
        if isinstance(value, np.ndarray):
            assert getattr(found, name).dtype == value.dtype
            np.testing.assert_array_equal(getattr(found, name), value)
        else:
            assert getattr(found, name) == value


def test_cached_samples_are_those_of_the_store(tmp_path, stores, keys):
    cache = SampleCache(tmp_path / "cache", keys, stores, OPTIONS)
    wanted = list(reversed(keys))
    for cached, direct in zip(
        copy.copy(cache).load(wanted),
        stores["store"].load_samples(wanted, OPTIONS.image_size, with_truth=True),
        strict=True,
    ):
        assert_equal_samples(cached, direct)


def test_each_frame_is_kept_once(tmp_path, stores, keys):
    SampleCache(tmp_path / "cache", keys[:5], stores, OPTIONS)
    samples = stores["store"].load_samples(keys[:5])
    distinct = {
        (camera, time) for each in samples for camera, row in enumerate(each.absolute_timestamps) for time in row
    }
    assert (tmp_path / "cache" / FRAMES).stat().st_size == len(distinct) * 3 * 16 * 24 < 5 * 16 * 3 * 16 * 24


def test_a_cache_is_made_once_and_again_for_other_samples(tmp_path, stores, keys):
    folder = tmp_path / "cache"
    SampleCache(folder, keys, stores, OPTIONS)
    made = (folder / FRAMES).stat().st_ino
    SampleCache(folder, keys, stores, OPTIONS)
    assert (folder / FRAMES).stat().st_ino == made
    SampleCache(folder, keys[:3], stores, OPTIONS)
    assert (folder / FRAMES).stat().st_ino != made
    assert len(SampleCache(folder, keys, stores, replace(OPTIONS, with_truth=False)).load(keys[:2])) == 2


def test_another_folder_is_not_replaced(tmp_path, stores, keys):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("keep me")
    with pytest.raises(InputError, match="is no sample cache"):
        SampleCache(tmp_path / "mine", keys, stores, OPTIONS)
    assert (tmp_path / "mine" / "letter.txt").exists()
