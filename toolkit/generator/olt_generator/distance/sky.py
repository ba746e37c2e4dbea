"""Which pixels show the sky, by colours that the clip itself teaches.

Where parallax is decisive it tells what is far above the horizon and what is not. The colours of both are counted, and
the counts then judge the pixels where parallax says nothing: clear sky, the inside of a cloud, a plain wall.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

# Colours are told apart in this many steps of each channel.
STEPS = 16
# Counts that every colour has from the start, as share of all pixels: a colour seen nowhere is not sky.
PRIOR_SKY, PRIOR_OTHER = 2e-6, 1e-5

# An image (h, w, 3), and where (h, w) it certainly shows the far and where it certainly does not.
LabelledImage = tuple[NDArray[np.uint8], NDArray[np.bool_], NDArray[np.bool_]]


class SkyColours:
    """How often each colour was sky in the examples."""

    def __init__(self, examples: Iterable[LabelledImage]) -> None:
        sky = np.zeros(STEPS**3)
        other = np.zeros(STEPS**3)
        pixels = 0
        for image, is_far, is_near in examples:
            code = _colour_code(image)
            sky += np.bincount(code[is_far], minlength=STEPS**3)
            other += np.bincount(code[is_near], minlength=STEPS**3)
            pixels += code.size
        sky, other = _blur(sky) + PRIOR_SKY * pixels, _blur(other) + PRIOR_OTHER * pixels
        self._share = (sky / np.maximum(sky + other, 1e-12)).astype(np.float32)

    def probability(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Probability (h, w) that pixels above the horizon of an image (h, w, 3) with these colours are sky."""
        return self._share[_colour_code(image)]


def _colour_code(image: NDArray[np.uint8]) -> NDArray[np.int64]:
    red, green, blue = np.moveaxis(image // (256 // STEPS), -1, 0).astype(np.int64)
    return (red * STEPS + green) * STEPS + blue


def _blur(counts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Counts (STEPS^3,) spread to the neighbouring colours, half as much per step."""
    cube = np.pad(counts.reshape(STEPS, STEPS, STEPS), 1)
    for axis in range(3):
        cube = cube + 0.5 * (np.roll(cube, 1, axis) + np.roll(cube, -1, axis))
    return cube[1:-1, 1:-1, 1:-1].ravel()
