"""Clips longer than the engine's videos: windows that overlap, and one video out of theirs."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from olt_generator.diffusion.latents import latent_frames
from olt_generator.errors import InputError
from olt_generator.views.lookback import FRAMES_PER_LATENT

Video = NDArray[np.uint8]

# Frames of the paper's videos, and of what two windows share.
WINDOW, OVERLAP = 41, 9


def plan_windows(frames: int, longest: int = WINDOW, overlap: int = OVERLAP) -> tuple[range, ...]:
    """Windows of 4 k + 1 frames each, all of one length, that cover a clip of any length; each overlaps the one before.

    Clips of 2 to 4 frames are images of their own: no shorter video than 5 frames is one.

    Raises:
        InputError: no frame, a window that is not 4 k + 1, or an overlap that is not, or not shorter.
    """
    latent_frames(longest)
    latent_frames(overlap)
    if frames < 1 or (overlap >= longest > 1):
        raise InputError(f"{frames} frames in windows of {longest} that share {overlap}: give fewer to share")
    length = min(longest, frames - (frames - 1) % FRAMES_PER_LATENT)
    # Starts are whole latent frames apart, so that windows share the noise of what they share.
    stride = max(1, length - min(overlap, max(0, length - FRAMES_PER_LATENT)))
    starts = [*range(0, frames - length, stride), frames - length]
    return tuple(range(start, start + length) for start in starts)


def first_latent(window: range) -> int:
    """The latent frame of the clip in which a window starts."""
    return -(-window.start // FRAMES_PER_LATENT)


def blend_windows(videos: Sequence[Video], windows: Sequence[range]) -> Video:
    """One video (n, h, w, 3) of those of its windows (f, h, w, 3): each fades in over the frames that it shares."""
    whole = np.empty((windows[-1].stop, *videos[0].shape[1:]), np.uint8)
    covered = 0
    for video, window in zip(videos, windows, strict=True):
        shared = max(0, covered - window.start)
        whole[window.start + shared : window.stop] = video[shared:]
        for place in range(shared):
            share = (place + 1) / (shared + 1)
            old = whole[window.start + place]
            old[:] = np.rint((1.0 - share) * old + share * video[place])
        covered = window.stop
    return whole


def seam_ratio(video: Video, windows: Sequence[range]) -> float | None:
    """How much faster a video changes where windows meet than elsewhere: a ratio of mean absolute frame differences.

    1 is no seam; None where no windows meet, or nothing changes elsewhere.
    """
    change = np.abs(np.diff(video.astype(np.int16), axis=0)).mean(axis=(1, 2, 3))
    meeting = np.zeros(len(change), bool)
    for before, after in pairwise(windows):
        meeting[max(0, after.start - 1) : before.stop] = True
    if not meeting.any() or meeting.all() or not change[~meeting].any():
        return None
    return float(change[meeting].mean() / change[~meeting].mean())
