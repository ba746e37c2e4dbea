"""The benchmarks of cameras: what is left out changes no byte, and what stands on the road can be told apart."""

import json

import numpy as np
import pytest

from olt_closed_loop.benchmarks import leaving_out
from olt_closed_loop.benchmarks.busy_junction import busy_junction
from olt_closed_loop.benchmarks.crop_classifier import classify
from olt_closed_loop.benchmarks.crops import CROP, KINDS, draw_sheet, film_crops
from olt_closed_loop.evaluation.gate import check_gate
from olt_toolkit.bench.runner import load_benchmark


@pytest.mark.parametrize("name", ["cameras", "cameras_toy", "leaving_out"])
def test_the_benchmarks_are_registered_and_have_one_default(name: str) -> None:
    settings = load_benchmark(name).settings()
    assert sum(setting.default for setting in settings) == 1


def test_the_ego_can_drive_through_the_junction() -> None:
    result = check_gate(busy_junction(100, 8_000_000))
    assert result.passed, result.why_not


@pytest.mark.slow
def test_leaving_out_changes_no_byte(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = busy_junction(20, 3_500_000)
    monkeypatch.setattr(leaving_out, "_scene", lambda: scene)
    monkeypatch.setattr(leaving_out, "_SIZE", (32, 56))
    texts: dict[bool, set[str]] = {True: set(), False: set()}
    for sees, kept in leaving_out._SETTINGS.values():
        texts[sees].add(leaving_out._drive(sees, kept))
    assert all(len(found) == 1 for found in texts.values())
    (text,) = texts[True]
    assert json.loads(text)[0]["plans"]


@pytest.mark.slow
def test_crops_tell_their_kinds() -> None:
    crops, kinds, distances = film_crops((160, 288), 40, 0)
    assert crops.shape == (40 * len(KINDS), CROP, CROP, 3)
    red, green = (crops[kinds == KINDS.index(kind)].astype(float).mean(axis=(0, 1, 2)) for kind in KINDS[-2:])
    assert red[0] - red[1] > green[0] - green[1] + 5.0
    assert draw_sheet(crops, kinds, distances).shape == (96 * len(KINDS), 96 * 12, 3)
    # By chance it is 1 in 13; with labels that say nothing of the crops it must be about that.
    assert classify(crops, kinds, distances, 0)["accuracy"] > 0.6
    shuffled = np.random.default_rng(0).permutation(kinds)
    assert classify(crops, shuffled, distances, 0)["accuracy"] < 0.25
