"""Rollouts that AlpaSim itself has scored: `alpasim` gives its values, `strict` what was expected."""

import json
from pathlib import Path

import pytest

from olt_closed_loop.rollouts.rollout_files import read_rollout_file
from olt_closed_loop.scoring.alpasim.scores import score_as_alpasim
from olt_closed_loop.scoring.definitions import score_record

# Metres or shares. Interpolation in single precision differs in the last bit: 8e-6 m at 100 m, 1.5e-5 m at 200 m.
TOLERANCES = {
    "dist_to_gt_location": 1e-5,
    "min_distance_to_lane_boundary_m": 1e-6,
    "progress_rel": 1e-6,
    "dist_traveled_m": 1e-7,
}
CLOSE = 1e-8


@pytest.fixture(scope="module")
def parity_folder(shared_real) -> Path:
    folder = shared_real.parent / "parity"
    if not folder.is_dir():
        pytest.skip("no scored rollouts beside the checkout")
    return folder


def expect_equal(ours, theirs):
    assert set(ours) == set(theirs)
    for name, value in theirs.items():
        if isinstance(value, float):
            assert ours[name] == pytest.approx(value, abs=TOLERANCES.get(name, CLOSE), rel=0.0), name
        else:
            assert ours[name] == value, name


def test_all_values_are_those_of_alpasim(parity_folder):
    expected = json.loads((parity_folder / "alpasim_values.json").read_text())
    assert len(expected) == 10
    for name, values in expected.items():
        ours = score_as_alpasim(read_rollout_file(parity_folder / f"{name}.json")).to_dict()
        for part in ("raw", "final", "scene"):
            expect_equal(ours[part], values[part])
        assert (ours["n_steps"], ours["n_steps_scored"]) == (values["n_steps"], values["n_steps_scored"])
        assert list(ours["missing"]) == values["missing"]


EXPECTED = {
    "drift_over_edge": (0.0, "offroad", ()),
    # The car behind is over the ego at its first sample.
    "front_and_rear_same_step_heading_west": (0.0, "collision_at_fault", ("front",)),
    "front_hit_parked": (0.0, "collision_at_fault", ("front",)),
    "half_speed": (0.625, None, ()),
    "log_follow": (1.0, None, ()),
    "plans_jitter_0.25m": (1.0, None, ()),
    "rear_ended": (1.0, None, ("rear",)),
    "rear_tap_then_front_crash": (0.0, "collision_at_fault", ("front",)),
    "right_lane_heading_west": (1.0, None, ()),
    "whole_drive_off_road": (0.0, "offroad", ()),
}


@pytest.mark.parametrize("name", EXPECTED)
def test_strict_is_what_a_careful_reader_expects(parity_folder, name):
    score = score_record(read_rollout_file(parity_folder / f"{name}.json"))
    value, reason, sides = EXPECTED[name]
    assert score.score == pytest.approx(value, abs=1e-9)
    assert (score.reason, tuple(collision.side for collision in score.collisions)) == (reason, sides)
    assert score.metrics["wrong_way"] is False
