"""Decoding of the parts of a video that somebody looks at, tile by tile.

The autoencoder looks at whole images, so tiles are not exactly the whole; but a tile does not depend on which other
tiles are decoded.
"""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from olt_generator.diffusion.config import CELL_PIXELS
from olt_generator.diffusion.latents import LatentCodec
from olt_generator.errors import InputError
from olt_generator.views.lookback import FRAMES_PER_LATENT


@dataclass(frozen=True)
class DecodedVideo:
    """A video (f, h, w, 3) uint8, black in tiles that were left out, and how many of all tiles those are."""

    video: NDArray[np.uint8]
    left_out: int
    tiles: int


def decode_needed(codec: LatentCodec, latents: Tensor, needed: NDArray[np.bool_], tile: int | None) -> DecodedVideo:
    """Decode latents (1, 16, t, h, w) where a pixel (8 h, 8 w) is needed in any frame.

    Args:
        tile: side in pixels of the tiles, a multiple of 16, which overlap by a quarter and fade into one another; None
            for the whole image at once, or not at all where nothing is needed.

    Raises:
        InputError: a tile that is no multiple of 16.
    """
    if tile is not None and (tile < 2 * CELL_PIXELS or tile % (2 * CELL_PIXELS)):
        raise InputError(f"tiles of {tile} pixels: give a multiple of {2 * CELL_PIXELS}")
    height, width = needed.shape
    rows, columns = (_spans(size, tile) for size in (height, width))
    frames = 1 + FRAMES_PER_LATENT * (latents.shape[2] - 1)
    total = torch.zeros((frames, height, width, 3))
    weight = torch.zeros((height, width, 1))
    decoded = 0
    for row in rows:
        for column in columns:
            if not needed[row, column].any():
                continue
            part = latents[..., _cells(row), _cells(column)]
            fade = _fade(row, height)[:, None, None] * _fade(column, width)[None, :, None]
            total[:, row, column] += fade * codec.decode(part)[0].float().cpu()
            weight[row, column] += fade
            decoded += 1
    video = (total / weight.clamp(min=1e-12)).round().to(torch.uint8).numpy()
    tiles = len(rows) * len(columns)
    return DecodedVideo(video, tiles - decoded, tiles)


def _spans(size: int, tile: int | None) -> list[slice]:
    if tile is None or tile >= size:
        return [slice(0, size)]
    stride = tile - tile // 4 // CELL_PIXELS * CELL_PIXELS
    return [slice(start, start + tile) for start in [*range(0, size - tile, stride), size - tile]]


def _cells(span: slice) -> slice:
    return slice(span.start // CELL_PIXELS, span.stop // CELL_PIXELS)


def _fade(span: slice, size: int) -> Tensor:
    """Weights of the pixels of a tile: falling towards those of its edges that other tiles overlap."""
    count = span.stop - span.start
    ramp = torch.arange(1, count + 1) / (count // 4 + 1)
    fade = torch.ones(count)
    if span.start > 0:
        fade = torch.minimum(fade, ramp)
    if span.stop < size:
        fade = torch.minimum(fade, ramp.flip(0))
    return fade
