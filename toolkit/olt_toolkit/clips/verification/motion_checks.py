"""Checks of what the images show of the motion against the motion that the clip says, and of their times and order."""


import numpy as np

from olt_toolkit.clips.verification.clip_evidence import ClipEvidence
from olt_toolkit.clips.verification.findings import Finding, Verdict
from olt_toolkit.clips.verification.frame_order import find_order
from olt_toolkit.clips.verification.gains import Gain, over_cameras, sum_up
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

FRAME_ORDER = "frame order"
FRAME_TIMES = "frame times"
MIRRORED = "mirrored images"
MOTION = "motion in images"
THIS_CLIP = "video of this clip"

# Nats a point by which a fault must explain the images better: where it changes directions, where it changes only how
# far things move (what is known of distances tells that), where it shifts by little, and where any motion is tried.
LEAST_GAIN, LEAST_SCALE_GAIN, LEAST_SHIFT_GAIN, LEAST_FREE_GAIN = 0.25, 0.3, 0.02, 0.6
# Nats a point by which what the clip says must explain them better for the fault to be ruled out.
LEAST_LOSS = 0.1
SHIFTS = tuple(round(sign * 0.1 * count, 1) for count in range(1, 11) for sign in (-1.0, 1.0))
RATES = (1 / 3, 0.5, 2.0, 3.0)
SCALES = (0.001, 0.01, 0.1, 0.3048, 0.5, 2.0, 3.28, 10.0, 100.0, 1000.0)
# Where the most similar image of fewer than this share is a neighbour, images are shuffled; chance gives a sixth.
LEAST_NEAREST = 0.6
# Below this difference of neighbours, grey levels, a picture shows too little to tell a repeated one.
LEAST_DIFFERENCE = 0.6
# From this share on images that have changed places or repeat the one before are a fault.
MOST_EXCHANGED, MOST_REPEATED = 0.02, 0.02
LEAST_WAY = 5.0


def check_frame_order(clip: ClipEvidence, camera: str) -> Finding:
    """None repeated, none out of its place, and time running forward."""
    order = find_order(clip.images[camera], clip.ego_motion)
    count = int(order.moving.sum())
    if count < 8:
        return _not_compared(FRAME_ORDER, camera, _why_still(clip))
    if order.nearest < LEAST_NEAREST:
        detail = f"only {order.nearest:.0%} of the images resemble a neighbour most; they are shuffled, take them again"
        return Finding(FRAME_ORDER, camera, Verdict.FAILED, detail, order.nearest, LEAST_NEAREST)
    if order.difference < LEAST_DIFFERENCE:
        return _not_compared(FRAME_ORDER, camera, "the images show too little that changes from one to the next")
    shares = order.exchanged.sum() / count, order.repeated.sum() / count
    for share, most, flags, says in (
        (shares[0], MOST_EXCHANGED, order.exchanged, "lie before the one that they follow"),
        (shares[1], MOST_REPEATED, order.repeated, "are repeated although the vehicle moves"),
    ):
        if share > most:
            seconds = clip.images[camera].times_us[int(np.argmax(flags))] * 1e-6
            detail = f"{share:.0%} of the images {says}, the first at {seconds:.2f} s; encode the video again"
            return Finding(FRAME_ORDER, camera, Verdict.FAILED, detail, float(share), most)
    gain = clip.gain(camera, FRAMES_REVERSED)
    if gain.wins(LEAST_GAIN):
        return _failed(FRAME_ORDER, camera, "its frames run backward in time", gain, LEAST_GAIN)
    if gain.loses(LEAST_LOSS):
        return _passed(FRAME_ORDER, camera, "no image is repeated or out of place, and time runs forward", gain)
    return _not_compared(FRAME_ORDER, camera, "in order, but nothing tells whether time runs forward or backward")


def check_mirrored(clip: ClipEvidence, camera: str) -> Finding:
    """Left and right not exchanged."""
    gain = clip.gain(camera, IMAGES_MIRRORED)
    if gain.wins(LEAST_GAIN):
        return _failed(MIRRORED, camera, "its images are mirrored left to right", gain, LEAST_GAIN)
    if gain.loses(LEAST_LOSS):
        return _passed(MIRRORED, camera, "left and right are where the motion says", gain)
    why = "nothing tells left from right in a camera that looks where a straight drive leads"
    return _not_compared(MIRRORED, camera, why if clip.way >= LEAST_WAY else _why_still(clip))


def check_frame_times(clip: ClipEvidence, camera: str) -> Finding:
    """The camera neither early nor late nor at another rate than the motion."""
    rates = {f"time passes {rate:.2g} times as fast as it says": (at_rate(rate), LEAST_SCALE_GAIN) for rate in RATES}
    shifts = {
        f"it is {abs(shift):.1f} s {'late' if shift > 0.0 else 'early'}": (shifted(shift), LEAST_SHIFT_GAIN)
        for shift in SHIFTS
    }
    gains = {says: clip.gain(camera, hypothesis) for says, (hypothesis, _) in (rates | shifts).items()}
    winners = {says: gain for says, gain in gains.items() if gain.wins((rates | shifts)[says][1])}
    if winners:
        says = max(winners, key=lambda says: winners[says].evidence)
        return _failed(FRAME_TIMES, camera, says, winners[says], (rates | shifts)[says][1])
    excluded = [abs(shift) for shift in SHIFTS if _both_lose(clip, camera, gains, abs(shift))]
    if excluded:
        detail = f"it is neither early nor late by {min(excluded):.1f} s or more"
        worst = max((gains[says] for says in shifts), key=lambda gain: gain.mean)
        return _passed(FRAME_TIMES, camera, detail, worst)
    why = "the vehicle drives too evenly for a shift in time to show"
    return _not_compared(FRAME_TIMES, camera, why if clip.way >= LEAST_WAY else _why_still(clip))


def check_motion(clip: ClipEvidence) -> Finding:
    """The motion that the clip says, in the frame, unit, handedness and time of its images."""
    names = "all cameras" if len(clip.evidence) > 1 else next(iter(clip.evidence))
    where = f"ego motion, {names}"
    faults = _motion_faults(clip)
    gains = {says: clip.joint_gain(hypothesis) for says, (hypothesis, _) in faults.items()}
    winners = {says: gain for says, gain in gains.items() if gain.wins(faults[says][1])}
    if winners:
        says = max(winners, key=lambda says: winners[says].evidence)
        return _failed(MOTION, where, says, winners[says], faults[says][1])
    free = sum_up(over_cameras([clip.free_gains(camera) for camera in clip.evidence]))
    if free.wins(LEAST_FREE_GAIN):
        says = "another motion explains them in every part of the clip: it belongs to another clip, or they do"
        return _failed(MOTION, where, says, free, LEAST_FREE_GAIN)
    ruled_out = [says for says, gain in gains.items() if gain.loses(LEAST_LOSS)]
    if "the motion runs backward in time" in ruled_out or "the vehicle drives the other way" in ruled_out:
        untold = [says for says in ("the motion is mirrored left to right",) if says not in ruled_out]
        note = "; not told: whether " + ", ".join(untold) if untold else ""
        return _passed(MOTION, where, f"the images move as the motion says{note}", gains["the vehicle drives the other way"])
    return _not_compared(MOTION, where, _why_still(clip))


def check_this_clip(clip: ClipEvidence, camera: str) -> Finding:
    """The images of one camera show the motion of the clip and no other."""
    free = sum_up(clip.free_gains(camera))
    if free.wins(LEAST_FREE_GAIN) and _is_steady(free):
        says = "another motion explains them in every part of the clip: the video belongs to another one"
        return _failed(THIS_CLIP, camera, says, free, LEAST_FREE_GAIN)
    if clip.gain(camera, scaled(0.0)).loses(LEAST_LOSS) and clip.gain(camera, scaled(-1.0)).loses(LEAST_LOSS):
        return _passed(THIS_CLIP, camera, "they show the motion of the clip, as far as motion tells clips apart", free)
    return _not_compared(THIS_CLIP, camera, _why_still(clip))


def _is_steady(gain: Gain) -> bool:
    return gain.agreement > 0.95


def _motion_faults(clip: ClipEvidence) -> dict[str, tuple[Hypothesis, float]]:
    """The faults of a motion that are tried, in words, and the gain from which on each is believed."""
    faults = {
        "the motion is mirrored left to right": (MOTION_MIRRORED, LEAST_GAIN),
        "its turns have the wrong sign": (TURNS_INVERTED, LEAST_GAIN),
        "the vehicle drives the other way": (scaled(-1.0), LEAST_GAIN),
        "the motion runs backward in time": (motion_reversed(clip.ego_motion.span_us), LEAST_GAIN),
    }
    for scale in SCALES:
        faults[f"the vehicle drives {scale:.4g} times as far as it says"] = (scaled(scale), LEAST_SCALE_GAIN)
    for shift in SHIFTS:
        says = f"the images are {abs(shift):.1f} s {'late' if shift > 0.0 else 'early'} against the motion"
        faults[says] = (shifted(shift), LEAST_SHIFT_GAIN)
    return faults


def _both_lose(clip: ClipEvidence, camera: str, gains: dict[str, Gain], seconds: float) -> bool:
    return all(gains[f"it is {seconds:.1f} s {word}"].loses(0.0) for word in ("late", "early"))


def _why_still(clip: ClipEvidence) -> str:
    if clip.way < LEAST_WAY:
        return f"the vehicle stands: it drives {clip.way:.1f} m"
    points = sum(len(evidence.steps.step) for evidence in clip.evidence.values())
    if points < 15 * sum(len(evidence.steps.first) for evidence in clip.evidence.values()):
        return "too few points can be followed: the images are dark, show no texture, or lie too far apart in time"
    return "what is seen does not move enough to tell"


def _failed(check: str, where: str, says: str, gain: Gain, limit: float) -> Finding:
    detail = f"{says}: that explains the images better by {gain.mean:.2f} nats a point; correct it or leave the clip out"
    return Finding(check, where, Verdict.FAILED, detail, gain.mean, limit)


def _passed(check: str, where: str, says: str, gain: Gain) -> Finding:
    return Finding(check, where, Verdict.PASSED, says, gain.mean)


def _not_compared(check: str, where: str, why: str) -> Finding:
    return Finding(check, where, Verdict.NOT_COMPARED, why)


