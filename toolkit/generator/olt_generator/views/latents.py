"""How video frames and pixels map to the latent frames and cells of the video autoencoder.

Wan 2.1 compresses 4 frames to one, after a first frame that stands alone, and 8 x 8 pixels to one cell; its
transformer reads 2 x 2 cells as one token (docs/formats/generator.md).
"""

from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.errors import InputError

FRAMES_PER_LATENT = 4
CELL_PIXELS = 8
TOKEN_PIXELS = 16

Moment = Literal["mean", "last", "lookback"]
"""Which frame stands for the four of a latent. The released generator uses three: the mean of their times for the
poses that it was trained with, the last one for the poses of its inference tool, and the last but one as the source
of a lookback warp."""

_BEFORE_LAST: dict[Moment, float] = {"mean": 1.5, "last": 0.0, "lookback": 1.0}


def latent_of_frame(frame: int) -> int:
    """The latent frame that holds a frame."""
    return (frame + FRAMES_PER_LATENT - 1) // FRAMES_PER_LATENT


def frames_of_latent(latent: int) -> range:
    """The frames that a latent frame holds: frame 0 alone, then four at a time."""
    last = FRAMES_PER_LATENT * latent
    return range(last - FRAMES_PER_LATENT + 1 if latent > 0 else 0, last + 1)


def count_latents(frames: int) -> int:
    """Latent frames of a video.

    Raises:
        InputError: the number of frames is not 1 more than a multiple of 4.
    """
    if frames < 1 or frames % FRAMES_PER_LATENT != 1:
        raise InputError(f"{frames} frames do not fill latent frames: give 1, 5, 9, ... 41, ... frames")
    return latent_of_frame(frames - 1) + 1


def frame_of_latent(latent: int, moment: Moment) -> float:
    """The frame number, perhaps between two frames, that stands for a latent frame."""
    return max(0.0, FRAMES_PER_LATENT * latent - _BEFORE_LAST[moment])


def visibility_in_latents(visible: NDArray[np.bool_]) -> NDArray[np.float16]:
    """How visible each latent cell is, between 0 and 1: (latents, H / 8, W / 8) from pixels (n, H, W).

    Each frame is sampled bilinearly at the middle of every cell, without averaging over it, and a latent frame takes
    the largest value of its frames, as the released generator does.

    Raises:
        InputError: the frames do not fill latent frames, or the pixels do not fill cells.
    """
    height, width = visible.shape[1:]
    if height % CELL_PIXELS or width % CELL_PIXELS:
        raise InputError(f"images of {width} x {height} pixels do not fill cells of {CELL_PIXELS} x {CELL_PIXELS}")
    size = (width // CELL_PIXELS, height // CELL_PIXELS)
    cells = np.stack([cv2.resize(frame.astype(np.float32), size, interpolation=cv2.INTER_LINEAR) for frame in visible])
    held = [frames_of_latent(latent) for latent in range(count_latents(len(visible)))]
    return np.stack([cells[frames.start : frames.stop].max(axis=0) for frames in held]).astype(np.float16)
