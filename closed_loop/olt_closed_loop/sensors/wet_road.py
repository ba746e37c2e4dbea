"""A wet road: what it mirrors, seen by rays that are turned upwards at the ground, and blurred by its roughness."""

import cv2
import numpy as np

from olt_closed_loop.sensors.textures import FloatImage, Image

# Reflectance of water at normal incidence (Schlick's approximation of Fresnel's equations), and what roughness leaves.
_NORMAL, _SMOOTH = 0.02, 0.75


def mirrored_share(sine: FloatImage, rain: float) -> FloatImage:
    """Share (...) of light that comes from the mirror image, for rays that meet the road at angles of such a sine."""
    grazing = np.float32(1.0) - np.clip(sine, np.float32(0.0), np.float32(1.0))
    return np.float32(_SMOOTH * min(1.0, 2.0 * rain)) * (np.float32(_NORMAL) + np.float32(1.0 - _NORMAL) * grazing**5)


def mix_mirrored(rgb: Image, mirrored: Image, share: FloatImage) -> Image:
    """An image (H, W, 3) with its mirror image blended in by a share (H, W); uneven water draws it out downwards."""
    height = rgb.shape[0]
    size = (max(1, height // 120) | 1, max(3, height // 16) | 1)
    smeared = cv2.blur(mirrored, size).astype(np.float32)
    mixed = rgb + (smeared - rgb) * share[..., None]
    return (mixed + np.float32(0.5)).astype(np.uint8)
