"""The depth warp as the control of VACE: what the front camera saw of a view, and which cells it saw.

Paper, section Temporal Depth Warp: the warped pixels, encoded by the autoencoder, and a mask of visibility a token; no
parameters. The released generator puts the latents into the reactive channels and repeats the mask 64 times. VACE was
trained for outpainting with another layout: what is to be kept in the inactive channels, and a mask of what is to be
made.
"""

from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from olt_generator.diffusion.config import CELL_PIXELS, CONTROL_CHANNELS, MASK_CHANNELS
from olt_generator.diffusion.latents import latent_frames
from olt_generator.views.lookback import FRAMES_PER_LATENT
from olt_generator.views.pixel_origin import PixelOrigin

Layout = Literal["released", "outpainting"]


def warp_prior(
    images: NDArray[np.uint8],
    origin: NDArray[np.uint8],
    fill: bool = False,
    other_frames: bool = True,
    confidence: NDArray[np.float32] | None = None,
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """What the geometric engine shows of a view: images (f, h, w, 3), and how far each pixel was really seen.

    The paper warps one frame only: the same one for cross views, an earlier one for rear views. The geometric engine
    draws on several, and may know how far each pixel can be trusted.

    Args:
        images, origin: (f, h, w, 3) and (f, h, w) of `views.synthesis.SynthesizedView`.
        fill: whether what it made up stays in the images; black otherwise.
        other_frames: whether pixels of other frames count as seen, or those of the same frame alone.
        confidence: (f, h, w) 0 to 1, trust in each pixel; all that is seen is trusted where it is None.

    Returns:
        The images, and visibility (f, h, w) from 0 to 1.
    """
    seen = origin == PixelOrigin.SAME_FRAME
    if other_frames:
        seen |= origin == PixelOrigin.OTHER_FRAME
    visible = seen.astype(np.float32) if confidence is None else np.where(seen, confidence, np.float32(0.0))
    return images if fill else np.where(seen[..., None], images, np.uint8(0)), visible


def cell_visibility(visible: Tensor) -> Tensor:
    """Visibility (b, 1, t, h / 8, w / 8) of latent cells from that of pixels (b, f, h, w), 0 to 1.

    Over a cell it is the mean, over the frames of a latent the maximum, as in the released generator, which looks at
    the four middle pixels of a cell only.

    Raises:
        InputError: the frames are not 4 k + 1.
    """
    latent_frames(visible.shape[1])
    cells = torch.nn.functional.avg_pool2d(visible.float(), CELL_PIXELS)
    later = cells[:, 1:].unflatten(1, (-1, FRAMES_PER_LATENT)).amax(dim=2)
    return torch.cat([cells[:, :1], later], dim=1)[:, None]


def vace_control(warped: Tensor, visibility: Tensor, layout: Layout = "released") -> Tensor:
    """The control (b, 96, t, h, w) of VACE: 16 inactive channels, 16 reactive ones, 64 of the mask.

    Args:
        warped: (b, 16, t, h, w) normalised latents of the warped video.
        visibility: (b, 1, t, h, w) 0 to 1, of `cell_visibility`.
        layout: where the warp stands, and whether the mask says what is seen ("released") or what is to be made.
    """
    mask = visibility.to(warped.dtype).expand(-1, MASK_CHANNELS, -1, -1, -1)
    nothing = torch.zeros_like(warped)
    if layout == "released":
        return torch.cat([nothing, warped, mask], dim=1)
    return torch.cat([warped, nothing, 1.0 - mask], dim=1)


def no_warp(latents: Tensor) -> Tensor:
    """The control (b, 96, t, h, w) of a view of which nothing was warped, for latents (b, 16, t, h, w)."""
    return latents.new_zeros(len(latents), CONTROL_CHANNELS, *latents.shape[2:])
