import math
from fractions import Fraction

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from olt_datasets.mixtures.epoch_plan import LONGEST_PLAN, EpochPlan
from olt_datasets.mixtures.mixture import compose_mixture
from olt_datasets.mixtures.recipe import parse_recipe
from olt_datasets.mixtures.selection import most_items
from olt_generator.errors import InputError

weights_of_components = st.integers(1, 9).flatmap(
    lambda size: st.lists(
        st.lists(st.integers(0, 40), min_size=size, max_size=size).filter(any), min_size=1, max_size=4
    )
)


def fractions_of(weights):
    return [Fraction(weight, sum(weights)) for weight in weights]


def curriculum(named, gap):
    """Shares that go in straight lines from one of the named weights to the next, `gap` epochs later."""
    points = [fractions_of(weights) for weights in named]

    def shares(epoch):
        place, rest = divmod(min(epoch, gap * (len(points) - 1)), gap)
        after = points[min(place + 1, len(points) - 1)]
        return [start + Fraction(rest, gap) * (end - start) for start, end in zip(points[place], after, strict=True)]

    return shares, gap * (len(points) - 1)


@settings(max_examples=150, deadline=None)
@given(named=weights_of_components, gap=st.integers(1, 7), samples=st.integers(1, 200))
@example(named=[[1, 1, 1, 1, 1]], gap=1, samples=7)
@example(named=[[2, 1, 0], [0, 1, 2], [1, 1, 1]], gap=3, samples=10)
def test_every_component_is_within_one_item_of_its_share_of_all_epochs_so_far(named, gap, samples):
    shares, last = curriculum(named, gap)
    plan, given, owed = EpochPlan(shares, last, samples), [0] * len(named[0]), [Fraction(0)] * len(named[0])
    for epoch in range(40):
        counts, exact = plan.counts(epoch), [samples * share for share in shares(epoch)]
        assert sum(counts) == samples
        for place, (items, wanted) in enumerate(zip(counts, exact, strict=True)):
            given[place] += items
            owed[place] += wanted
            assert abs(given[place] - owed[place]) < 1
            assert math.floor(wanted) <= items <= math.ceil(wanted) + (len(exact) > 2)


@settings(deadline=None)
@given(named=weights_of_components, gap=st.integers(1, 3), samples=st.integers(1, 50), epoch=st.integers(0, 60))
def test_an_epoch_is_the_same_whatever_was_asked_before(named, gap, samples, epoch):
    shares, last = curriculum(named, gap)
    plan = EpochPlan(shares, last, samples)
    in_order = [plan.counts(earlier) for earlier in range(epoch + 1)]
    assert EpochPlan(shares, last, samples).counts(epoch) == in_order[-1]


@pytest.mark.parametrize("last", [0, 4])
def test_late_epochs_are_told_without_those_before(last):
    """Shares of 1/3 repeat after three epochs; the sums up to any of them are told by those of the first ones."""
    shares, last = curriculum([[1, 1, 1], [1, 1, 1]], last) if last else (lambda _: fractions_of([1, 1, 1]), 0)
    plan = EpochPlan(shares, last, 100)
    cycle = [plan.counts(epoch) for epoch in range(9, 12)]
    assert [sum(items) for items in zip(*cycle, strict=True)] == [100, 100, 100]
    assert [plan.counts(3 * 10**11 + place) for place in range(3)] == cycle


def test_an_epoch_too_late_for_its_shares_is_refused():
    share = Fraction("0.1234567")
    plan = EpochPlan(lambda _: [share, 1 - share], 0, 101)
    with pytest.raises(InputError, match=f"plans go to epoch {LONGEST_PLAN}"):
        plan.counts(10**9)


def test_the_fraction_of_a_small_share_is_given_in_some_epochs(toy_table):
    recipe = make_recipe(0.985, 0.015)  # 0.6 of 40 items
    mixture = compose_mixture(recipe, toy_table, 0)
    got = [mixture.counts(epoch)[1] for epoch in range(10)]
    assert sum(got) == 6 and set(got) == {0, 1}


@settings(max_examples=50, deadline=None)
@given(weights=st.lists(st.integers(1, 30), min_size=1, max_size=6), samples=st.integers(1, 100))
def test_no_epoch_gives_more_than_is_looked_for(weights, samples):
    shares = [round(weight / sum(weights), 6) for weight in weights]
    recipe = make_recipe(*shares[:-1], 1.0 - math.fsum(shares[:-1]), samples=samples)
    most = most_items(recipe, samples)
    plan = EpochPlan(recipe.shares, 0, samples)
    for epoch in range(30):
        assert all(items <= bound for items, bound in zip(plan.counts(epoch), most, strict=True))


def make_recipe(*shares, samples=40):
    kinds = [{"kind": "GT", "category": ["nominal"]}, {"kind": "Syn", "category": ["work_zone"]}]
    where = kinds + [{"category": [f"other {place}"]} for place in range(len(shares) - 2)]
    parts = [{"name": str(place), "where": where[place], "share": share} for place, share in enumerate(shares)]
    content = {"name": "mine", "description": "", "version": 1, "samples": samples, "components": parts}
    return parse_recipe(content, "mine")
