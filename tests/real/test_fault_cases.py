"""Rollouts that were once scored wrong, with whose fault their contacts are."""

import pytest

from olt_closed_loop.rollouts.rollout_files import read_rollout_file
from olt_closed_loop.scoring.definitions import score_record

EXPECTED = {
    "headon_in_oncoming_lane_equal": (0.0, ["oncoming lane"]),
    "runs_red_light_hit_in_side": (0.0, ["avoidable"]),
    "creeps_009_into_person": (0.0, ["avoidable"]),
    "agent_appears_inside_ego": (1.0, []),
    "agent_gap_then_jump_through_ego": (1.0, []),
    "overshoot_past_recording_end": (1.0, []),
}


@pytest.mark.parametrize("name", EXPECTED)
def test_whose_fault_it_was(shared_real, name):
    path = shared_real.parent / "cases" / "rollouts" / f"{name}.json"
    if not path.is_file():
        pytest.skip("no cases of rollouts beside the checkout")
    score = score_record(read_rollout_file(path))
    assert (score.score, [hit.rule for hit in score.collisions]) == EXPECTED[name]
    assert all(hit.at_fault for hit in score.collisions)
    assert score.progress <= 1.0
