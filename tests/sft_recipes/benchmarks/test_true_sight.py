"""With a true sight the choice of plans meets nobody."""

import json

import pytest
from typer.testing import CliRunner

from olt_sft_recipes.benchmarks.true_sight import app


def drive(*events):
    result = CliRunner().invoke(app, [*events, "--json"])
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout[result.stdout.index("{") :])["scores"]


@pytest.mark.parametrize("event", ["half_lane_truck", "delivery_van_on_curve"])
def test_it_gets_around_what_stands_in_its_lane_with_oncoming_traffic(event):
    (score,) = drive(event)
    assert score["score"] > 0.8 and not score["collided"]


def test_it_passes_a_van_that_stands_and_lets_a_rider_cross():
    for score in drive("half_lane_truck_on_curve", "rider_crosses"):
        assert score["valid"] and not score["collided"] and not score["offroad"] and score["score"] > 0.8


@pytest.mark.slow
def test_it_drives_the_suite():
    scores = drive()
    assert len(scores) == 53 and sum(score["collided"] for score in scores) <= 1
    assert sum(score["score"] for score in scores) > 0.9 * 53
