"""Fingerprints of drives that nobody drove, in any number: alike as roads are, and none a copy of another."""

import numpy as np
from numpy.typing import NDArray

from olt_generator.seeds import make_generator
from olt_toolkit.clips.fingerprint import COLUMNS, IMAGES, RECORD, ROWS

_WAVES_ALONG, _WAVES_DOWN = 14, 8
_COMMON, _OF_A_CLIP, _KEPT = 0.35, 0.25, 0.8
"""Shares of energy that all clips, and all images of a clip, have in common; and what an image keeps of the last."""
_SPACING_MS = 1200


def draw_fingerprints(count: int, seed: int) -> NDArray[np.void]:
    """Records (count, 16) of `fingerprint.RECORD`: signs of smooth fields.

    A field is the sum of one that all have in common, as roads have sky and lanes, one of the clip, and one that goes
    over into another from image to image.
    """
    generator, waves = make_generator("fake fingerprints", seed), _weighted_waves()
    common = make_generator("what fake fingerprints have in common").standard_normal(len(waves))
    clip = generator.standard_normal((count, len(waves)), np.float32)
    passing = generator.standard_normal((count, len(waves)), np.float32)
    records = np.zeros((count, IMAGES), RECORD)
    records["time_ms"] = _SPACING_MS * np.arange(IMAGES)
    for image in range(IMAGES):
        fields = (
            np.sqrt(_COMMON) * common + np.sqrt(_OF_A_CLIP) * clip + np.sqrt(1.0 - _COMMON - _OF_A_CLIP) * passing
        ).astype(np.float32) @ waves
        records["signs"][:, image] = np.packbits(fields > 0.0, axis=1)
        fresh = generator.standard_normal(passing.shape, np.float32)
        passing = _KEPT * passing + np.sqrt(1.0 - _KEPT**2) * fresh
    return records


def _weighted_waves() -> NDArray[np.float32]:
    """Cosines (waves, cells), slow ones stronger."""
    along, down = np.mgrid[:_WAVES_ALONG, :_WAVES_DOWN].reshape(2, -1)[:, 1:]
    across = np.cos(np.pi * along[:, None] * (np.arange(COLUMNS) + 0.5) / COLUMNS)
    upright = np.cos(np.pi * down[:, None] * (np.arange(ROWS) + 0.5) / ROWS)
    weights = 1.0 / np.sqrt(4.0 + np.hypot(along, 1.5 * down) ** 2)
    return np.einsum("w,wx,wy->wyx", weights, across, upright).reshape(len(weights), -1).astype(np.float32)
