"""Checks of what the images show of the motion against the motion that the clip says, and of their times and order."""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from olt_toolkit.clips.verification.clip_evidence import ClipEvidence
from olt_toolkit.clips.verification.findings import Finding, Verdict, not_compared
from olt_toolkit.clips.verification.frame_order import find_order
from olt_toolkit.clips.verification.gains import Gain
from olt_toolkit.clips.verification.hypotheses import (
    FRAMES_REVERSED,
    IMAGES_MIRRORED,
    MOTION_MIRRORED,
    TURNS_INVERTED,
    at_rate,
    motion_reversed,
    scaled,
    shifted,
)
from olt_toolkit.clips.verification.image_evidence import Hypothesis
from olt_toolkit.clips.verification.ruled_out_shifts import judge_ruled_out

FRAME_ORDER = "frame order"
FRAME_TIMES = "frame times"
MIRRORED = "mirrored images"
MOTION = "motion in images"
MOTION_OF_CLIP = "motion of this clip"
MOTION_SIDES = "left and right of the motion"
MOTION_SCALE = "scale of the motion"
MOTION_TIMES = "times of the motion"
THIS_CLIP = "video of this clip"

MAY_BE_FILLED = "its view is narrow: a vehicle ahead may fill it, which moves with its own"
MOVES_LITTLE = "what is seen does not move enough to tell"

# Nats a point by which a fault must explain the images better: where it changes directions, where it changes only how
# far things move (what is known of distances tells that), where it shifts by little, and where any motion is tried.
LEAST_GAIN, LEAST_SCALE_GAIN, LEAST_SHIFT_GAIN, LEAST_FREE_GAIN = 0.25, 0.3, 0.02, 1.2
# The same for the rate of one camera, whose view traffic that moves along may fill.
LEAST_RATE_GAIN = 0.5
# Vehicles that overtake fill a camera with what moves otherwise, but for some of the road: one camera is held at fault
# by its motion alone where at most this share of the points that speak moves as the clip says.
MOST_DEFENDED_ALONE = 0.05
# Nats a point by which what the clip says must explain them better for the fault to be ruled out.
LEAST_LOSS = 0.1
# Nats in all from which on a shift in time is believed, which shows only while the motion changes.
CLEAR_SHIFT = 25.0
SHIFTS = (0.1, 0.2, 0.3, 0.5, 0.7, 1.0)
RATES = (1 / 3, 0.5, 2.0, 3.0)
SCALES = (0.001, 0.01, 0.1, 0.3048, 0.5, 2.0, 3.28, 10.0, 100.0, 1000.0)
# Where the most similar image of fewer than this share is a neighbour, images are shuffled: chance gives a sixth. Where
# it is one for fewer than the second share, what is seen moves too far to tell.
SHUFFLED, LEAST_NEAREST = 0.35, 0.7
# Below this difference of neighbours, grey levels, a picture shows too little to tell a repeated one.
LEAST_DIFFERENCE = 0.3
# Below this difference images do not change at all, if they have at least this contrast, grey levels.
STILL, LEAST_CONTRAST = 0.05, 5.0
# From this share on images that have changed places or repeat the one before are a fault; a single vehicle that passes
# close by can make one seem to.
MOST_EXCHANGED, MOST_REPEATED = 0.03, 0.02
LEAST_WAY = 5.0


def check_frame_order(clip: ClipEvidence, camera: str) -> Finding:
    """None repeated, none out of its place, and time running forward."""
    order = find_order(clip.images[camera], clip.ego_motion)
    count = int(order.moving.sum())
    if count < 8:
        return not_compared(FRAME_ORDER, camera, _why_still(clip) or MOVES_LITTLE)
    if order.difference < STILL and order.contrast > LEAST_CONTRAST:
        detail = "the images do not change although the vehicle moves; the video is frozen, take it again"
        return Finding(FRAME_ORDER, camera, Verdict.FAILED, detail, order.difference, STILL)
    if order.difference < LEAST_DIFFERENCE:
        return not_compared(FRAME_ORDER, camera, "the images show too little that changes from one to the next")
    if order.nearest < SHUFFLED and order.repeated.sum() < MOST_REPEATED * count:
        detail = f"only {order.nearest:.0%} of the images resemble a neighbour most; they are shuffled, take them again"
        return Finding(FRAME_ORDER, camera, Verdict.FAILED, detail, order.nearest, SHUFFLED)
    # What is invented or seen at other times flickers from image to image: that is no order.
    exchanged = order.exchanged if clip.images[camera].seen is None else np.zeros_like(order.exchanged)
    shares = exchanged.sum() / count, order.repeated.sum() / count
    for share, most, flags, says in (
        (shares[0], MOST_EXCHANGED, exchanged, "lie before the one that they follow"),
        (shares[1], MOST_REPEATED, order.repeated, "are repeated although the vehicle moves"),
    ):
        if share > most:
            seconds = clip.images[camera].times_us[int(np.argmax(flags))] * 1e-6
            detail = f"{share:.0%} of the images {says}, the first at {seconds:.2f} s; encode the video again"
            return Finding(FRAME_ORDER, camera, Verdict.FAILED, detail, float(share), most)
    gain = clip.gain(camera, FRAMES_REVERSED)
    if gain.wins(LEAST_GAIN):
        return _blame(clip, FRAME_ORDER, camera, "its frames run backward in time", gain, LEAST_GAIN)
    if gain.loses(LEAST_LOSS) and order.nearest > LEAST_NEAREST:
        return _passed(FRAME_ORDER, camera, "no image is repeated or out of place, and time runs forward", gain)
    return not_compared(FRAME_ORDER, camera, "nothing tells the order of its images, or whether time runs forward")


def check_mirrored(clip: ClipEvidence, camera: str) -> Finding:
    """Left and right not exchanged."""
    gain = clip.gain(camera, IMAGES_MIRRORED)
    if gain.wins(LEAST_GAIN):
        return _blame(clip, MIRRORED, camera, "its images are mirrored left to right", gain, LEAST_GAIN)
    if gain.loses(LEAST_LOSS):
        return _passed(MIRRORED, camera, "left and right are where the motion says", gain)
    why = "a straight drive looks the same in the mirror of a camera that looks ahead or back"
    return not_compared(MIRRORED, camera, _why_still(clip) or why)


def check_frame_times(clip: ClipEvidence, camera: str) -> Finding:
    """The camera neither early nor late nor at another rate than the motion."""
    if camera not in clip.wide:
        return not_compared(FRAME_TIMES, camera, MAY_BE_FILLED)
    rates = {rate: clip.gain(camera, at_rate(rate)) for rate in RATES}
    found = {rate: gain for rate, gain in rates.items() if gain.wins(LEAST_RATE_GAIN)}
    if found:
        rate = max(found, key=lambda rate: found[rate].evidence)
        says = f"time passes {rate:.2g} times as fast as it says"
        return _blame(clip, FRAME_TIMES, camera, says, found[rate], LEAST_RATE_GAIN)
    return _judge_shifts(FRAME_TIMES, camera, partial(clip.gain, camera), partial(_accuse, clip), _why_still(clip))


def check_motion(clip: ClipEvidence) -> Iterator[Finding]:
    """The motion that the clip says, in the direction, handedness, unit and time of its images."""
    where = f"ego motion against {', '.join(clip.wide) or 'no camera'}"
    for check, look in (
        (MOTION, _check_direction),
        (MOTION_OF_CLIP, _check_whose),
        (MOTION_SIDES, _check_sides),
        (MOTION_SCALE, _check_scale),
        (MOTION_TIMES, _check_times),
    ):
        yield look(clip, where) if clip.wide else not_compared(check, where, MAY_BE_FILLED)


def _check_direction(clip: ClipEvidence, where: str) -> Finding:
    faults = {
        "the vehicle drives the other way": scaled(-1.0),
        "the motion runs backward in time": motion_reversed(clip.ego_motion.span_us),
    }
    gains = {says: clip.joint_gain(hypothesis) for says, hypothesis in faults.items()}
    found = {says: gain for says, gain in gains.items() if gain.wins(LEAST_GAIN)}
    if found:
        says = max(found, key=lambda says: found[says].evidence)
        return _failed(MOTION, where, says, found[says], LEAST_GAIN)
    if all(gain.loses(LEAST_LOSS) for gain in gains.values()):
        says = "the images move neither the other way nor as if the motion ran backward in time"
        return _passed(MOTION, where, says, max(gains.values(), key=_mean))
    return not_compared(MOTION, where, _why_still(clip) or MOVES_LITTLE)


def _check_whose(clip: ClipEvidence, where: str) -> Finding:
    gains = {name: clip.joint_gain(motion) for name, motion in clip.other_motions.items()}
    found = {name: gain for name, gain in gains.items() if gain.wins(LEAST_GAIN)}
    if found:
        name = max(found, key=lambda name: found[name].evidence)
        says = f"it is the motion of clip {name} that the images show"
        return _failed(MOTION_OF_CLIP, where, says, found[name], LEAST_GAIN)
    if clip.way >= LEAST_WAY and (free := clip.joint_free_gain()).wins(LEAST_FREE_GAIN):
        says = "another motion explains them in every part of the clip: it is another clip's"
        return _failed(MOTION_OF_CLIP, where, says, free, LEAST_FREE_GAIN)
    return _judge_others(MOTION_OF_CLIP, where, gains, _why_still(clip))


def _check_sides(clip: ClipEvidence, where: str) -> Finding:
    gains = {
        "the motion is mirrored left to right": clip.joint_gain(MOTION_MIRRORED),
        "its turns have the wrong sign": clip.joint_gain(TURNS_INVERTED),
    }
    found = [(says, gain, LEAST_GAIN) for says, gain in gains.items() if gain.wins(LEAST_GAIN)]
    if found:
        return _failed(MOTION_SIDES, where, *max(found, key=lambda each: each[1].evidence))
    if all(gain.loses(LEAST_LOSS) for gain in gains.values()):
        return _passed(MOTION_SIDES, where, "it turns to the side that the images show", max(gains.values(), key=_mean))
    return not_compared(MOTION_SIDES, where, _why_still(clip) or "the drive is too straight to tell left from right")


def _check_scale(clip: ClipEvidence, where: str) -> Finding:
    gains = {scale: clip.joint_gain(scaled(scale)) for scale in SCALES}
    found = {scale: gain for scale, gain in gains.items() if gain.wins(LEAST_SCALE_GAIN)}
    if found:
        scale = max(found, key=lambda scale: found[scale].evidence)
        says = f"the vehicle drives about {scale:.4g} times as far as it says"
        return _failed(MOTION_SCALE, where, says, found[scale], LEAST_SCALE_GAIN)
    smaller = [scale for scale in SCALES if scale < 1.0 and gains[scale].loses(LEAST_LOSS)]
    larger = [scale for scale in SCALES if scale > 1.0 and gains[scale].loses(LEAST_LOSS)]
    if not (smaller and larger):
        why = "too little of the road is seen to tell how far"
        return not_compared(MOTION_SCALE, where, _why_still(clip) or why)
    low, high = max(smaller), min(larger)
    if (low, high) != (0.5, 2.0):
        why = f"what is seen tells only that it does not drive {low:.4g} times as far as it says, nor {high:.4g} times"
        return not_compared(MOTION_SCALE, where, why)
    says = "it drives neither half as far as it says nor twice as far"
    return _passed(MOTION_SCALE, where, says, max((gains[low], gains[high]), key=_mean))


def _check_times(clip: ClipEvidence, where: str) -> Finding:
    return _judge_shifts(MOTION_TIMES, where, clip.joint_gain, _failed, _why_still(clip))


def check_this_clip(clip: ClipEvidence, camera: str) -> Finding:
    """The images of one camera show the motion of their clip, and not that of another one of the store."""
    if camera not in clip.wide:
        return not_compared(THIS_CLIP, camera, MAY_BE_FILLED)
    gains = {name: clip.gain(camera, motion) for name, motion in clip.other_motions.items()}
    found = {name: gain for name, gain in gains.items() if gain.wins(LEAST_GAIN)}
    if found:
        name = max(found, key=lambda name: found[name].evidence)
        return _blame(clip, THIS_CLIP, camera, f"the images show the motion of clip {name}", found[name], LEAST_GAIN)
    return _judge_others(THIS_CLIP, camera, gains, _why_still(clip))


def _judge_others(check: str, where: str, gains: dict[str, Gain], why: str | None) -> Finding:
    """Whether the motions of all other clips, by name, of which none fits better, fit worse."""
    if not gains:
        return not_compared(check, where, "the store holds no other clip")
    as_well = [name for name, gain in gains.items() if not gain.loses(LEAST_LOSS)]
    if as_well:
        fits = f"what is seen fits the motions of {len(as_well)} of {len(gains)} other clips as well, as {as_well[0]}"
        return not_compared(check, where, why or fits)
    worst = max(gains.values(), key=_mean)
    return _passed(check, where, f"its motion fits better than those of {len(gains)} other clips", worst)


def _judge_shifts(
    check: str,
    where: str,
    gain_of: Callable[[Hypothesis], Gain],
    fail: Callable[[str, str, str, Gain, float], Finding],
    why: str | None,
) -> Finding:
    """Whether images that were taken earlier or later than the clip says fit its motion better."""
    gains = {
        (seconds, word): gain_of(shifted(sign * seconds))
        for seconds in SHIFTS
        for sign, word in ((1.0, "later"), (-1.0, "earlier"))
    }
    found = {shift: gain for shift, gain in gains.items() if gain.wins(LEAST_SHIFT_GAIN, CLEAR_SHIFT)}
    if found:
        seconds, word = max(found, key=lambda shift: found[shift].evidence)
        says = f"the images were taken {seconds:.1f} s {word} than the motion says"
        return fail(check, where, says, found[seconds, word], LEAST_SHIFT_GAIN)
    ruled_out = {seconds: all(gains[seconds, word].loses(0.0) for word in ("later", "earlier")) for seconds in SHIFTS}
    otherwise = why or "the drive is too even for a shift in time to show"
    return judge_ruled_out(check, where, ruled_out, "the images were taken", otherwise)


def _mean(gain: Gain) -> float:
    return gain.mean


def _why_still(clip: ClipEvidence) -> str | None:
    """Why the images tell nothing of the motion, where the whole clip says why."""
    if clip.way < LEAST_WAY:
        return f"the vehicle stands: it drives {clip.way:.1f} m"
    points = sum(len(evidence.steps.step) for evidence in clip.evidence.values())
    if points < 15 * sum(len(evidence.steps.first) for evidence in clip.evidence.values()):
        return "too few points can be followed: the images are dark, show no texture, or lie too far apart in time"
    return None


def _blame(clip: ClipEvidence, check: str, camera: str, says: str, gain: Gain, limit: float) -> Finding:
    """One camera fails, unless it shows what those beside it show: then it is traffic that moves so."""
    if camera not in clip.agreeing:
        return _accuse(clip, check, camera, says, gain, limit)
    why = f"it moves as if {says}, but shows what a camera beside it shows: vehicles that overtake fill it"
    return not_compared(check, camera, why)


def _accuse(clip: ClipEvidence, check: str, camera: str, says: str, gain: Gain, limit: float) -> Finding:
    """One camera fails where another one tells that, too, or next to nothing in it moves as the clip says."""
    if camera in clip.accused or not gain.against > MOST_DEFENDED_ALONE:
        return _failed(check, camera, says, gain, limit)
    why = f"it moves as if {says}, but {gain.against:.0%} of it as the clip says: vehicles that overtake may fill it"
    return not_compared(check, camera, why)


def _failed(check: str, where: str, says: str, gain: Gain, limit: float) -> Finding:
    detail = f"{says}: this explains the images better by {gain.mean:.2f} nats a point; mend it or leave the clip out"
    return Finding(check, where, Verdict.FAILED, detail, gain.mean, limit)


def _passed(check: str, where: str, says: str, gain: Gain) -> Finding:
    return Finding(check, where, Verdict.PASSED, says, gain.mean)
