import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_datasets.mixtures import epoch_order
from olt_datasets.mixtures.batches import batch_counts
from olt_datasets.mixtures.epoch_order import Draw, EpochOrder


def make_order(items, rows, batch_size, seed=0, asked=None):
    def permute(place, index):
        if asked is not None:
            asked.append((place, index))
        return np.random.default_rng([place, index]).permutation(rows[place])

    draws = [
        Draw(count, rows[place], lambda index, place=place: permute(place, index)) for place, count in enumerate(items)
    ]
    return EpochOrder(draws, batch_size, seed)


components = st.lists(st.tuples(st.integers(0, 60), st.integers(1, 25)), min_size=1, max_size=4).filter(
    lambda parts: any(items for items, _ in parts)
)


@settings(max_examples=60, deadline=None)
@given(parts=components, batch_size=st.integers(1, 17), at_once=st.sampled_from([1, 20, 10_000]), data=st.data())
def test_any_stretch_is_that_of_the_whole(parts, batch_size, at_once, data):
    items, rows = zip(*parts, strict=True)
    order = make_order(items, rows, batch_size)
    whole = [order.batch(index).tolist() for index in range(len(order))]
    start = data.draw(st.integers(0, len(whole) + 1))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(epoch_order, "ITEMS_AT_ONCE", at_once)
        stretch = [batch for some in make_order(items, rows, batch_size).batches(start) for batch in some.tolist()]
    assert stretch == whole[start:]


@settings(max_examples=60, deadline=None)
@given(parts=components, batch_size=st.integers(1, 17))
def test_batches_hold_what_the_plan_says_and_passes_follow_each_other(parts, batch_size):
    items, rows = zip(*parts, strict=True)
    order = make_order(items, rows, batch_size)
    batches = [order.batch(index) for index in range(len(order))]
    edges = np.cumsum([0, *rows])
    owners = [np.searchsorted(edges, batch, side="right") - 1 for batch in batches]
    assert [np.bincount(each, minlength=len(rows)).tolist() for each in owners] == batch_counts(
        items, batch_size
    ).tolist()
    flat, owner = np.concatenate(batches), np.concatenate(owners)
    for place, count in enumerate(items):
        passes = [
            np.random.default_rng([place, index]).permutation(rows[place]) for index in range(count // rows[place] + 1)
        ]
        assert (flat[owner == place] - edges[place]).tolist() == np.concatenate(passes)[:count].tolist()


def test_the_passes_before_a_batch_are_not_made():
    asked = []
    order = make_order([1000, 500], [10, 500], 30, asked=asked)
    assert asked == []
    order.batch(len(order) - 1)
    assert asked == [(0, 98), (0, 99), (1, 0)]


def test_the_items_of_a_batch_are_shuffled_anew_by_every_seed():
    first, second = (make_order([64, 64], [64, 64], 32, seed=seed) for seed in (0, 1))
    assert sorted(first.batch(1)) != first.batch(1).tolist()
    assert (first.batch(1) >= 64).tolist() != (second.batch(1) >= 64).tolist()
