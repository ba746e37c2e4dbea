"""Checks of whether neighbouring cameras show the same where they look over the same ground, and at the same time."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from olt_toolkit.clips.verification.clip_evidence import ClipEvidence
from olt_toolkit.clips.verification.findings import Finding, Verdict, not_compared
from olt_toolkit.clips.verification.neighbour_views import NeighbourMatch, match_neighbours
from olt_toolkit.clips.verification.shared_view import LEAST_PAIRS, SHIFTS, surely_above
from olt_toolkit.rigs.rig import FRONT_TELE, REAR_TELE

NEIGHBOURS = "neighbours overlap"

# Cameras sit apart, so a view may fit a little better that far from its time, seconds; farther off it is a fault.
SAME_TIME = 0.2
# How much better another time or the mirrored view must fit, and how much worse for the pair to be as said.
MARGIN = 0.03
# Views of different clips correlate less than this, since patches are looked for near by, and no better than mirrored;
# but so may views that vehicles beside fill, as in a jam: nothing is said of vehicles that drive less, metres.
ABSENT, FLAT, LEAST_WAY = 0.39, 0.02, 20.0


def check_neighbours(clip: ClipEvidence) -> Iterator[Finding]:
    """Every pair of cameras that see something in common; tele cameras are held against the wide ones elsewhere."""
    wide = [camera for camera in clip.images if camera not in (FRONT_TELE, REAR_TELE)]
    pairs = list(combinations(wide, 2))
    matches = {pair: match_neighbours(*(clip.images[camera] for camera in pair)) for pair in pairs}
    found = {pair: match for pair, match in matches.items() if match is not None}
    if not found:
        yield not_compared(NEIGHBOURS, ", ".join(clip.images), "no two cameras see enough in common")
    for (first, second), match in found.items():
        yield _judge(match, _name_pair(first, second), clip.way)


def with_neighbours(clip: ClipEvidence, findings: Sequence[Finding]) -> ClipEvidence:
    """The clip with what its `check_neighbours` found."""
    agreeing = _find_cameras(clip, findings, Verdict.PASSED)
    return replace(clip, agreeing=agreeing, accused=_find_cameras(clip, findings, Verdict.FAILED) - agreeing)


def _find_cameras(clip: ClipEvidence, findings: Iterable[Finding], verdict: Verdict) -> frozenset[str]:
    """Cameras of some pair of which `check_neighbours` says so."""
    told = {each.where for each in findings if each.verdict is verdict}
    pairs = [pair for pair in combinations(clip.images, 2) if _name_pair(*pair) in told]
    return frozenset(camera for pair in pairs for camera in pair)


def _name_pair(first: str, second: str) -> str:
    return f"{first} and {second}"


def _judge(match: NeighbourMatch, where: str, way: float) -> Finding:
    shifts = np.array(SHIFTS)
    near = np.abs(shifts) <= SAME_TIME
    here = np.fmax(match.as_said, np.fmax.reduce(match.shifted[:, near], axis=1))
    known = np.isfinite(here) & np.isfinite(match.mirrored)
    if known.sum() < LEAST_PAIRS:
        why = "what both see is too dark or too even, or taken at different times"
        return not_compared(NEIGHBOURS, where, why)
    said, mirrored = float(here[known].mean()), float(match.mirrored[known].mean())
    rivals = {
        f"the second shows what the first shows {abs(shift):.1f} s {'later' if shift > 0 else 'earlier'}": column
        for shift, column in zip(SHIFTS, match.shifted.T, strict=True)
        if abs(shift) > SAME_TIME
    } | {"one of them is mirrored": match.mirrored}
    better = {
        says: float(np.nanmean(rival - here)) for says, rival in rivals.items() if surely_above(rival - here, MARGIN)
    }
    if better and way >= LEAST_WAY:
        says = max(better, key=lambda says: better[says])
        detail = f"{says}: it correlates {better[says]:.2f} more than as said; mend times or images of one of them"
        return Finding(NEIGHBOURS, where, Verdict.FAILED, detail, said, said + better[says])
    if said < ABSENT and said - mirrored < FLAT and way >= LEAST_WAY:
        detail = (
            f"where both look they correlate {said:.2f}, no better than mirrored ({mirrored:.2f}): one of the videos "
            "belongs to another clip or camera"
        )
        return Finding(NEIGHBOURS, where, Verdict.FAILED, detail, said, ABSENT)
    # As many tries for what is said as for what is not: the best of several times would often beat one mirrored view.
    # Where the longest shifts fit as well, a view may be of any time.
    wrong = [match.mirrored, *match.shifted[:, np.abs(shifts) == np.abs(shifts).max()].T]
    if said >= ABSENT and all(surely_above(match.as_said - rival, MARGIN) for rival in wrong):
        detail = f"where both look they correlate {said:.2f}, mirrored {mirrored:.2f}, and less at other times"
        return Finding(NEIGHBOURS, where, Verdict.PASSED, detail, said, mirrored)
    return not_compared(NEIGHBOURS, where, f"what both see is too near or too even: {said:.2f} as said")
