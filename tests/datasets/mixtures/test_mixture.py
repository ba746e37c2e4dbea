import re
from collections import Counter
from dataclasses import replace
from itertools import chain

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_datasets.mixtures.mixture import check_recipe, compose_mixture
from olt_datasets.mixtures.recipe import find_recipe, parse_recipe
from olt_generator.errors import InputError
from olt_toolkit.clips.clip import ClipOrigin, ViewProvenance

NOMINAL = {"name": "nominal", "where": {"kind": "GT", "category": ["nominal"]}}
WORK_ZONES = {"name": "work_zones", "where": {"kind": "Syn", "category": ["work_zone"]}}
SETTINGS = settings(max_examples=25, deadline=None)


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


def test_a_rank_takes_every_nth_item_from_its_own_on_and_starts_again_at_any_batch(toy_table):
    recipe = make_recipe({**NOMINAL, "count": 45}, {**WORK_ZONES, "count": 5})
    mixture = compose_mixture(recipe, toy_table, 0)
    whole = mixture.epoch(1, 12)
    assert [len(batch) for batch in whole] == [12, 12, 12, 12, 2]
    for start in range(6):
        ranks = [list(mixture.epoch(1, 12, rank, 3, start_batch=start)) for rank in range(3)]
        assert ranks == [[batch[rank::3] for batch in whole[start:]] for rank in range(3)]


@SETTINGS
@given(
    data=st.data(), stop=st.integers(0, 12), before=st.sampled_from([1, 2, 3, 6]), after=st.sampled_from([1, 4, 6, 12])
)
def test_ranks_may_change_in_the_middle_of_an_epoch(toy_table, data, stop, before, after):
    """What some ranks got up to a batch, and others from there on, is the epoch once and nothing else."""
    mixture = data.draw(mixtures(toy_table))
    batches_before = [mixture.epoch(2, 12, rank, before)[:stop] for rank in range(before)]
    batches_after = [list(mixture.epoch(2, 12, rank, after, start_batch=stop)) for rank in range(after)]
    got = chain.from_iterable(batches_before + batches_after)
    assert Counter(chain.from_iterable(got)) == Counter(items(mixture, epoch=2, batch_size=12))


@SETTINGS
@given(data=st.data(), batch_size=st.integers(1, 20), start=st.integers(0, 30))
def test_resuming_gives_the_tail_of_the_epoch(toy_table, data, batch_size, start):
    mixture = data.draw(mixtures(toy_table))
    resumed, whole = mixture.epoch(1, batch_size, start_batch=start), list(mixture.epoch(1, batch_size))
    assert list(resumed) == whole[start:] and len(resumed) == len(whole[start:])


@SETTINGS
@given(seed=st.integers(0, 10**6), epoch=st.integers(0, 10))
def test_a_pure_function_of_its_arguments(toy_table, seed, epoch):
    recipe = make_recipe({**NOMINAL, "count": 30}, {**WORK_ZONES, "count": 10})
    first, second = compose_mixture(recipe, toy_table, seed), compose_mixture(recipe, toy_table.clone(), seed)
    second.epoch(epoch + 1, 4)  # what was asked before leaves no trace
    assert list(first.epoch(epoch, 8)) == list(second.epoch(epoch, 8))
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
        return clip_numbers(items(compose_mixture(recipe, table, 0, allow_uncompared=True)))

    assert chosen() == {1, 2, 3}
    assert chosen(kind="Syn") == {2}
    assert chosen(source=["pai"]) == {1}
    assert chosen(category=["work_zone", "nominal"]) == {1, 2, 3}
    assert chosen(category_not=["nominal"]) == {2, 3}
    assert chosen(factors_any=["cones", "rain"]) == {2, 3}
    assert chosen(factors_all=["cones", "night"]) == {2}
    assert chosen(factors_none=["night", "rain"]) == {1, 3}


def test_clips_in_doubt_are_left_out_unless_asked_for(make_clip, make_table):
    table = make_table(
        make_clip(1),
        make_clip(2, doubts=()),
        make_clip(3, doubts=("speed", "direction")),
        make_clip(4, doubts=("speed",)),
    )
    everything = {"name": "all", "share": 1.0}
    assert clip_numbers(items(compose_mixture(make_recipe(everything), table, 0))) == {1, 2}
    taken = make_recipe({**everything, "where": {"doubts": "any"}})
    assert clip_numbers(items(compose_mixture(taken, table, 0))) == {1, 2, 3, 4}
    with pytest.raises(InputError, match="2 more match and are in doubt, `doubts: any` takes them"):
        compose_mixture(make_recipe({"name": "all", "count": 4}), table, 0)


def test_countries_choose_clips_that_tell_theirs(make_clip, make_table):
    countries = ["US", "DE", None, "JP"]
    clips = [
        make_clip(number, origin=ClipOrigin("drive", 0, 20_000_000, country=country))
        for number, country in enumerate(countries)
    ]
    recipe = make_recipe({"name": "all", "where": {"country": ["US", "JP"]}, "share": 1.0})
    mixture = compose_mixture(recipe, make_table(*clips), 0)
    assert clip_numbers(items(mixture)) == {0, 3}
    everywhere = compose_mixture(make_recipe({"name": "all", "share": 1.0}), make_table(*clips), 0)
    assert list(everywhere.describe()["by_country"]) == ["DE", "JP", "US", "not told"]


@pytest.mark.parametrize(
    ("prefer", "expected"), [("GT", {1, 4, 5, 6}), ("Syn", {2, 3, 4, 5, 6}), (None, {1, 2, 3, 4, 5, 6})]
)
def test_preference_decides_only_where_both_kinds_show_the_same_window(make_clip, make_table, prefer, expected):
    later = ClipOrigin("drive", 20_100_000, 40_000_000)
    table = make_table(
        make_clip(1, scene_id="both"),
        make_clip(2, scene_id="both", kind="Syn"),
        make_clip(3, scene_id="both", kind="Syn"),
        make_clip(4, scene_id="both", kind="Syn", origin=later),
        make_clip(5, scene_id="measured"),
        make_clip(6, scene_id="made", kind="Syn"),
    )
    recipe = make_recipe({"name": "all", "share": 1.0, "prefer": prefer})
    assert clip_numbers(items(compose_mixture(recipe, table, 0))) == expected


def test_preference_looks_at_the_component_s_own_clips(make_clip, make_table):
    """A measured twin that the filter leaves out does not displace the synthesized clip."""
    twin = (
        make_clip(1, scene_id="both", category="nominal"),
        make_clip(2, scene_id="both", kind="Syn", category="animal"),
    )
    recipe = make_recipe({"name": "animals", "where": {"category": ["animal"]}, "share": 1.0, "prefer": "GT"})
    assert clip_numbers(items(compose_mixture(recipe, make_table(*twin), 0))) == {2}


@SETTINGS
@given(cap=st.integers(1, 20), samples=st.integers(1, 60), repeats=st.integers(1, 2), seed=st.integers(0, 5))
def test_a_cap_bounds_the_samples_of_its_category(toy_table, cap, samples, repeats, seed):
    part = {"name": "all", "share": 1.0, "repeats": repeats, "caps": {"work_zone": cap}}
    mixture = compose_mixture(make_recipe(part, samples=samples), toy_table, seed)
    capped = mixture.samples.filter(category="work_zone")
    assert len(mixture.samples) == samples and len(capped) <= cap
    free = compose_mixture(make_recipe({**part, "caps": {}}, samples=samples), toy_table, seed)
    if len(free.samples.filter(category="work_zone")) <= cap:
        assert mixture.samples.equals(free.samples)


def test_caps_count_among_what_is_available(toy_table):
    part = {"name": "all", "share": 1.0, "caps": {"work_zone": 5, "nominal": 10, "animal": 3}}
    assert compose_mixture(make_recipe(part), toy_table, 0).describe()["by_category"] == {
        "nominal": {"got": 10, "distinct": 10},
        "work_zone": {"got": 5, "distinct": 5},
    }
    with pytest.raises(InputError, match="asks for 16 samples per epoch, but matches 28 clips with 15 samples"):
        compose_mixture(make_recipe(part, samples=16), toy_table, 0)


@SETTINGS
@given(
    data=st.data(),
    first=st.integers(0, 100),
    last=st.integers(0, 100),
    end=st.integers(1, 6),
    between=st.sampled_from(["linear", "steps"]),
    epoch=st.integers(0, 9),
)
def test_a_curriculum_is_exact_in_every_epoch_and_batch(toy_table, data, first, last, end, between, epoch):
    """Work zones go from `first` to `last` percent; every epoch and every batch is within one item of its share."""
    if max(first, last) == 0 or min(first, last) == 100:
        first, last = 20, 40
    shares = {0: first / 100, end: last / 100}
    recipe = make_recipe(
        {**NOMINAL, "share_by_epoch": {at: round(1 - share, 2) for at, share in shares.items()}},
        {**WORK_ZONES, "share_by_epoch": shares, "repeats": 4},
        samples=60,
        between_epochs=between,
    )
    mixture = compose_mixture(recipe, toy_table, 0)
    progress = min(epoch / end, 1.0) if between == "linear" else float(epoch >= end)
    expected = (first + (last - first) * progress) / 100
    assert abs(mixture.counts(epoch)[1] - 60 * expected) < 1 + 1e-9 and sum(mixture.counts(epoch)) == 60
    for batch in mixture.epoch(epoch, data.draw(st.integers(1, 60))):
        got = sum(int(key.clip_id[-12:]) >= 100 for key in batch)
        assert abs(got - len(batch) * mixture.counts(epoch)[1] / 60) < 1


def test_a_curriculum_is_described_by_epoch(toy_table):
    recipe = make_recipe(
        {**NOMINAL, "share_by_epoch": {0: 1.0, 4: 0.5}}, {**WORK_ZONES, "share_by_epoch": {0: 0.0, 4: 0.5}}, samples=32
    )
    mixture = compose_mixture(recipe, toy_table, 0)
    assert [mixture.counts(epoch) for epoch in (0, 1, 2, 4, 9)] == [[32, 0], [28, 4], [24, 8], [16, 16], [16, 16]]
    assert mixture.describe()["items_by_epoch"] == {"0": [32, 0], "4": [16, 16]}
    assert [part["share"] for part in mixture.describe(epoch=2)["components"]] == [0.75, 0.25]
    assert mixture.describe(epoch=0)["by_kind"]["Syn"] == {"got": 0, "distinct": 16}


def test_the_scarcest_epoch_of_a_curriculum_sets_its_size(toy_table):
    recipe = make_recipe(
        {**NOMINAL, "share_by_epoch": {0: 0.9, 1: 0.6}}, {**WORK_ZONES, "share_by_epoch": {0: 0.1, 1: 0.4}}
    )
    assert len(compose_mixture(recipe, toy_table, 0)) == 40  # floor(16 / 0.4), less than floor(60 / 0.9)


def test_the_recipes_of_the_paper_give_its_numbers(make_clip, make_table):
    """10,000 nominal clips are too many for a quick test: 10 and 4 stand for them here, by the same recipes."""
    nominal = [make_clip(number, source="pav", category="unlabelled") for number in range(12)]
    long_tail = [make_clip(100 + number, source="pav", category="cyclists", samples=3) for number in range(5)]
    made = [make_clip(200 + number, source="pav", category="cyclists", kind="Syn", samples=3) for number in range(5)]
    waymo = [make_clip(300 + number, source="waymo_e2e", kind=("GT", "Syn")[number % 2]) for number in range(8)]
    table = make_table(*nominal, *long_tail, *made, *waymo)
    sizes = {"nominal": 10, "nv_ood": 4, "waymo": 3}
    got = {}
    for name in ("nominal_10k", "nv_ood_gt", "nv_ood_syn", "gt_longtail", "syn_longtail"):
        recipe = find_recipe(name)
        smaller = [part.model_copy(update={"count": sizes[part.name]}) for part in recipe.components]
        summary = compose_mixture(recipe.model_copy(update={"components": tuple(smaller)}), table, 0).describe()
        got[name] = {kind: numbers["got"] for kind, numbers in summary["by_kind"].items()}
    assert got == {
        "nominal_10k": {"GT": 10},
        "nv_ood_gt": {"GT": 14},
        "nv_ood_syn": {"GT": 10, "Syn": 4},
        "gt_longtail": {"GT": 17},
        "syn_longtail": {"GT": 10, "Syn": 7},
    }


@pytest.mark.parametrize(
    ("name", "samples"),
    [
        ("base_r1", 0),
        ("base_1_5", 0),
        ("nominal_10k", 10_000),
        ("nv_ood_gt", 12_248),
        ("nv_ood_syn", 12_248),
        ("gt_longtail", 13_248),
        ("syn_longtail", 13_248),
    ],
)
def test_the_recipes_of_the_paper_ask_for_its_samples(name, samples):
    assert sum(part.count for part in find_recipe(name).components) == samples


def test_a_recipe_of_nothing_is_composed_and_not_trained_on(toy_table):
    mixture = compose_mixture(find_recipe("base_r1"), toy_table, 0)
    assert len(mixture) == 0 and mixture.counts() == [] and mixture.describe()["by_source"] == {}
    findings = check_recipe(find_recipe("base_r1"), toy_table)
    assert (findings["shortages"], findings["leaks"].leaks, findings["absent"]) == ([], (), [])
    assert findings["leaks"].empty == "the recipe takes no clip"
    with pytest.raises(InputError, match="recipe base_r1 has no samples to train on"):
        mixture.epoch(0, 8)


def test_without_samples_the_scarcest_component_sets_the_epoch(toy_table):
    components = {**NOMINAL, "share": 0.7}, {**WORK_ZONES, "share": 0.3}
    assert compose_mixture(make_recipe(*components), toy_table, 0).counts() == [37, 16]  # floor(16 / 0.3) = 53
    assert compose_mixture(make_recipe(*components, samples=50), toy_table, 0).counts() == [35, 15]


def test_toy_recipes_compare_mixtures_of_one_size(toy_table):
    assert compose_mixture(find_recipe("toy_nominal"), toy_table, 0).counts() == [512]
    assert compose_mixture(find_recipe("toy_nominal_long_tail"), toy_table, 0).counts() == [256, 256]


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
    assert [(short.component, short.asked, short.available) for short in findings["shortages"]] == [
        ("nominal", 61, 60),
        ("rare", 1, 0),
    ]
    assert [leak.scene_id for leak in findings["leaks"].leaks] == ["scene_7"]
    assert findings["absent"] == [("rare", "category", "animal"), ("rare", "factors_any", "deer")]


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


def view(observed, invented):
    return ViewProvenance("warped", "test", "1", 0, observed, invented)


@pytest.fixture(scope="module")
def measured_table(make_clip, make_table):
    """40 clips of two samples and two views, and 10 of which nothing was measured.

    Number n has n % invented, 10 % black and n / 100 m/s2 of noise; its second sample errs by n / 50 m.
    """
    clips = [
        replace(
            make_clip(number, samples=2),
            views={"a": view(1.0 - number / 50, number / 50), "b": view(0.8, 0.0)},
            acceleration_noise=number / 100,
            action_errors=(0.0, number / 50),
        )
        for number in range(40)
    ]
    return make_table(*clips, *(make_clip(100 + number, samples=2) for number in range(10)))


def compose_where(table, **fields):
    part = {"name": "all", **fields}
    return compose_mixture(make_recipe(part if "count" in part else part | {"share": 1.0}), table, 0)


@pytest.mark.parametrize(
    ("limits", "clips"),
    [
        ({"invented_share_max": 0.1}, 11),
        ({"observed_share_min": 0.845}, 6),
        ({"unseen_share_max": 0.09}, 0),
        ({"unseen_share_max": 0.11}, 40),
        ({"acceleration_noise_max": 0.2}, 21),
        ({"action_error_max": 0.3}, 40),
        ({"invented_share_max": 0.1, "acceleration_noise_max": 0.05}, 6),
    ],
)
def test_limits_leave_out_clips_or_say_that_none_is_left(measured_table, limits, clips):
    if not clips:
        with pytest.raises(InputError, match=r"matches 0 clips with 0 samples .* of 10 more a number that it asks for"):
            compose_where(measured_table, where=limits)
        return
    mixture = compose_where(measured_table, where=limits)
    assert clip_numbers(items(mixture)) == set(range(clips))
    assert mixture.components[0].not_measured == 10
    taken = compose_where(measured_table, where=limits | {"not_measured": "take"})
    assert clip_numbers(items(taken)) == {*range(clips), *range(100, 110)}


def test_an_action_error_leaves_out_single_samples(measured_table):
    mixture = compose_where(measured_table, where={"action_error_max": 0.3})
    errors = mixture.samples["action_error"]
    assert len(errors) == 40 + 16 and errors.max() == 0.3


def test_a_mixture_tells_pixels_and_labels_of_its_items(measured_table):
    told = compose_where(measured_table).describe()
    assert told["quality"] == told["components"][0]["quality"]
    assert {name: numbers["mean"] for name, numbers in told["quality"].items()} == pytest.approx(
        {
            "observed_share": (0.61 + 0.8) / 2,
            "invented_share": 0.195,
            "unseen_share": 0.1,
            "acceleration_noise": 0.195,
            "action_error": 0.195,
        }
    )
    assert [numbers["not_measured"] for numbers in told["quality"].values()] == [20] * 5
    assert told["quality"]["action_error"]["beyond_tolerance"] == 24


def test_weights_shift_what_is_drawn_and_say_where_they_choose_nothing(measured_table):
    weights = {"invented_share": 0.02}
    plain = compose_where(measured_table, where={"invented_share_max": 1.0}, count=20)
    weighed = compose_where(measured_table, weight_by=weights, count=20)
    means = [mixture.describe()["quality"]["invented_share"]["mean"] for mixture in (plain, weighed)]
    assert means[1] < 0.5 * means[0]
    assert weighed.components[0].word_weights() == "20 of 80 samples"
    whole = compose_where(measured_table, weight_by=weights)
    assert whole.components[0].word_weights() == "nothing: all 80 samples are drawn; ask for fewer"
    assert compose_where(measured_table).components[0].word_weights() is None


@pytest.mark.parametrize(
    ("part", "message"),
    [
        ({"where": {"invented_share_max": 1.5}}, "where.invented_share_max: input should be less than or equal to 1"),
        ({"where": {"acceleration_noise_max": float("nan")}}, "where.acceleration_noise_max: input should be"),
        ({"where": {"not_measured": "take"}}, "'not_measured' is for limits and 'weight_by'"),
        ({"weight_by": {"invented_share": 0.0}}, "weight_by.invented_share: input should be greater than 0"),
        ({"weight_by": {"beauty": 1.0}}, "weight_by.beauty"),
    ],
)
def test_limits_and_weights_that_mean_nothing_are_refused(part, message):
    with pytest.raises(InputError, match=re.escape(message)):
        make_recipe({"name": "all", "share": 1.0, **part})


def test_an_epoch_beyond_all_memory_is_refused(toy_table):
    content = {"name": "a", "description": "", "version": 1, "components": [{"name": "all", "share": 1e-9}]}
    content["components"].append({"name": "rest", "share": 1.0 - 1e-9, "where": {"kind": "Syn"}, "repeats": 10**8})
    content["components"][0] |= {"where": {"kind": "GT"}, "repeats": 10**8}
    with pytest.raises(
        InputError, match=r"recipe a: an epoch would have \d+ samples, more than 100000000; give 'samples'"
    ):
        compose_mixture(parse_recipe(content, "given"), toy_table, 0)


def test_steps_need_no_epoch_between_the_named(toy_table):
    shares = {"first": {0: 0.2, 10_000: 0.7}, "second": {0: 0.8, 10_000: 0.3}}
    components = [
        {"name": name, "share_by_epoch": by_epoch, "where": {"kind": kind}}
        for (name, by_epoch), kind in zip(shares.items(), ("GT", "Syn"), strict=True)
    ]
    content = {"name": "a", "description": "", "version": 1, "samples": 10, "components": components}
    mixture = compose_mixture(parse_recipe(content | {"between_epochs": "steps"}, "given"), toy_table, 0)
    assert [mixture.counts(epoch) for epoch in (0, 9_999, 10_000)] == [[2, 8], [2, 8], [7, 3]]
    assert [len(part.samples) for part in mixture.components] == [7, 8]
