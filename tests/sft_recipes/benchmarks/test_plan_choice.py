"""What the toy thinks of its plans, held against what is there."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from olt_sft_recipes.benchmarks.plan_choice import Moment, gather_moments, measure
from olt_sft_recipes.benchmarks.quick_toy import made_up_samples
from olt_sft_recipes.toy.birds_eye import OFFSETS, STATIONS, route_cells
from olt_sft_recipes.toy.image_encoder import SECONDS_AHEAD
from olt_sft_recipes.toy.occupancy import Occupancy
from olt_sft_recipes.toy.plan_choice import WAY_WORTH, contacts_of_plan
from olt_sft_recipes.toy.route_line import RouteLine

SPEED = 8.0
AHEAD = np.column_stack([SPEED * 0.1 * np.arange(1, 65), np.zeros(64), np.zeros(64)])
LINE = RouteLine.of(route_cells(np.column_stack([np.linspace(0.0, 80.0, 20), np.zeros(20)]), 0.0))


def wall(probability):
    """A wall of 6 m, from 22 m on across the way, that is there with a probability."""
    route = np.zeros((len(SECONDS_AHEAD), len(STATIONS), len(OFFSETS)))
    route[:, np.abs(STATIONS - 25.0) < 3.0] = probability
    return Occupancy(route, np.zeros(len(STATIONS)), np.ones(route.shape[1:]), LINE)


def moment(thought, true):
    return Moment(AHEAD[None], SPEED, wall(thought), wall(true), AHEAD)


def test_true_probabilities_lie_on_the_diagonal():
    """Of ten walls that are thought to be there with 0.3, three are."""
    result = measure([moment(0.3, float(index < 3)) for index in range(10)])
    (filled,) = (row for row in result["calibration"] if row["moments"])
    assert filled["true"] == pytest.approx(filled["thought"])
    assert all(row["thought"] is row["true"] is None for row in result["calibration"] if not row["moments"])


def test_who_thinks_wrongly_is_off_the_diagonal():
    (filled,) = (row for row in measure([moment(0.9, 0.0)])["calibration"] if row["moments"])
    assert filled["thought"] > 0.5 and filled["true"] == 0.0


def test_the_more_way_is_worth_the_more_is_made_and_met():
    result = measure([moment(chance, float(chance > 0.15)) for chance in (0.0, 0.04, 0.1, 0.2)])
    first, *chosen = result["choices"]
    assert first["way_share"] == pytest.approx(1.0) and first["meets_share"] == pytest.approx(0.25)
    chosen = [row for row in chosen if row["worth"] != "true sight"]
    ways, met = [row["way_share"] for row in chosen], [row["meets_share"] for row in chosen]
    assert ways == sorted(ways) and met == sorted(met)
    assert ways[0] < 0.9 and met[0] == 0.0 and met[-1] == pytest.approx(0.25)
    assert result["own_worth"] == WAY_WORTH


class Drawing:
    """A policy that draws one plan and sees nobody."""

    def draw(self, observation):
        return SimpleNamespace(plans=AHEAD[None], speed=SPEED, line=LINE, occupancy=lambda: wall(0.0))


def test_moments_are_those_of_samples_that_know_what_is_where():
    nobody = {
        "obstacle_boxes": np.full((5, 32, 5), np.nan, np.float32),
        "hold": np.zeros(2, np.float32),
        "road": np.column_stack([np.linspace(0.0, 80.0, 20), np.zeros(20), np.full((20, 2), 3.0)]).astype(np.float32),
    }
    blind, seeing = made_up_samples(2, 1)
    (found,) = gather_moments(Drawing(), [blind, replace(seeing, **nobody)])
    np.testing.assert_allclose(found.driven[:, :2], seeing.ego_future_xyz[0, :, :2], atol=1e-6)
    assert contacts_of_plan(AHEAD, found.truth) == 0.0
