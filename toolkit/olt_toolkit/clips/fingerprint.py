"""Perceptual hashes of images: close for images that look alike, whatever their size and coding.

An image is reduced to 9 x 8 grey levels, and each of 64 bits tells whether brightness falls from one to its right
neighbour (the difference hash) by more than coding and noise make it fall in a plain sky. Hashes compare by the number
of bits in which they differ. In four real drives that is at most 3 for an image and itself at half the size, as a JPEG
of quality 25, or darkened to 80 %, and at least 16 for images of different drives.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

FINGERPRINT_IMAGES = 5
LEAST_FALL = 4
"""Grey levels of 256 by which brightness must fall, and more."""


def fingerprint_times(first_us: int, last_us: int) -> NDArray[np.int64]:
    """The moments (k,) of a window whose images a fingerprint would like: the middles of equal parts."""
    middles = 2 * np.arange(FINGERPRINT_IMAGES, dtype=np.int64) + 1
    return first_us + middles * (last_us - first_us) // (2 * FINGERPRINT_IMAGES)


def fingerprint_images(frames: NDArray[np.uint8], times_us: NDArray[np.int64]) -> bytes:
    """What the images (k, H, W, 3) RGB of a window look like at times (k,), in microseconds from any origin."""
    middles = (2 * np.arange(FINGERPRINT_IMAGES) + 1) * len(frames) // (2 * FINGERPRINT_IMAGES)
    return b"".join(hash_image(frames[index]).to_bytes(8, "big") for index in middles)


def hash_image(image: NDArray[np.uint8]) -> int:
    """The 64-bit difference hash of an image (H, W, 3) RGB; 0 for one without any falling edge."""
    grey = cv2.resize(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), (9, 8), interpolation=cv2.INTER_AREA)
    return int.from_bytes(np.packbits(cv2.subtract(grey[:, :-1], grey[:, 1:]) > LEAST_FALL).tobytes(), "big")
