"""A situation: an ego, agents and a road, and what is right to say of their contact."""

from dataclasses import dataclass, replace

import numpy as np

from olt_closed_loop.rollouts.rollout_record import EgoBox, LaneLines, RolloutRecord
from olt_closed_loop.situations.motions import STEP_US, Motion, sample_times

EGO = EgoBox(4.8, 1.9, 1.6, 1.4)
HANDOVER_US = 1_700_000
PARTNER = "partner"
"""The agent whose contact with the ego is judged."""


@dataclass(frozen=True)
class Situation:
    """A named situation.

    Attributes:
        name: what happens, in a few words.
        at_fault: whether the ego is at fault; None when there is no contact of the ego's.
        rule: the rule that says so, or why there is no contact.
        ego, partner: how the two move.
        label: class of the partner.
        others: further agents by name: class and motion.
        lanes: the road; () where there is no map.
        away: from when until when the partner was not recorded, s; None where it always was.
        why: why this is right where AlpaSim or nuPlan say something else.
    """

    name: str
    at_fault: bool | None
    rule: str
    ego: Motion
    partner: Motion
    label: str = "automobile"
    others: tuple[tuple[str, Motion], ...] = ()
    lanes: tuple[LaneLines, ...] = ()
    away: tuple[float, float] | None = None
    why: str = ""

    def record(self, step_us: int = STEP_US) -> RolloutRecord:
        """The situation as a rollout that drives as it was recorded, sampled every `step_us`, a multiple of 10 ms."""
        centers, times = self.ego.poses(step_us), sample_times(step_us)
        x, y, yaw = centers.T
        ahead = EGO.rear_axle_to_center
        rig = np.stack([x - ahead * np.cos(yaw), y - ahead * np.sin(yaw), np.zeros(len(x)), yaw], axis=-1)
        agents = [self.partner.agent(PARTNER, self.label, step_us)]
        if self.away:
            here = ~((agents[0].timestamps_us > self.away[0] * 1e6) & (agents[0].timestamps_us < self.away[1] * 1e6))
            agents = [replace(agents[0], timestamps_us=agents[0].timestamps_us[here], poses=agents[0].poses[here])]
        agents += [motion.agent(f"other {index}", label, step_us) for index, (label, motion) in enumerate(self.others)]
        edges = tuple(np.array([[-120.0, y, 0.0], [240.0, y, 0.0]]) for y in (-40.0, 40.0)) if self.lanes else ()
        return RolloutRecord(self.name, HANDOVER_US, times, rig, EGO, tuple(agents), times, rig, self.lanes, edges)
