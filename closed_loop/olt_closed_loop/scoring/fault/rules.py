"""The rules of fault, in the order in which they are asked; the first that applies decides.

A rule that looks at lanes or lights answers nothing where the scene does not show them, and the next ones decide. What
cannot be told is at fault, and says so: a score must not hide what nobody can exclude.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from olt_closed_loop.scoring.fault.driver import time_to_stop
from olt_closed_loop.scoring.fault.encounter import Encounter
from olt_closed_loop.scoring.fault.lanes import entered_on_red

VULNERABLE = frozenset({"person", "rider", "bicycle", "bicyclist", "cyclist", "pedestrian", "stroller", "animal"})
"""Classes of road users without a body of steel around them."""
SAME_WAY, AGAINST = np.pi / 3.0, 2.0 * np.pi / 3.0
SIDE_BY_SIDE = np.pi / 6.0
AGENT_CLOSED = 0.25
"""Share of the ego in closing a gap up to which the agent closed it."""


@dataclass(frozen=True)
class Finding:
    """Whether the ego is at fault, by which rule, and why in words."""

    at_fault: bool
    rule: str
    reason: str


Rule = Callable[[Encounter], Finding | None]


def oncoming_lane(hit: Encounter) -> Finding | None:
    """Who is in the lane of those who come towards it is at fault, moving or not."""
    if hit.lane_owner == "agent" and hit.turn >= AGAINST:
        return Finding(True, "oncoming lane", "the contact lies in the lane of the oncoming agent")
    return None


def standing(hit: Encounter) -> Finding | None:
    """Who stands is hit, unless it stopped in front of who crosses, too late for that one to brake."""
    if not hit.ego_stands:
        return None
    crosses = SAME_WAY < hit.turn < AGAINST
    if crosses and hit.entered_us is not None and not hit.agent_could_avoid(hit.entered_us):
        return None
    return Finding(False, "standing", "the ego stood for two seconds")


def reversing(hit: Encounter) -> Finding | None:
    """Who drives backwards gives way to everybody behind."""
    if hit.side == "rear" and hit.ego_backs:
        return Finding(True, "reversing", "the ego drove backwards into the agent")
    return None


def lane_of_agent(hit: Encounter) -> Finding | None:
    """Who leaves its lane gives way to those whose lane it is."""
    if hit.lane_owner == "agent" and hit.side != "rear":
        return Finding(True, "lane of the agent", "the ego was over the marking, in the agent's lane")
    return None


def rear_ended(hit: Encounter) -> Finding | None:
    """Who follows keeps its distance, unless the ego came in front of it too late for that."""
    if hit.side != "rear" or hit.turn > SIDE_BY_SIDE:
        return None
    if hit.swerved == "agent" and not hit.ego_left_its_way:
        return Finding(False, "rear-ended", "the agent came over, and ran into the ego from behind")
    before = hit.seconds_before(hit.entered_us)
    if hit.entered_us is None or hit.lane_owner == "ego":
        return Finding(False, "rear-ended", "the agent ran into the ego, which was ahead of it, from behind")
    if hit.agent_could_avoid(hit.entered_us):
        return Finding(
            False, "rear-ended", f"the ego came into the agent's way {before:.1f} s before, in time to brake"
        )
    return Finding(True, "cut in", f"the ego came into the agent's way {before:.1f} s before, too late for it to brake")


def red_light(hit: Encounter) -> Finding | None:
    """A recorded light tells who may drive; who may trusts in it until the other is in the way."""
    if hit.site.lanes is None:
        return None
    if entered_on_red(hit.site.lanes, hit.ego, hit.contact_us):
        return Finding(True, "red light", "the ego entered its lane while the light was red")
    if entered_on_red(hit.site.lanes, hit.agent, hit.contact_us):
        return _against_the_agent(hit, "red light", "the agent entered its lane while the light was red")
    return None


def off_lanes(hit: Encounter) -> Finding | None:
    """Who drives where no lane is has nobody's way."""
    if hit.ego_off_lanes:
        return Finding(True, "off the lanes", "the ego had left the lanes")
    return None


def vulnerable(hit: Encounter) -> Finding | None:
    """A moving ego is at fault for a person, a cyclist or an animal, unless nobody could have avoided it or stood."""
    if hit.label not in VULNERABLE:
        return None
    before = hit.seconds_before(hit.foreseen_us)
    if hit.ego_could_avoid(hit.foreseen_us, or_stand=True):
        return Finding(True, "vulnerable", f"the {hit.label} showed {before:.1f} s before, in time to brake")
    return Finding(False, "unavoidable", f"the {hit.label} showed {before:.1f} s before, too late to brake")


def lane_of_ego(hit: Encounter) -> Finding | None:
    """Who comes into the ego's lane, drives against it, or backs up is in the wrong."""
    if hit.lane_owner == "ego":
        what = "came against the ego's lane" if hit.turn >= AGAINST else "was over the marking, in the ego's lane"
        return _against_the_agent(hit, "lane of the ego", f"the agent {what}")
    if hit.agent_backs and hit.side == "front" and hit.turn < SAME_WAY:
        return _against_the_agent(hit, "agent reversed", "the agent drove backwards into the ego")
    return None


def side_by_side(hit: Encounter) -> Finding | None:
    """Of two that drive beside each other, who moves over is in the wrong."""
    if hit.side != "lateral" or SIDE_BY_SIDE < hit.turn < np.pi - SIDE_BY_SIDE:
        return None
    share = hit.closing_share
    if hit.ego_left_its_way:
        return Finding(True, "moved over", "the ego left the recorded way")
    if share <= AGENT_CLOSED:
        return _against_the_agent(hit, "moved over", f"the agent closed {1.0 - share:.0%} of the gap between the two")
    return Finding(True, "moved over", f"the ego closed {share:.0%} of the gap between the two")


def avoidable(hit: Encounter) -> Finding | None:
    """Who sees it coming and can brake is at fault, whoever has the right of way."""
    if hit.ego_could_avoid(hit.foreseen_us):
        what = "the agent stood there" if hit.agent_stands else "it was to be seen coming"
        before = hit.seconds_before(hit.foreseen_us)
        return Finding(True, "avoidable", f"{what} {before:.1f} s before, in time to brake")
    return None


def came_too_late(hit: Encounter) -> Finding | None:
    """Who changes its course or speed, or comes into being, so late that no driver can stop is in the wrong."""
    before = hit.seconds_before(hit.on_course_us)
    if before < time_to_stop(hit.ego_speed):
        return Finding(False, "came too late", f"the agent's course led to the ego only {before:.1f} s before")
    return None


def cannot_be_excluded(hit: Encounter) -> Finding:
    """What nothing tells is at fault."""
    del hit
    return Finding(True, "cannot be excluded", "neither lanes, lights nor courses tell who was in the wrong")


RULES: tuple[Rule, ...] = (
    oncoming_lane,
    standing,
    reversing,
    lane_of_agent,
    rear_ended,
    red_light,
    off_lanes,
    vulnerable,
    lane_of_ego,
    side_by_side,
    avoidable,
    came_too_late,
    cannot_be_excluded,
)


def judge(hit: Encounter) -> Finding:
    """What the first rule that applies says."""
    return next(finding for rule in RULES if (finding := rule(hit)))


def _against_the_agent(hit: Encounter, rule: str, reason: str) -> Finding:
    """The agent is in the wrong; the ego is too where it saw it in its way in time to brake."""
    seen_us = hit.seen_in_the_way_us
    if hit.ego_could_avoid(seen_us):
        before = hit.seconds_before(seen_us)
        return Finding(True, "avoidable", f"{reason}, but was in the way {before:.1f} s before, in time to brake")
    return Finding(False, rule, reason)
