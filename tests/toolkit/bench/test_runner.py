import json
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_generator.errors import InputError
from olt_toolkit.bench import runner as benchmark_runner
from olt_toolkit.bench.benchmark import Benchmark, Setting
from olt_toolkit.bench.plot import plot_benchmark, spread_out


def fake_benchmark(times_and_errors):
    def settings():
        return [
            Setting(name, lambda error=error: lambda: np.array(error), default=(name == "good"))
            for name, error in times_and_errors
        ]

    return Benchmark("A title", "distance", "m", "the truth", settings, lambda result: float(result))


@pytest.fixture
def in_process(monkeypatch):
    """Measure in this process, so that a benchmark made here can be run."""

    class Pool:
        def __init__(self, *_, **__):
            pass

        def __enter__(self):
            return self

        def __exit__(self, *_):
            return None

        def submit(self, function, *arguments):
            class Future:
                def result(self):
                    return function(*arguments)

            return Future()

    monkeypatch.setattr(benchmark_runner, "ProcessPoolExecutor", Pool)


def test_report_holds_error_time_memory_and_machine(monkeypatch, in_process):
    monkeypatch.setattr(benchmark_runner, "load_benchmark", lambda _: fake_benchmark([("good", 0.0), ("bad", 2.0)]))
    report = benchmark_runner.run_benchmark("fake", repeats=5)
    assert [row["error"] for row in report["settings"]] == [0.0, 2.0]
    assert all(row["runs"] == 5 and row["median_s"] > 0 for row in report["settings"])
    assert report["settings"][0]["default"] and not report["settings"][1]["default"]
    assert report["machine"]["packages"]["numpy"]
    json.dumps(report, allow_nan=False)


def test_pareto_front_keeps_what_nothing_beats():
    front = benchmark_runner.pareto_front([(0.0, 3.0), (1.0, 1.0), (1.0, 2.0), (2.0, 0.5)])
    assert front == [True, True, False, True]


def test_plot_is_drawn_even_where_errors_are_zero(tmp_path, monkeypatch, in_process):
    monkeypatch.setattr(benchmark_runner, "load_benchmark", lambda _: fake_benchmark([("good", 0.0), ("bad", 0.0)]))
    report = benchmark_runner.run_benchmark("fake", repeats=1)
    plot_benchmark(report, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=20))
def test_labels_keep_their_order_and_stay_apart(wanted):
    wanted = sorted(wanted, reverse=True)
    places = spread_out(wanted, 0.05)
    assert all(above - below >= 0.05 - 1e-9 for above, below in pairwise(places))
    assert places[-1] >= -1e-9 and places[0] <= 1.0 + 1e-9


def test_labels_with_room_stay_at_their_points():
    assert spread_out([0.9, 0.5, 0.1], 0.2) == [0.9, 0.5, 0.1]


def test_unknown_benchmark_names_the_known_ones():
    with pytest.raises(InputError, match="smoother, splat, tokens, vehicle"):
        benchmark_runner.load_benchmark("nothing")
