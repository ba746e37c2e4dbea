"""Rows of scenes that nobody drove, because they could not be read or failed the gate: no drive and no score."""

import numpy as np

from olt_closed_loop.evaluation.gate import GateResult
from olt_closed_loop.rollouts.rollout import Incidents, Rollout
from olt_closed_loop.scoring.definitions import RolloutScore
from olt_closed_loop.simulation.settings import SimulationSettings
from olt_closed_loop.vehicle.state import STATE_SIZE
from olt_toolkit.policy.contract import FUTURE_STEPS


def refused_result(
    gate: GateResult, category: str, policy: str, seed: int, settings: SimulationSettings
) -> tuple[Rollout, RolloutScore]:
    """An empty rollout and a row that is not valid, both with the reason of the refusal."""
    rollout = Rollout(
        scene=gate.scene,
        category=category,
        policy=policy,
        seed=seed,
        handover_us=settings.warm_up_us,
        timestamps_us=np.zeros(0, dtype=np.int64),
        states=np.zeros((0, STATE_SIZE)),
        heights=np.zeros(0),
        controls=np.zeros((0, 2)),
        plan_times_us=np.zeros(0, dtype=np.int64),
        plans=np.zeros((0, FUTURE_STEPS + 1, 3)),
        failure=gate.why_not,
        traffic=settings.traffic,
    )
    counted = vars(Incidents()).copy()
    score = RolloutScore(
        gate.scene, category, policy, seed, gate.definition, reason=gate.why_not, rollout_incidents=counted
    )
    return rollout, score
