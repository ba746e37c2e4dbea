import polars as pl
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from olt_datasets.mixtures.draws import PRIORITY, draw_samples, sample_count
from olt_datasets.mixtures.recipe import Component, Filter
from olt_generator.seeds import make_generator
from olt_toolkit.clips.clip import make_clip_id

SETTINGS = settings(max_examples=30, deadline=None)
SCHEMA = {
    "clip_id": pl.String,
    "scene_id": pl.String,
    "start_us": pl.Int64,
    "kind": pl.String,
    "sample_t0_us": pl.List(pl.Int64),
    "action_errors": pl.List(pl.Float64),
}


def component(**fields):
    return Component(name="all", share=1.0, **fields)


def make_clips(times, kind="GT", errors=None):
    """Clips with these sample times and action errors, two windows of each scene."""
    rows = [
        (make_clip_id(f"clip {number}", kind), f"a source/scene {number // 2}", 20_000_000 * (number % 2), kind, *each)
        for number, each in enumerate(zip(times, errors or [None] * len(times), strict=True))
    ]
    return pl.LazyFrame(rows, SCHEMA, orient="row")


@pytest.fixture(scope="module")
def clips():
    """500 clips with 0 to 4 sample times around the keyframe."""
    return make_clips([[4_900_000 + 150_000 * index for index in range(number % 5)] for number in range(500)])


def draw(clips, count, seed=0, **fields):
    part = component(**fields)
    available = clips.select(sample_count(part).sum()).collect().item()
    drawn = draw_samples(clips, part, available, min(count, available), seed, ("clip_id",))
    return drawn.select("clip_id", "t0_us").rows()


@SETTINGS
@given(count=st.integers(0, 1000), seed=st.integers(0, 100))
@example(count=1000, seed=0)
def test_a_draw_has_its_size_and_no_sample_twice(clips, count, seed):
    drawn = draw(clips, count, seed)
    assert len(drawn) == len(set(drawn)) == count
    everything = clips.select("clip_id", "sample_t0_us").explode("sample_t0_us").drop_nulls().collect().rows()
    assert set(drawn) <= set(everything) and len(everything) == 1000


@SETTINGS
@given(smaller=st.integers(0, 1000), larger=st.integers(0, 1000), seed=st.integers(0, 100))
def test_a_larger_draw_begins_with_the_smaller_one(clips, smaller, larger, seed):
    smaller, larger = sorted((smaller, larger))
    assert draw(clips, larger, seed)[:smaller] == draw(clips, smaller, seed)


@SETTINGS
@given(parts=st.integers(1, 6), order=st.randoms(use_true_random=False))
def test_neither_order_nor_division_of_the_table_matters(clips, parts, order):
    rows = clips.collect()
    numbers = list(range(len(rows)))
    order.shuffle(numbers)
    divided = [rows[numbers[part::parts]].lazy() for part in range(parts)]
    assert draw(pl.concat(divided), 100) == draw(clips, 100)


def test_clips_that_are_added_move_no_other_clip(clips):
    first = clips.head(400)
    kept = {clip_id for (clip_id,) in first.select("clip_id").collect().rows()}
    still_there = [sample for sample in draw(clips, 125) if sample[0] in kept]
    assert 50 < len(still_there) < 125 and draw(first, 200)[: len(still_there)] == still_there


def test_a_bound_that_leaves_too_few_is_widened(clips):
    """The number of available samples sets the first bound only."""
    drawn = draw_samples(clips, component(), 20_000, 500, 0, ("clip_id",))
    assert drawn.select("clip_id", "t0_us").rows() == draw(clips, 500)


def test_seeds_and_names_draw_differently(clips):
    assert draw(clips, 100, seed=0) != draw(clips, 100, seed=1)
    other = draw_samples(clips, Component(name="other", share=1.0), 1000, 100, 0, ("clip_id",))
    assert other.select("clip_id", "t0_us").rows() != draw(clips, 100)


def test_priorities_are_uniform(clips):
    """The largest gap to the uniform distribution stays below what one in a thousand samples of 1,000 exceeds."""
    priorities = draw_samples(clips, component(), 1000, 1000, 7, ("clip_id",))[PRIORITY].sort()
    ranks = pl.int_range(1000, eager=True) / 1000
    assert (priorities.cast(pl.Float64) / 2**64 - ranks).abs().max() < 1.95 / 1000**0.5


def test_priorities_are_what_the_equation_says():
    """A plain reference in Python integers, of one clip and one time."""
    mask = 2**64 - 1
    text = b"a source/scene 0".rjust(48)
    words = [int.from_bytes(text[first : first + 8], "little") for first in range(0, 48, 8)] + [0]
    keys = make_generator("mixture samples", 3, "all").integers(2**64, size=7, dtype="u8")
    word = (1_700_000 + sum(a * (int(b) | 1) for a, b in zip(words, keys, strict=True))) & mask
    word = ((word ^ (word >> 30)) * 0xBF58476D1CE4E5B9) & mask
    word = ((word ^ (word >> 27)) * 0x94D049BB133111EB) & mask
    drawn = draw_samples(make_clips([[1_700_000]]), component(where=Filter(kind="GT")), 1, 1, 3, ("clip_id",))
    assert drawn.drop("clip_id").row(0, named=True) == {
        PRIORITY: word ^ (word >> 31),
        "t0_us": 1_700_000,
        "action_error": None,
    }


@pytest.mark.parametrize("same", [component(where=Filter(kind="Syn")), component(prefer="Syn")])
def test_both_kinds_of_a_window_are_drawn_alike(same):
    def draw_windows(kind, part):
        columns = ("clip_id", "scene_id", "start_us")
        return draw_samples(make_clips([[5_100_000]] * 200, kind), part, 200, 50, 0, columns).drop("clip_id")

    measured = draw_windows("GT", component(where=Filter(kind="GT")))
    assert measured.equals(draw_windows("Syn", same))
    assert not measured.equals(draw_windows("Syn", component()))


@pytest.mark.parametrize(
    ("times", "fields", "expected"),
    [
        ([1, 2, 3], {}, [1, 2, 3]),
        ([1_700_000, 5_000_000, 5_150_000, 9_000_000], {"t0": "keyframe"}, [5_150_000]),
        ([1_700_000], {"t0": "keyframe"}, [1_700_000]),
        ([], {"t0": "keyframe"}, []),
        ([1, 2, 3], {"samples_per_clip": 1}, [2]),
        ([1, 2, 3, 4], {"samples_per_clip": 2}, [2, 4]),
        ([1, 2, 3], {"samples_per_clip": 3}, [1, 2, 3]),
        ([1, 2, 3], {"samples_per_clip": 5}, [1, 2, 3]),
        ([], {"samples_per_clip": 2}, []),
    ],
)
def test_sample_times_of_a_clip(times, fields, expected):
    clips = make_clips([times])
    assert sorted(t0_us for _, t0_us in draw(clips, 10, **fields)) == expected
    assert clips.select(sample_count(component(**fields))).collect().item() == len(expected)


TIMES = [1_700_000, 5_000_000, 5_150_000, 9_000_000]


@pytest.mark.parametrize(
    ("errors", "fields", "expected"),
    [
        ([0.1, 0.3, 0.4, 0.2], {}, [1_700_000, 5_000_000, 9_000_000]),
        ([0.1, 0.3, 0.4, 0.2], {"t0": "keyframe"}, [5_000_000]),
        ([0.1, 0.4, 0.2, 0.2], {"samples_per_clip": 1}, [5_150_000]),
        ([0.4, 0.4, 0.4, 0.4], {}, []),
        ([0.4, 0.4, 0.4, 0.4], {"t0": "keyframe"}, []),
        (None, {}, TIMES),
    ],
)
def test_samples_whose_future_no_action_drives_are_not_drawn(errors, fields, expected):
    clips = make_clips([TIMES], errors=[errors])
    part = {"where": Filter(action_error_max=0.3, not_measured="take")} | fields
    assert sorted(t0_us for _, t0_us in draw(clips, 10, **part)) == expected
    count = 1 if fields and expected else len(expected)
    assert clips.select(sample_count(component(**part))).collect().item() == count


def test_drawn_samples_carry_their_own_action_error():
    times, errors = [[*range(10)] for _ in range(30)], [[clip + time / 100 for time in range(10)] for clip in range(30)]
    clips = make_clips(times, errors=errors)
    for part in (component(), component(samples_per_clip=3), component(where=Filter(action_error_max=20.0))):
        drawn = draw_samples(clips, part, 300, 60, 0, ("clip_id",))
        known = {clip_id: number for number, clip_id in enumerate(clips.collect()["clip_id"])}
        for clip_id, t0_us, error in drawn.select("clip_id", "t0_us", "action_error").rows():
            assert error == errors[known[clip_id]][t0_us]


def weighted(shares, kind="GT"):
    """A clip of one sample for each invented share."""
    clips = make_clips([[5_100_000]] * len(shares), kind)
    return clips.with_columns(pl.Series("invented_share", shares, pl.Float64))


def draw_weighted(clips, count, seed=0, halving=0.25):
    part = component(weight_by={"invented_share": halving}, where=Filter(kind="GT"))
    available = clips.collect().height
    drawn = draw_samples(clips, part, available, count, seed, ("clip_id", "scene_id", "invented_share"))
    return drawn.drop(PRIORITY)


def test_a_weight_halves_as_often_as_the_recipe_says():
    """First draws of many seeds, of shares whose weights are 1, 1/2, 1/4 and 1/8: within 4 standard deviations."""
    clips, draws = weighted([0.0, 0.25, 0.5, 0.75]), 500
    first = [draw_weighted(clips, 1, seed)["invented_share"][0] for seed in range(draws)]
    for share, weight in zip((0.0, 0.25, 0.5, 0.75), (8 / 15, 4 / 15, 2 / 15, 1 / 15), strict=True):
        assert abs(first.count(share) / draws - weight) < 4 * (weight * (1 - weight) / draws) ** 0.5


@SETTINGS
@given(
    shares=st.lists(st.one_of(st.none(), st.floats(0.0, 1.0)), min_size=1, max_size=60),
    halving=st.floats(1e-6, 1e3),
    data=st.data(),
)
def test_weighted_draws_keep_what_plain_ones_promise(shares, halving, data):
    clips = weighted(shares)
    smaller, larger = sorted(data.draw(st.tuples(*[st.integers(0, len(shares))] * 2)))
    drawn = draw_weighted(clips, larger, halving=halving)
    assert len(drawn) == drawn.n_unique() == larger
    assert draw_weighted(clips, smaller, halving=halving).equals(drawn[:smaller])
    rows = clips.collect()
    order = data.draw(st.permutations(range(len(rows))))
    assert draw_weighted(rows[list(order)].lazy(), larger, halving=halving).equals(drawn)
    kept = rows["clip_id"][: len(shares) // 2 + 1].to_list()
    alone = draw_weighted(rows[: len(kept)].lazy(), len(kept), halving=halving)["clip_id"].to_list()
    everything = draw_weighted(clips, len(shares), halving=halving)["clip_id"].to_list()
    assert [clip_id for clip_id in everything if clip_id in kept] == alone


def test_equal_weights_draw_what_no_weights_draw():
    clips, columns = weighted([0.0] * 300), ("clip_id", "scene_id", "invented_share")
    plain = draw_samples(clips, component(where=Filter(kind="GT")), 300, 40, 0, columns)
    assert draw_weighted(clips, 40).equals(plain.drop(PRIORITY))
