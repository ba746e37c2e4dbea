"""The benchmarks of scoring: their reference is independent, and sampling moves `strict` far less than `alpasim`."""

import numpy as np
import pytest

from olt_closed_loop.benchmarks.score import continuous_contact, sampled_contact
from olt_closed_loop.benchmarks.score_drives import KINDS, known_drives
from olt_closed_loop.scoring.definitions import score_record
from olt_toolkit.bench.runner import load_benchmark


@pytest.mark.parametrize(
    ("name", "default"),
    [
        ("score", "strict, 100 ms"),
        ("contacts", "continuous, 100 ms"),
        ("fault", "100 ms"),
        ("score_traffic", "strict, 20 agents"),
    ],
)
def test_the_benchmarks_are_registered_and_have_one_default(name, default):
    settings = load_benchmark(name).settings()
    assert [setting.name for setting in settings if setting.default] == [default]
    assert len({setting.name for setting in settings}) == len(settings)


def test_contacts_move_little_with_the_step_and_alpasims_a_lot():
    drives = [drive for drive in known_drives(12) if np.isfinite(drive.contact_us())]
    assert len(drives) >= 4
    exact = np.array([drive.contact_us() for drive in drives])
    ours, theirs = (
        np.array([find(drive.sampled(100_000)) for drive in drives]) for find in (continuous_contact, sampled_contact)
    )
    assert np.abs(ours - exact).max() < 2_000
    assert np.abs(theirs - exact).max() > 20_000


def test_all_kinds_of_drives_are_scored_alike_at_any_step():
    for drive in known_drives(2 * len(KINDS)):
        scores = [score_record(drive.sampled(step)) for step in (20_000, 100_000, 500_000)]
        assert len({(score.reason, score.collided) for score in scores}) == 1
