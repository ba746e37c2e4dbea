import re
from collections import Counter
from itertools import chain

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_datasets.mixture import check_recipe, compose_mixture
from olt_datasets.recipe import builtin_recipe, parse_recipe
from olt_generator.errors import InputError

NOMINAL = {"name": "nominal", "where": {"kind": "GT", "category": ["nominal"]}}
WORK_ZONES = {"name": "work_zones", "where": {"kind": "Syn", "category": ["work_zone"]}}
SETTINGS = settings(max_examples=40, deadline=None)


def make_recipe(*components, **fields):
    content = {"name": "mine", "description": "", "version": 1, "components": list(components), **fields}
    return parse_recipe(content, "mine")


def clip_numbers(keys):
    return {int(key.clip_id[-12:]) for key in keys}


def items(mixture, epoch=0, batch_size=8):
    return list(chain.from_iterable(mixture.epoch(epoch, batch_size)))


@st.composite
def mixtures(draw, table):
    """The toy table (60 nominal samples, 16 of work zones) in random shares or counts."""
    share = draw(st.integers(10, 90)) / 100
    repeats = draw(st.integers(1, 3))
    nominal, work_zones = {**NOMINAL, "repeats": repeats}, {**WORK_ZONES, "repeats": repeats}
    if draw(st.booleans()):
        recipe = make_recipe({**nominal, "share": share}, {**work_zones, "share": 1 - share})
    else:
        counts = draw(st.integers(1, 60 * repeats)), draw(st.integers(1, 16 * repeats))
        recipe = make_recipe({**nominal, "count": counts[0]}, {**work_zones, "count": counts[1]})
    return compose_mixture(recipe, table, draw(st.integers(0, 5)))


@SETTINGS
@given(data=st.data(), batch_size=st.integers(1, 40), epoch=st.integers(0, 3))
def test_every_batch_is_within_one_item_of_its_share(toy_table, data, batch_size, epoch):
    mixture = data.draw(mixtures(toy_table))
    batches = mixture.epoch(epoch, batch_size)
    assert sum(map(len, batches)) == len(mixture) == sum(mixture.counts())
    for batch in batches:
        got = sum(int(key.clip_id[-12:]) < 100 for key in batch)
        assert abs(got - len(batch) * mixture.counts()[0] / len(mixture)) < 1


@SETTINGS
@given(data=st.data(), per_rank=st.integers(1, 6), world_size=st.sampled_from([1, 2, 3, 4]), epoch=st.integers(0, 3))
def test_ranks_are_disjoint_and_give_the_batches_of_one_rank(toy_table, data, per_rank, world_size, epoch):
    mixture = data.draw(mixtures(toy_table))
    batch_size = per_rank * world_size
    whole = mixture.epoch(epoch, batch_size)
    ranks = [mixture.epoch(epoch, batch_size, rank, world_size) for rank in range(world_size)]
    for index, batch in enumerate(whole):
        parts = [rank[index] for rank in ranks]
        assert Counter(chain.from_iterable(parts)) == Counter(batch)
        assert max(map(len, parts)) - min(map(len, parts)) <= 1


@SETTINGS
@given(data=st.data(), batch_size=st.integers(1, 20), start=st.integers(0, 30))
def test_resuming_gives_the_tail_of_the_epoch(toy_table, data, batch_size, start):
    mixture = data.draw(mixtures(toy_table))
    assert mixture.epoch(1, batch_size, start_batch=start) == mixture.epoch(1, batch_size)[start:]


@SETTINGS
@given(seed=st.integers(0, 10**6), epoch=st.integers(0, 10))
def test_a_pure_function_of_its_arguments(toy_table, seed, epoch):
    recipe = make_recipe({**NOMINAL, "count": 30}, {**WORK_ZONES, "count": 10})
    first, second = compose_mixture(recipe, toy_table, seed), compose_mixture(recipe, toy_table.clone(), seed)
    second.epoch(epoch + 1, 4)  # what was asked before leaves no trace
    assert first.epoch(epoch, 8) == second.epoch(epoch, 8)
    assert first.describe() == second.describe()
    assert items(first, epoch) != items(first, epoch + 1)
    assert items(first, epoch) != items(compose_mixture(recipe, toy_table, seed + 1), epoch)


def test_each_pass_holds_every_sample_once_in_a_new_order(toy_table):
    mixture = compose_mixture(make_recipe({**WORK_ZONES, "count": 40, "repeats": 3}), toy_table, seed=0)
    keys = items(mixture)
    first, second, third = keys[:16], keys[16:32], keys[32:]
    assert len(set(first)) == 16 and set(first) == set(second) and first != second
    assert len(set(third)) == 8
    assert max(Counter(keys).values()) == 3


def test_epochs_use_the_same_samples_in_another_order(toy_table):
    mixture = compose_mixture(make_recipe({**NOMINAL, "count": 25}), toy_table, seed=0)
    first, second = items(mixture, epoch=0), items(mixture, epoch=1)
    assert len(set(first)) == 25 and set(first) == set(second) and first != second


def test_larger_counts_and_other_recipes_keep_the_samples_of_a_component(toy_table):
    small = compose_mixture(make_recipe({**NOMINAL, "count": 20}), toy_table, seed=3)
    large = compose_mixture(make_recipe({**NOMINAL, "count": 40}, {**WORK_ZONES, "count": 5}), toy_table, seed=3)
    assert set(items(small)) < set(items(large))


def test_filters_choose_clips(make_clip, make_table):
    table = make_table(
        make_clip(1, source="pai"),
        make_clip(2, source="waymo", kind="Syn", category="work_zone", factors=("cones", "night")),
        make_clip(3, source="waymo", category="work_zone", factors=("cones",)),
        make_clip(4, kind="front_only", category="animal"),
        make_clip(5, split="val"),
        make_clip(6, source="pai", factors=("night",), scene_id="kept_back"),
    )

    def chosen(**where):
        recipe = make_recipe({"name": "all", "where": where, "share": 1.0}, held_out_scenes=["kept_back"])
        return clip_numbers(items(compose_mixture(recipe, table, 0)))

    assert chosen() == {1, 2, 3}
    assert chosen(kind="Syn") == {2}
    assert chosen(source=["pai"]) == {1}
    assert chosen(category=["work_zone", "nominal"]) == {1, 2, 3}
    assert chosen(category_not=["nominal"]) == {2, 3}
    assert chosen(factors_any=["cones", "rain"]) == {2, 3}
    assert chosen(factors_all=["cones", "night"]) == {2}
    assert chosen(factors_none=["night", "rain"]) == {1, 3}


@pytest.mark.parametrize(("prefer", "expected"), [("GT", {1, 4, 5}), ("Syn", {2, 3, 4, 5}), (None, {1, 2, 3, 4, 5})])
def test_preference_decides_only_where_a_scene_has_both_kinds(make_clip, make_table, prefer, expected):
    table = make_table(
        make_clip(1, scene_id="both"),
        make_clip(2, scene_id="both", kind="Syn"),
        make_clip(3, scene_id="both", kind="Syn"),
        make_clip(4, scene_id="measured"),
        make_clip(5, scene_id="made", kind="Syn"),
    )
    recipe = make_recipe({"name": "all", "share": 1.0, "prefer": prefer})
    assert clip_numbers(items(compose_mixture(recipe, table, 0))) == expected


def test_without_samples_the_scarcest_component_sets_the_epoch(toy_table):
    components = {**NOMINAL, "share": 0.7}, {**WORK_ZONES, "share": 0.3}
    assert compose_mixture(make_recipe(*components), toy_table, 0).counts() == [37, 16]  # floor(16 / 0.3) = 53
    assert compose_mixture(make_recipe(*components, samples=50), toy_table, 0).counts() == [35, 15]


def test_toy_recipes_compare_mixtures_of_one_size(toy_table):
    assert compose_mixture(builtin_recipe("toy_nominal"), toy_table, 0).counts() == [512]
    assert compose_mixture(builtin_recipe("toy_nominal_long_tail"), toy_table, 0).counts() == [256, 256]


def test_shortage_names_component_filter_and_what_was_found(toy_table):
    with pytest.raises(InputError) as error:
        compose_mixture(make_recipe({**WORK_ZONES, "count": 17}), toy_table, 0)
    assert str(error.value) == (
        "recipe mine: component 'work_zones' {kind: Syn, category: [work_zone]} asks for 17 samples per epoch, but "
        "matches 8 clips with 16 samples (repeats 1); split train holds 20 GT nominal from world, 8 Syn work_zone "
        "from world; change the filter, ask for fewer or allow more repeats"
    )
    assert compose_mixture(make_recipe({**WORK_ZONES, "count": 17, "repeats": 2}), toy_table, 0).counts() == [17]


def test_a_share_too_small_for_one_item_is_a_shortage(toy_table):
    recipe = make_recipe({**NOMINAL, "share": 0.99}, {**WORK_ZONES, "share": 0.01}, samples=40)
    with pytest.raises(InputError, match="the share of component 'work_zones' of 40 samples per epoch gives it none"):
        compose_mixture(recipe, toy_table, 0)


def test_nothing_found_is_a_shortage_in_every_kind_of_recipe(toy_table):
    nothing = {"name": "animals", "where": {"category": ["animal"]}}
    for amount in ({"share": 1.0}, {"count": 1}):
        with pytest.raises(InputError, match=r"'animals' \{category: \[animal\]\} asks for .* matches 0 clips"):
            compose_mixture(make_recipe({**nothing, **amount}), toy_table, 0)
    with pytest.raises(InputError, match="split val holds no clips"):
        compose_mixture(make_recipe({**NOMINAL, "share": 1.0}, split="val"), toy_table, 0)


def test_components_must_not_share_clips(toy_table):
    with pytest.raises(InputError, match=re.escape("is in component 'nominal' {kind: GT, category: [nominal]} and in")):
        compose_mixture(make_recipe({**NOMINAL, "count": 1}, {"name": "all", "count": 1}), toy_table, 0)


def test_description_adds_up(toy_table):
    recipe = make_recipe({**NOMINAL, "share": 0.6}, {**WORK_ZONES, "share": 0.4, "repeats": 2}, samples=71)
    summary = compose_mixture(recipe, toy_table, 0).describe()
    nominal, work_zones = summary["components"]
    assert (nominal["asked"], nominal["got"], nominal["distinct"], nominal["repeats"]) == (42.6, 43, 43, 1)
    assert (work_zones["asked"], work_zones["got"], work_zones["distinct"], work_zones["repeats"]) == (28.4, 28, 16, 2)
    assert summary["by_kind"] == {"GT": {"got": 43, "distinct": 43}, "Syn": {"got": 28, "distinct": 16}}
    assert summary["by_category"]["work_zone"] == {"got": 28, "distinct": 16}
    assert summary["by_source"] == {"world": {"got": 71, "distinct": 59}}


def test_leaking_mixture_is_refused(toy_table, make_clip, make_table):
    recipe = make_recipe({**NOMINAL, "share": 1.0})
    with pytest.raises(InputError, match=r"recipe mine leaks: scene scene_7: clip .* shows a held-out scene"):
        compose_mixture(recipe, toy_table, 0, held_out_scenes=["scene_7"])
    twins = make_table(make_clip(1, scene_id="s"), make_clip(2, scene_id="s", kind="Syn", split="test"))
    with pytest.raises(InputError, match="scene s: its GT clips in split train and its Syn clips in test"):
        compose_mixture(recipe, twins, 0)


def test_check_lists_everything_at_once(toy_table):
    recipe = make_recipe(
        {**NOMINAL, "count": 61},
        {"name": "rare", "where": {"category": ["animal"], "factors_any": ["deer"]}, "count": 1},
    )
    findings = check_recipe(recipe, toy_table, held_out_scenes=["scene_7"])
    assert [line.split("'")[1] for line in findings["shortages"]] == ["nominal", "rare"]
    assert [line.split(":")[0] for line in findings["leaks"]] == ["scene scene_7"]
    assert findings["absent"] == [
        "component 'rare': where.category: no clip has 'animal'",
        "component 'rare': where.factors_any: no clip has 'deer'",
    ]


@pytest.mark.parametrize(
    "arguments",
    [
        {"batch_size": 0},
        {"batch_size": 9, "world_size": 2},
        {"batch_size": 8, "rank": 2, "world_size": 2},
        {"batch_size": 8, "rank": -1},
        {"batch_size": 8, "start_batch": -1},
    ],
)
def test_slices_that_do_not_fit_are_refused(toy_table, arguments):
    mixture = compose_mixture(make_recipe({**NOMINAL, "share": 1.0}), toy_table, 0)
    with pytest.raises(InputError, match="must"):
        mixture.epoch(0, **arguments)
