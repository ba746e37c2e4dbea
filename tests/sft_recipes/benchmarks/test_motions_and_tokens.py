import numpy as np
import pytest

from olt_sft_recipes.benchmarks.motions import distances, drawn_motions, drive
from olt_sft_recipes.benchmarks.precision import cast
from olt_sft_recipes.benchmarks.tokens import BENCHMARK, describe_extreme, extreme_motions
from olt_toolkit.bench.runner import load_benchmark


def test_motions_are_those_of_closed_form():
    """An arc of radius 50 m at 8 m/s, and braking by 2 m/s^2 from 10 m/s: positions after 6.4 s."""
    arc = drive(lambda t: np.full_like(t, 8.0), lambda t: np.full_like(t, 0.02))
    angle = 0.02 * 8.0 * 6.4
    assert arc.future[0, -1] == pytest.approx([50 * np.sin(angle), 50 * (1 - np.cos(angle)), angle], abs=1e-4)
    assert arc.history.shape == (1, 16, 3) and arc.future.shape == (1, 64, 3)
    assert np.all(arc.history[0, -1] == 0.0)
    angle = -0.02 * 8.0 * 1.5
    assert arc.history[0, 0] == pytest.approx([50 * np.sin(angle), 50 * (1 - np.cos(angle)), angle], abs=1e-4)
    stop = drive(lambda t: np.maximum(10.0 - 2.0 * t, 0.0), lambda t: 0.0 * t)
    assert stop.future[0, -1, 0] == pytest.approx(25.0, abs=1e-4)


def test_drawn_motions_keep_to_the_road_and_repeat():
    motions = drawn_motions(6, seed=3)
    steps = np.linalg.norm(np.diff(motions.future[..., :2], axis=1), axis=-1) / 0.1
    turns = np.diff(motions.future[..., 2], axis=1) / 0.1
    assert steps.min() > 1.0 and np.abs(steps * turns).max() < 3.1
    assert np.array_equal(drawn_motions(6, seed=3).future, motions.future)


def test_error_falls_with_the_number_of_values_and_grows_with_the_horizon():
    errors, later = {}, {}
    for setting in BENCHMARK.settings():
        driven = setting.prepare()()
        errors[setting.name] = BENCHMARK.measure_error(driven)
        later[setting.name] = BENCHMARK.figures(driven)
    order = ["100 values", "300 values", "1000 values", "3000 tokens", "10000 values", "actions as they are"]
    assert [errors[name] for name in order] == sorted(errors.values(), reverse=True)
    told = later["3000 tokens"]
    assert told["mean error over 1 s (m)"] < told["mean error over 3 s (m)"] < told["mean error over 6.4 s (m)"] < 0.03
    assert told["saturated (%)"] == 0.0
    assert [setting.name for setting in BENCHMARK.settings() if setting.default] == ["3000 tokens"]


def test_what_saturates_is_counted_and_costs_metres():
    rows = {name: describe_extreme(name, motions) for name, motions in extreme_motions().items()}
    for hard in ("braking by 8 m/s^2 from 30 m/s", "braking by 9.5 m/s^2 from 30 m/s"):
        assert rows[hard]["saturated_accelerations"] > 20 and rows[hard]["saturated_curvatures"] == 0
        assert rows[hard]["tokens_mean_error_m"] > 5.0 > 0.05 > rows[hard]["actions_mean_error_m"]
    for tight in ("turning by 0.28 1/m at 3 m/s", "turning by 0.33 1/m at 3 m/s"):
        assert rows[tight]["saturated_curvatures"] == 64 and rows[tight]["saturated_accelerations"] == 0
        assert rows[tight]["tokens_mean_error_m"] > 0.5
    for inside in ("standstill", "braking by 5 m/s^2 from 30 m/s", "turning by 0.26 1/m at 3 m/s"):
        assert rows[inside]["saturated_accelerations"] == rows[inside]["saturated_curvatures"] == 0
        assert rows[inside]["tokens_mean_error_m"] < 0.03
    assert rows["standstill"]["tightest_per_m"] == 0.0
    assert rows["reversing at 2 m/s in a curve"]["tokens_mean_error_m"] < 0.01
    held, filled = (rows[f"curve, history {how} over a gap of 0.5 s"] for how in ("held", "filled"))
    assert held["tokens_mean_error_m"] > 1.0 > 0.1 > filled["tokens_mean_error_m"]


def test_fewer_bits_cost_more_and_float32_costs_nothing():
    benchmark = load_benchmark("precision")
    errors = {setting.name: benchmark.measure_error(setting.prepare()()) for setting in benchmark.settings()}
    whole = errors["all in float64"]
    for way in ("labels of {} poses", "{} actions", "driven out in {}"):
        of = [errors[way.format(kind)] for kind in ("float32", "float16", "bfloat16")]
        assert of == sorted(of) and abs(of[0] - whole) < 1e-5 and of[2] > 10 * whole


def test_cast_is_rounding_to_nearest_even():
    assert cast(np.array([1.0 + 2.0**-8]), "bfloat16") == 1.0
    assert cast(np.array([1.0 + 3 * 2.0**-8]), "bfloat16") == 1.015625


def test_distances_are_in_the_plane():
    motions = drawn_motions(1)
    aside = motions.future * [1.0, 1.0, 0.0] + [0.0, 2.0, 7.0]
    assert distances(aside, motions) == pytest.approx(2.0)
