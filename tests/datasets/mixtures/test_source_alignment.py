import doctest
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import minimize
from typer.testing import CliRunner

import olt_datasets.mixtures.source_alignment as alignment_module
from olt_datasets.commands.mix import app
from olt_datasets.mixtures.source_alignment import (
    PAPER_COVERAGE,
    MissingFactor,
    align_sources,
    measure_coverage,
    propose_shares,
    total_variation,
    word_missing_factor,
)
from olt_generator.errors import InputError

SETTINGS = settings(max_examples=40, deadline=None)


def distributions(sources, factors):
    weights = arrays(np.float64, (sources, factors), elements=st.floats(0.01, 1.0))
    return weights.map(lambda rows: rows / rows.sum(axis=1, keepdims=True))


@SETTINGS
@given(rows=distributions(3, 5))
def test_total_variation_is_a_distance_from_0_to_1(rows):
    first, second, third = rows
    gap = total_variation(first, second)
    assert 0.0 <= gap <= 1.0 and gap == total_variation(second, first) and total_variation(first, first) == 0.0
    assert gap <= total_variation(first, third) + total_variation(third, second) + 1e-12
    assert np.isclose(gap, 1.0 - np.minimum(first, second).sum())


@SETTINGS
@given(rows=distributions(4, 5), start=distributions(1, 3))
def test_no_other_shares_come_closer(rows, start):
    """Against a general optimizer that knows nothing of the linear program."""
    sources, target = rows[:3], rows[3]
    shares = propose_shares(sources, target, np.full(3, 1 / 3), np.ones(3))
    assert shares.min() >= 0.0 and np.isclose(shares.sum(), 1.0)
    found = minimize(
        lambda free: total_variation(np.abs(free) / np.abs(free).sum() @ sources, target),
        start[0],
        method="Nelder-Mead",
    )
    assert total_variation(shares @ sources, target) <= found.fun + 1e-6


@SETTINGS
@given(rows=distributions(3, 4), shares=distributions(1, 3))
def test_a_target_that_the_sources_can_reach_is_reached(rows, shares):
    proposed = propose_shares(rows, shares[0] @ rows, np.full(3, 1 / 3), np.ones(3))
    assert total_variation(proposed @ rows, shares[0] @ rows) < 1e-6


def test_where_shares_do_not_matter_they_follow_the_sizes():
    same = np.tile([0.25, 0.75], (3, 1))
    np.testing.assert_allclose(propose_shares(same, same[0], np.array([0.5, 0.3, 0.2]), np.ones(3)), [0.5, 0.3, 0.2])


def test_no_source_is_asked_for_more_than_it_has():
    coverage = {"small": {"cones": 10.0}, "large": {"night": 1000.0}}
    alignment = align_sources(coverage, {"cones": 1.0}, samples=100)
    assert [round(source.share, 3) for source in alignment.sources] == [0.1, 0.9]
    with pytest.raises(InputError, match="the sources have 1010 clips, 2000 are asked for"):
        align_sources(coverage, {"cones": 1.0}, samples=2000)


def test_the_interval_covers_the_true_gap():
    """60 worlds drawn from the prior; the 95 % interval holds the true gap in all but a few."""
    random = np.random.default_rng(0)
    target = np.array([0.5, 0.3, 0.2])
    names, covered = ["a", "b", "c"], 0
    for seed in range(60):
        truth = random.dirichlet(np.full(3, 1 / 3))
        counts = random.multinomial(40, truth).astype(float)
        coverage = {"source": dict(zip(names, counts.tolist(), strict=True))}
        gap = align_sources(coverage, dict(zip(names, target.tolist(), strict=True)), seed=seed).sources[0].gap
        assert 0.0 <= gap.low <= gap.median <= gap.high <= 1.0
        covered += bool(gap.low <= total_variation(truth, target) <= gap.high)
    assert covered >= 52  # 57 are expected, with a standard deviation of 1.7


def test_the_paper_s_sources():
    alignment = align_sources(PAPER_COVERAGE, PAPER_COVERAGE["nv"])
    nvidia, waymo = alignment.sources
    assert nvidia.gap.high < waymo.gap.low and nvidia.share > 0.98
    assert [word_missing_factor(missing) for missing in alignment.missing] == [
        "waymo_e2e: none of its 52 clips has human_guided_control, 8.5 % of the target; 95 % sure that fewer than "
        "5.6 % do",
    ]
    assert doctest.testmod(alignment_module).failed == 0


def test_a_factor_that_no_source_has_is_told():
    missing = align_sources({"a": {"cones": 5.0}, "b": {"cones": 3.0}}, {"cones": 3.0, "animal": 1.0}).missing
    assert missing == (MissingFactor("animal", 0.25),)
    assert word_missing_factor(missing[0]) == (
        "no source has animal, 25.0 % of the target: no shares of them close this part of the gap"
    )


def test_a_sampled_target_widens_the_interval():
    exact = align_sources(PAPER_COVERAGE, {"human_guided_control": 3.0, "temporary_path_reassignment": 3.0})
    sampled = align_sources(
        PAPER_COVERAGE, {"human_guided_control": 3.0, "temporary_path_reassignment": 3.0}, target_is_sample=True
    )
    exact_gap, sampled_gap = exact.sources[0].gap, sampled.sources[0].gap
    assert sampled_gap.high - sampled_gap.low > 5 * (exact_gap.high - exact_gap.low)


def test_nothing_to_compare_is_refused():
    for coverage, target in [({}, {"cones": 1.0}), (PAPER_COVERAGE, {}), (PAPER_COVERAGE, {"cones": 0.0})]:
        with pytest.raises(InputError, match="no clip is left"):
            align_sources(coverage, target)


def test_a_clip_counts_once_however_many_factors_it_has(make_clip, make_table):
    table = make_table(
        make_clip(1, source="a", factors=("cones", "night")),
        make_clip(2, source="a", factors=("cones",)),
        make_clip(3, source="a"),
        make_clip(4, source="b", category="animal"),
    )
    assert measure_coverage(table) == {"a": {"cones": 1.5, "night": 0.5, "none": 1.0}, "b": {"none": 1.0}}
    assert measure_coverage(table, "category")["b"] == {"animal": 1.0}
    assert measure_coverage(table, "country") == {"a": {"none": 3.0}, "b": {"none": 1.0}}


@pytest.fixture
def store(write_store, make_clip):
    """Source a has half its training clips with cones, source b none; the test slice is all cones."""
    training = [
        make_clip(number, source="ab"[number % 2], factors=("cones",) * (number % 4 == 0)) for number in range(80)
    ]
    testing = [make_clip(100 + number, factors=("cones",), split="test") for number in range(40)]
    return write_store(*training, *testing)


def run(*arguments):
    result = CliRunner().invoke(app, ["align", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.stdout


def test_command_proposes_the_source_that_the_slice_needs(store):
    found = json.loads(run(store, "--target", "{factors_any: [cones]}", "--json"))
    shares = {source["name"]: source["share"] for source in found["sources"]}
    assert shares == {"a": 1.0, "b": 0.0} and found["target"] == {"cones": 1.0, "none": 0.0}
    assert found["proposed_gap"]["median"] < found["pooled_gap"]["median"]
    text = run(store, "--target", "{}")
    assert "b: none of its 40 clips has cones, 100.0 % of the target" in text and "proposed shares" in text


def test_command_takes_weights_and_limits(store):
    found = json.loads(run(store, "--target-weights", "cones=1, none=3", "--samples", 60, "--json"))
    assert found["target"] == {"cones": 0.25, "none": 0.75} and found["proposed_gap"]["median"] < 0.1
    assert "human_guided_control" in run("--example")
    for arguments, message in [
        ((store,), "give TABLE and one of --target and --target-weights"),
        (("--target", "{}"), "give TABLE"),
        ((store, "--target-weights", "cones"), "'cones': write FACTOR=WEIGHT"),
        ((store, "--target-weights", "cones=-1"), "write FACTOR=WEIGHT"),
        ((store, "--target", "{}", "--by", "colour"), "--by is 'colour'"),
        ((store, "--target", "{category: [none]}"), "no clip is left"),
    ]:
        with pytest.raises(InputError, match=message):
            run(*arguments)
