"""All situations, and what this project, AlpaSim and nuPlan say of each."""

from dataclasses import dataclass

from olt_closed_loop.rollouts.rollout_record import RolloutRecord
from olt_closed_loop.scoring.alpasim.scores import score_as_alpasim
from olt_closed_loop.scoring.collisions import Collision, find_collisions, site_of
from olt_closed_loop.scoring.moving_boxes import agent_box, ego_box, stretches
from olt_closed_loop.situations.crossing import CROSSINGS, MERGING
from olt_closed_loop.situations.following import FOLLOWING, REVERSING, STANDING
from olt_closed_loop.situations.nuplan import classify_contact
from olt_closed_loop.situations.oncoming import ONCOMING, PARKED
from olt_closed_loop.situations.situation import PARTNER, Situation
from olt_closed_loop.situations.vulnerable import VULNERABLE

SITUATIONS: tuple[Situation, ...] = (
    *STANDING,
    *FOLLOWING,
    *REVERSING,
    *ONCOMING,
    *PARKED,
    *CROSSINGS,
    *MERGING,
    *VULNERABLE,
)


@dataclass(frozen=True)
class Row:
    """What is said of a situation.

    Attributes:
        situation: its name.
        expected: whether the ego is at fault, as the situation has it; None: no contact of the ego's.
        at_fault, rule, reason: what the rules of fault say; None where there is no contact of the ego's.
        side: of the ego.
        time_us: when.
        alpasim: whether AlpaSim has a collision at fault; None: no collision.
        nuplan: nuPlan's class of the contact; None: no contact.
        nuplan_at_fault: whether that class is at fault.
        why: why ours holds where the others differ.
    """

    situation: str
    expected: bool | None
    at_fault: bool | None
    rule: str
    reason: str
    side: str | None
    time_us: int | None
    alpasim: bool | None
    nuplan: str | None
    nuplan_at_fault: bool | None
    why: str

    @property
    def right(self) -> bool:
        """Whether the rules say what is right."""
        return self.at_fault == self.expected


def contact_of(record: RolloutRecord) -> Collision | None:
    """The contact of the ego with the partner of a situation; None without one."""
    ego, agents = ego_box(record), tuple(stretches(record.agents))
    boxes = [agent_box(agent) for agent in agents]
    span = (record.handover_us, int(record.timestamps_us[-1]))
    found = find_collisions(ego, agents, boxes, *span, site=site_of(record, None))
    return next((hit for hit in found.collisions if hit.agent_id == PARTNER), None)


def judge_situation(situation: Situation) -> Row:
    """The row of a situation."""
    record = situation.record()
    hit = contact_of(record)
    alpasim = score_as_alpasim(record).final
    touched = bool(alpasim["collision_any"])
    nuplan = classify_contact(record, PARTNER)
    return Row(
        situation=situation.name,
        expected=situation.at_fault,
        at_fault=hit.at_fault if hit else None,
        rule=hit.rule if hit else situation.rule,
        reason=hit.reason if hit else "no contact of the ego's",
        side=hit.side if hit else None,
        time_us=hit.time_us if hit else None,
        alpasim=bool(alpasim["collision_at_fault"]) if touched else None,
        nuplan=nuplan[0] if nuplan else None,
        nuplan_at_fault=nuplan[1] if nuplan else None,
        why=situation.why,
    )


def judge_all() -> tuple[Row, ...]:
    """The rows of all situations."""
    return tuple(judge_situation(situation) for situation in SITUATIONS)
