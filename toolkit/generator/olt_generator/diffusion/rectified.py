"""The straight-lined images that the learned engine works on: a pinhole for each lens, and moments of latent frames."""

import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera, PinholeCamera
from olt_generator.diffusion.latents import latent_frames
from olt_generator.views.lookback import FRAMES_PER_LATENT

# Degrees off the axis up to which a pinhole covers a lens: beyond, perspective would spend most pixels on the rim.
WIDEST_HALF_ANGLE = 70.0
# Points along each side of an image by which its border is known.
_BORDER_POINTS = 65


def rectified_camera(camera: Camera, width: int, height: int) -> PinholeCamera:
    """The narrowest centred pinhole of `width` x `height` square pixels that shows all that a lens shows.

    Of wide lenses the parts more than 70 degrees off the axis stay outside.
    """
    rays = camera.rays(_border(camera))
    off_axis = np.degrees(np.arccos(np.clip(rays[:, 2], -1.0, 1.0)))
    # At the limit, a ray in the same direction around the axis stands for what lies beyond it.
    angle = np.radians(np.minimum(np.nan_to_num(off_axis, nan=WIDEST_HALF_ANGLE), WIDEST_HALF_ANGLE))
    around = rays[:, :2] / np.maximum(np.linalg.norm(rays[:, :2], axis=1, keepdims=True), 1e-12)
    across = np.nanmax(np.abs(around) * np.tan(angle)[:, None], axis=0)
    focal = float(min(0.5 * width / across[0], 0.5 * height / across[1]))
    return PinholeCamera(width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))


def latent_steps(frames: int) -> NDArray[np.int64]:
    """Indices (1 + (frames - 1) / 4,) of the frames whose poses stand for the latent frames: 0, 4, 8, ...

    Of the three conventions of the release it is that of its inference (docs/formats/generator.md).

    Raises:
        InputError: the frames are not 4 k + 1.
    """
    return FRAMES_PER_LATENT * np.arange(latent_frames(frames), dtype=np.int64)


def _border(camera: Camera) -> NDArray[np.float64]:
    """Pixels (n, 2) along the outer edge of an image."""
    u = np.linspace(-0.5, camera.width - 0.5, _BORDER_POINTS)
    v = np.linspace(-0.5, camera.height - 0.5, _BORDER_POINTS)
    sides = [(u, np.full_like(u, edge)) for edge in (v[0], v[-1])]
    sides += [(np.full_like(v, edge), v) for edge in (u[0], u[-1])]
    return np.concatenate([np.stack(side, axis=-1) for side in sides])
