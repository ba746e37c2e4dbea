"""Points that two images share, found without knowing how the cameras stand.

Convention: pixels are those of `olt_generator.cameras`, the origin in the centre of the top-left pixel.
"""

import hashlib
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

# A match whose second-best candidate is nearly as good is as likely wrong as right (Lowe 2004). True side views of a
# real rig agree to 99 % on average at this ratio where they overlap well, and to 98 % at 0.7.
RATIO = 0.65
# The strongest are enough, and the time to match them grows with their square.
MAX_KEY_POINTS = 2000
# Images whose key points are kept, a megabyte each: a view is held against several others, one after the other.
_KEPT_IMAGES = 64


@dataclass(frozen=True)
class Matches:
    """Pixels (n, 2) float64 of the same points in two images."""

    pixels_a: NDArray[np.float64]
    pixels_b: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.pixels_a)

    def only(self, kept: NDArray[np.bool_]) -> "Matches":
        """The matches that a mask (n,) keeps."""
        return Matches(self.pixels_a[kept], self.pixels_b[kept])


class Matcher(Protocol):
    """Finds confident matches; what is confident is the matcher's own affair and part of its name."""

    @property
    def name(self) -> str:
        """What to call the matcher in results."""
        ...

    def match(self, image_a: Image, image_b: Image) -> Matches:
        """Confident matches between two RGB images (H, W, 3)."""
        ...


class SiftMatcher:
    """RootSIFT key points, accepted where each is the other's nearest and clearly nearer than the second.

    Lowe 2004; descriptors are compared by the Hellinger distance (Arandjelovic and Zisserman 2012), which leaves half
    as many wrong matches between views far apart.
    """

    name = f"RootSIFT, mutual, ratio {RATIO}"

    def __init__(self) -> None:
        self._known: dict[tuple[tuple[int, ...], bytes], _KeyPoints] = {}

    def match(self, image_a: Image, image_b: Image) -> Matches:
        """See `Matcher.match`."""
        pixels_a, descriptors_a = self._describe_once(image_a)
        pixels_b, descriptors_b = self._describe_once(image_b)
        if min(len(pixels_a), len(pixels_b)) < 2:
            return Matches(np.zeros((0, 2)), np.zeros((0, 2)))
        forward, clear = _nearest(descriptors_a, descriptors_b)
        backward, _ = _nearest(descriptors_b, descriptors_a)
        mutual = backward[forward] == np.arange(len(forward))
        return Matches(pixels_a, pixels_b[forward]).only(clear & mutual)

    def _describe_once(self, image: Image) -> "_KeyPoints":
        key = image.shape, hashlib.blake2b(image.tobytes(), digest_size=16).digest()
        if key not in self._known:
            if len(self._known) == _KEPT_IMAGES:
                del self._known[next(iter(self._known))]
            self._known[key] = _describe(image)
        return self._known[key]


# Pixels (n, 2) and descriptors (n, 128).
_KeyPoints = tuple[NDArray[np.float64], NDArray[np.float32]]


def _describe(image: Image) -> _KeyPoints:
    """Pixels (n, 2) and descriptors (n, 128) of unit length of the key points of an image."""
    gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    key_points, descriptors = cv2.SIFT.create(MAX_KEY_POINTS).detectAndCompute(gray, np.empty(0, np.uint8))
    pixels = np.array([point.pt for point in key_points], np.float64).reshape(-1, 2)
    if len(pixels) == 0:
        return pixels, np.zeros((0, 128), np.float32)
    histograms = np.asarray(descriptors, np.float32)
    return pixels, np.sqrt(histograms / histograms.sum(axis=1, keepdims=True))


def _nearest(
    queries: NDArray[np.float32], candidates: NDArray[np.float32]
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """For each query (n, d) the nearest candidate (n,), and whether it is clearly nearer than the second."""
    pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(queries, candidates, k=2)
    nearest = np.array([first.trainIdx for first, _ in pairs], np.int64)
    clear = np.array([first.distance < RATIO * second.distance for first, second in pairs], np.bool_)
    return nearest, clear
