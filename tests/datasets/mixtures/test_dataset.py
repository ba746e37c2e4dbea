from collections import Counter

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.utils.data import DataLoader

from olt_datasets.mixtures.dataset import MixtureBatchSampler, MixtureDataset
from olt_datasets.mixtures.mixture import compose_mixture
from olt_datasets.mixtures.recipe import find_recipe
from olt_datasets.tables.clip_frame import read_clip_tables
from olt_generator.errors import InputError
from olt_toolkit.policy.sample import PolicySample, SampleKey

IMAGE_SIZE = (8, 12)


class StubStore:
    """Gives samples whose numbers tell which key they are of; its class can be pickled for workers."""

    def __init__(self, root):
        self.root = root

    def load_samples(self, keys, image_size=None, *rest):
        return [self._make(key, image_size) for key in keys]

    def _make(self, key, image_size):
        number = int(key.clip_id[-12:])
        return PolicySample(
            image_frames=np.full((4, 4, 3, *image_size), number, np.uint8),
            camera_indices=np.array([0, 1, 2, 6]),
            ego_history_xyz=np.zeros((1, 16, 3), np.float32),
            ego_history_rot=np.zeros((1, 16, 3, 3), np.float32),
            ego_future_xyz=np.full((1, 64, 3), key.t0_us * 1e-6, np.float32),
            ego_future_rot=np.zeros((1, 64, 3, 3), np.float32),
            relative_timestamps=np.zeros((4, 4), np.float32),
            absolute_timestamps=np.zeros((4, 4), np.int64),
            t0_us=key.t0_us,
            clip_id=key.clip_id,
        )


def keys_of(mixture, batches):
    return [mixture.keys(rows) for rows in batches]


@pytest.fixture(scope="module")
def mixture(toy_table):
    return compose_mixture(find_recipe("toy_nominal_long_tail"), toy_table, seed=0)


def test_batch_is_loaded_in_its_order_at_the_image_size(mixture):
    keys = mixture.epoch(0, 8)[0]
    samples = MixtureDataset(mixture, IMAGE_SIZE, StubStore).load_batch(keys)
    assert [(sample.clip_id, sample.t0_us) for sample in samples] == [(key.clip_id, key.t0_us) for key in keys]
    assert samples[0].image_frames.shape == (4, 4, 3, *IMAGE_SIZE)


def test_each_store_is_opened_once(mixture):
    opened = []

    def open_store(root):
        opened.append(str(root))
        return StubStore(root)

    dataset = MixtureDataset(mixture, IMAGE_SIZE, open_store)
    dataset.load_batch([SampleKey(store, f"{0:036d}", 0) for store in ("/b", "/a", "/b")])
    assert sorted(opened) == ["/a", "/b"]


def test_a_data_loader_asks_for_a_batch_at_once_so_that_clips_are_decoded_once(mixture):
    asked = []

    class CountingStore(StubStore):
        def load_samples(self, keys, image_size=None, *rest):
            asked.append(list(keys))
            return super().load_samples(keys, image_size, *rest)

    dataset = MixtureDataset(mixture, IMAGE_SIZE, CountingStore)
    next(iter(DataLoader(dataset, batch_sampler=MixtureBatchSampler(mixture, batch_size=16))))
    assert asked == [mixture.epoch(0, 16)[0]]


def test_rows_are_those_of_the_samples(mixture):
    dataset, keys = MixtureDataset(mixture, IMAGE_SIZE, StubStore), mixture.keys(list(range(len(mixture.samples))))
    assert len(dataset) == len(keys) == 60 + 16
    assert [(item["clip_id"], item["t0_us"]) for item in dataset] == [(key.clip_id, key.t0_us) for key in keys]


def test_missing_store_is_an_error_in_words(mixture, tmp_path):
    with pytest.raises(InputError, match="not a clip store"):
        MixtureDataset(mixture, IMAGE_SIZE).load_batch([SampleKey(str(tmp_path), "no clip", 0)])


@pytest.mark.parametrize(("workers", "start"), [(0, None), (2, "fork"), (1, "spawn")])
def test_data_loader_yields_the_alpamayo_dict(mixture, workers, start):
    dataset = MixtureDataset(mixture, IMAGE_SIZE, StubStore)
    batches = MixtureBatchSampler(mixture, batch_size=16)
    loaded = list(DataLoader(dataset, batch_sampler=batches, num_workers=workers, multiprocessing_context=start))
    keys = mixture.epoch(0, 16)
    assert [batch["clip_id"] for batch in loaded] == [[key.clip_id for key in batch] for batch in keys]
    first = loaded[0]
    assert first["image_frames"].shape == (16, 4, 4, 3, *IMAGE_SIZE) and first["image_frames"].dtype == torch.uint8
    assert first["camera_indices"].shape == (16, 4) and first["camera_indices"].dtype == torch.int64
    assert first["ego_history_rot"].shape == (16, 1, 16, 3, 3)
    assert first["ego_future_xyz"].shape == (16, 1, 64, 3) and first["ego_future_xyz"].dtype == torch.float32
    assert first["t0_us"].tolist() == [key.t0_us for key in keys[0]]


def test_sampler_resumes_within_any_epoch(mixture):
    batches = MixtureBatchSampler(mixture, batch_size=8)
    assert keys_of(mixture, batches) == list(mixture.epoch(0, 8))
    batches.set_epoch(2, start_batch=5)
    assert keys_of(mixture, batches) == mixture.epoch(2, 8)[5:]
    assert len(batches) == len(mixture.epoch(2, 8)) - 5


@settings(max_examples=25, deadline=None)
@given(
    stop=st.integers(0, 22),
    before=st.sampled_from([(1, 1), (2, 3), (8, 1)]),
    after=st.sampled_from([(4, 2), (3, 4), (24, 1)]),
)
def test_ranks_and_accumulation_may_change_within_an_epoch(mixture, stop, before, after):
    """512 samples in global batches of 24: every one is given once, however many ranks there are on the way."""

    def take(ranks, accumulation, epoch_batches):
        samplers = [MixtureBatchSampler(mixture, 24, rank, ranks, accumulation) for rank in range(ranks)]
        for sampler in samplers:
            sampler.set_epoch(1, epoch_batches.start)
        whole = (epoch_batches.stop - epoch_batches.start) * accumulation
        return [key for sampler in samplers for part in keys_of(mixture, sampler)[:whole] for key in part]

    last = 512 // 24  # the partial batch, in which some ranks take an item again
    got = take(*before, range(min(stop, last))) + take(*after, range(min(stop, last), last))
    expected = [key for batch in mixture.epoch(1, 24)[:last] for key in batch]
    assert Counter(got) == Counter(expected)


def test_accumulation_divides_a_rank_s_part(mixture):
    parts = keys_of(mixture, MixtureBatchSampler(mixture, 32, rank=3, world_size=8, accumulation=4))
    whole = mixture.epoch(0, 32, rank=3, world_size=8)
    assert {len(part) for part in parts} == {1} and len(parts) == 4 * len(whole)
    assert [key for part in parts for key in part] == [key for batch in whole for key in batch]
    with pytest.raises(InputError, match="32 must be a multiple of 8 ranks x 3 passes"):
        MixtureBatchSampler(mixture, 32, rank=3, world_size=8, accumulation=3)


def test_a_recipe_without_samples_feeds_no_training(toy_table):
    with pytest.raises(InputError, match="recipe base_r1 has no samples to train on"):
        MixtureBatchSampler(compose_mixture(find_recipe("base_r1"), toy_table, seed=0), 8)


def test_ranks_step_alike_in_a_partial_batch(toy_table):
    recipe = find_recipe("toy_nominal").model_copy(update={"samples": 33})
    mixture = compose_mixture(recipe, toy_table, seed=0)
    ranks = [keys_of(mixture, MixtureBatchSampler(mixture, 8, rank, world_size=4)) for rank in range(4)]
    assert [[len(batch) for batch in rank] for rank in ranks] == [[2, 2, 2, 2, 1]] * 4
    assert {key for rank in ranks for batch in rank for key in batch} == {
        key for batch in mixture.epoch(0, 8) for key in batch
    }
    assert [rank[-1][0] == rank[0][0] for rank in ranks] == [False, True, True, True]


def test_fewer_samples_than_ranks_are_refused(toy_table):
    mixture = compose_mixture(find_recipe("toy_nominal").model_copy(update={"samples": 3}), toy_table, seed=0)
    with pytest.raises(InputError, match="3 samples cannot feed 4 ranks"):
        MixtureBatchSampler(mixture, 8, rank=0, world_size=4)


def test_a_real_clip_store_feeds_a_data_loader(real_store):
    recipe = find_recipe("toy_nominal").model_copy(update={"samples": 9})
    mixture = compose_mixture(recipe, read_clip_tables([real_store]), seed=0)
    dataset = MixtureDataset(mixture, (18, 32))
    batches = list(DataLoader(dataset, batch_sampler=MixtureBatchSampler(mixture, batch_size=4)))
    t0_us = [time for batch in batches for time in batch["t0_us"].tolist()]
    assert sorted(t0_us) == list(range(1_700_000, 2_500_001, 100_000))
    assert batches[0]["image_frames"].shape == (4, 4, 4, 3, 18, 32)
    end_of_future = batches[0]["ego_future_xyz"][:, 0, -1]
    torch.testing.assert_close(end_of_future, torch.tensor([32.0, 0.0, 0.0]).expand(4, 3), atol=1e-3, rtol=0)
