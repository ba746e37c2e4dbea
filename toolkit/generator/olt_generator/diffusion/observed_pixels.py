"""What the front camera saw of a view beside what the learned engine makes of the rest."""

import cv2
import numpy as np
from numpy.typing import NDArray

Video = NDArray[np.uint8]

# Share of the width over which a generated part fades into what surrounds it.
_FADE = 1 / 72


def keep_observed(generated: Video, warped: Video, free: NDArray[np.bool_]) -> Video:
    """Generated images (f, h, w, 3) where they are free to be (f, h, w), fading into the warped ones at the edges."""
    fade = max(1.0, _FADE * free.shape[2])
    images = warped.copy()
    for image, made, here in zip(images, generated, free, strict=True):
        inside = cv2.distanceTransform(np.pad(here, 1, mode="edge").astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1]
        share = np.minimum(inside / fade, 1.0)[here][:, None]
        image[here] = np.rint((1.0 - share) * image[here] + share * made[here]).astype(np.uint8)
    return images
