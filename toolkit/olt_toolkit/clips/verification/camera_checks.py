"""Checks of whether cameras show what their names promise: each its own side, and the tele view inside the front."""

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from scipy.optimize import linear_sum_assignment

from olt_generator.cameras import Mask
from olt_generator.poses import Array
from olt_toolkit.clips.verification.clip_evidence import ClipEvidence
from olt_toolkit.clips.verification.findings import Finding, Verdict, not_compared
from olt_toolkit.clips.verification.gains import average, sum_up
from olt_toolkit.clips.verification.image_evidence import Hypothesis
from olt_toolkit.clips.verification.ruled_out_shifts import judge_ruled_out
from olt_toolkit.clips.verification.shared_view import (
    LEAST_PAIRS,
    SHIFTS,
    TeleMatch,
    match_tele,
    nearest_images,
    surely_above,
)
from olt_toolkit.rigs.rig import FRONT_TELE, FRONT_WIDE

CAMERA_NAME = "camera shows what its name says"
OWN_VIDEO = "camera has a video of its own"
TELE_INSIDE = "tele inside front"
TELE_TIMES = "tele and front at one time"

# Nats a point, mean over the cameras that change places, by which other names must explain the images better, and by
# which the given ones must for others to be ruled out.
LEAST_GAIN, LEAST_LOSS = 0.3, 0.15
# Two cameras show the same if their images differ by less than this many grey levels.
SAME_DIFFERENCE = 1.0
# The tele image is inside the front view where it correlates so well and is not where it correlates less; between them
# nothing is said. Elsewhere, mirrored or at other times the correlation must be lower, or higher, by the margin.
INSIDE, OUTSIDE, MARGIN = 0.5, 0.35, 0.08
# Metres that the vehicle drives in a shift in time that is told: the cameras sit decimetres apart.
LEAST_SHIFT_WAY = 1.0


def check_names(clip: ClipEvidence) -> Iterator[Finding]:
    """No cameras that have changed names: which permutation of the videos explains the images best."""
    names = list(clip.evidence)
    if len(names) < 2:
        yield not_compared(CAMERA_NAME, names[0], "there is no other camera that it could be")
        return
    gains = {
        (name, other): clip.gains(name, Hypothesis(camera=clip.mounted[other]))
        for name in names
        for other in names
        if name != other
    }
    best = _best_names(names, gains)
    for name in names:
        if best[name] != name:
            gain = sum_up(gains[name, best[name]])
            detail = (
                f"it shows what {best[name]} should: with names exchanged the images are explained better by "
                f"{gain.mean:.2f} nats a point; give the videos their right names"
            )
            yield Finding(CAMERA_NAME, name, Verdict.FAILED, detail, gain.mean, LEAST_GAIN)
            continue
        exchanges = {
            other: sum_up(average([gains[name, other], gains[other, name]])) for other in names if other != name
        }
        untold = [other for other, gain in exchanges.items() if not gain.loses(LEAST_LOSS)]
        if untold:
            yield not_compared(CAMERA_NAME, name, f"nothing that moves tells it from {', '.join(untold)}")
        else:
            worst = max(gain.mean for gain in exchanges.values())
            yield Finding(CAMERA_NAME, name, Verdict.PASSED, "it moves as no other camera does", worst, LEAST_GAIN)


def check_own_videos(clip: ClipEvidence) -> Iterator[Finding]:
    """No two cameras with the same video."""
    for name, other in combinations(clip.images, 2):
        first, second = clip.images[name], clip.images[other]
        if first.grays.shape[1:] != second.grays.shape[1:]:
            continue
        partners = nearest_images(second.times_us, first.times_us)
        chosen = np.unique(np.linspace(0, len(first.grays) - 1, 5).round().astype(int))
        apart = np.abs(first.grays[chosen].astype(float) - second.grays[partners[chosen]]).mean(axis=(1, 2))
        contrast = float(first.grays[chosen].std(axis=(1, 2)).mean())
        where = f"{name} and {other}"
        if contrast < 4.0 * SAME_DIFFERENCE:
            yield not_compared(OWN_VIDEO, where, "their images are too dark or too even to tell")
        elif np.median(apart) < SAME_DIFFERENCE:
            detail = "they show the same images; one of the videos is missing, put it in its place"
            yield Finding(OWN_VIDEO, where, Verdict.FAILED, detail, float(np.median(apart)), SAME_DIFFERENCE)
        else:
            detail = "their images differ, grey levels"
            yield Finding(OWN_VIDEO, where, Verdict.PASSED, detail, float(np.median(apart)), SAME_DIFFERENCE)


def check_tele(clip: ClipEvidence) -> Iterator[Finding]:
    """The tele view inside the front view, and at the same time."""
    if not {FRONT_WIDE, FRONT_TELE} <= clip.images.keys():
        yield not_compared(TELE_INSIDE, FRONT_TELE, "the clip has not both front cameras")
        return
    match = match_tele(clip.images[FRONT_WIDE], clip.images[FRONT_TELE])
    known = np.isfinite(match.at_place)
    if known.sum() < LEAST_PAIRS:
        why = "the front views are too dark or too even, or taken at different times"
        yield not_compared(TELE_INSIDE, FRONT_TELE, why)
        return
    yield _judge_place(match, known)
    yield _judge_tele_times(match, clip.speed)


def _judge_place(match: TeleMatch, known: Mask) -> Finding:
    here = float(match.at_place[known].mean())
    rivals = {
        "the tele image is mirrored": match.mirrored[known],
        "the tele camera looks elsewhere than its calibration says": match.elsewhere[known],
    }
    for says, rival in rivals.items():
        if surely_above(rival - match.at_place[known], MARGIN) and rival.mean() > OUTSIDE:
            detail = f"{says}, or the images are mirrored: it correlates {rival.mean():.2f} so and {here:.2f} as said"
            return Finding(TELE_INSIDE, FRONT_TELE, Verdict.FAILED, detail, here, INSIDE)
    if here < OUTSIDE:
        detail = (
            f"it correlates only {here:.2f} with the part of the front view that it should show: the videos belong to "
            "different clips, cameras or times, or the calibration to another rig"
        )
        return Finding(TELE_INSIDE, FRONT_TELE, Verdict.FAILED, detail, here, OUTSIDE)
    best = max(float(rival.mean()) for rival in rivals.values())
    if here < INSIDE or here - best < MARGIN:
        return not_compared(TELE_INSIDE, FRONT_TELE, f"it correlates {here:.2f}, and {best:.2f} where it should not")
    detail = f"it correlates {here:.2f} where it should, and {best:.2f} elsewhere or mirrored"
    return Finding(TELE_INSIDE, FRONT_TELE, Verdict.PASSED, detail, here, INSIDE)


def _judge_tele_times(match: TeleMatch, speed: float) -> Finding:
    gains = match.shifted - match.at_place[:, None]
    gains[:, speed * np.abs(SHIFTS) < LEAST_SHIFT_WAY] = np.nan
    means = np.array([np.nanmean(column) if np.isfinite(column).any() else -np.inf for column in gains.T])
    best = int(np.argmax(means))
    if surely_above(gains[:, best], 0.02):
        when = f"{abs(SHIFTS[best]):.1f} s {'later' if SHIFTS[best] > 0.0 else 'earlier'}"
        detail = f"the tele view shows what the front view shows {when}; correct the times of one of them"
        return Finding(TELE_TIMES, FRONT_TELE, Verdict.FAILED, detail, float(means[best]), 0.02)
    told = [abs(shift) for shift, column in zip(SHIFTS, gains.T, strict=True) if surely_above(-column, 0.02)]
    ruled_out = {abs(shift): told.count(abs(shift)) == 2 for shift in SHIFTS}
    otherwise = "the front views hardly change with time, or do not match"
    return judge_ruled_out(TELE_TIMES, FRONT_TELE, ruled_out, "the tele images were taken", otherwise)


def _best_names(names: list[str], gains: dict[tuple[str, str], Array]) -> dict[str, str]:
    """Whose images each camera shows, if those of others explain them clearly better; else its own."""
    table = np.zeros((len(names), len(names)))
    for (name, other), found in gains.items():
        table[names.index(name), names.index(other)] = np.nanmean(found[:, 0]) if np.isfinite(found[:, 0]).any() else 0
    order = linear_sum_assignment(table, maximize=True)[1].tolist()
    as_said = {name: name for name in names}
    changed = [name for name, place in zip(names, order, strict=True) if names[place] != name]
    if not changed:
        return as_said
    best = {name: names[place] for name, place in zip(names, order, strict=True)}
    together = sum_up(average([gains[name, best[name]] for name in changed]))
    return best if together.wins(LEAST_GAIN) else as_said
