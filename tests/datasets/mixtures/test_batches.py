import math
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from olt_datasets.mixtures.batches import batch_counts

counts_of_components = st.lists(st.integers(0, 500), min_size=1, max_size=9).filter(any)


@given(counts=counts_of_components, batch_size=st.integers(1, 200))
@example(counts=[7, 3], batch_size=32)  # one partial batch and no full one
@example(counts=[5, 5, 5], batch_size=5)  # no partial batch
def test_every_batch_is_within_one_item_of_every_share(counts, batch_size):
    batches = batch_counts(counts, batch_size)
    sizes = batches.sum(axis=1)
    full, rest = divmod(sum(counts), batch_size)
    assert sizes.tolist() == [batch_size] * full + [rest] * (rest > 0)
    assert batches.sum(axis=0).tolist() == counts
    excess = sum(counts) * batches - np.outer(sizes, counts)  # in units of 1 / samples, so that it is exact
    assert np.abs(excess).max() < sum(counts) and batches.min() >= 0


def test_share_of_three_tenths_gives_9_or_10_of_32():
    assert set(batch_counts([8579, 3677], 32)[:, 1].tolist()) == {9, 10}


@pytest.mark.parametrize("counts", [[10_000, 2_241], [1, 30_000], [3_000, 2_000, 1_000, 500, 77, 5]])
def test_running_totals_stay_close_to_the_shares(counts):
    running = np.cumsum(batch_counts(counts, 8), axis=0)
    exact = np.outer(running.sum(axis=1), np.array(counts) / sum(counts))
    assert np.abs(running - exact).max() < 4


@given(counts=st.lists(st.integers(0, 60), min_size=1, max_size=5).filter(any), batch_size=st.integers(1, 12))
@example(counts=[7, 3, 11], batch_size=4)
def test_batches_are_what_the_equation_says(counts, batch_size):
    """A plain reference in fractions; p ranks the golden-section sequence k (sqrt(5) - 1) / 2 mod 1."""
    samples, full = sum(counts), sum(counts) // batch_size
    places = sorted(range(full), key=lambda k: k * 0.6180339887498949 % 1.0)
    up_to = [sum(counts[:column]) for column in range(len(counts) + 1)]
    expected = []
    for k in range(full):
        shift = Fraction(places.index(k), full)
        reached = [math.floor(Fraction(batch_size * items, samples) + shift) for items in up_to]
        expected.append([after - before for before, after in pairwise(reached)])
    rest = samples % batch_size
    if rest:
        reached = [math.ceil(Fraction(rest * items, samples)) for items in up_to]
        expected.append([after - before for before, after in pairwise(reached)])
    assert batch_counts(counts, batch_size).tolist() == expected
