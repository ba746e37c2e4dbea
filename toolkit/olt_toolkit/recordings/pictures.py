"""Pictures of data sets: decoded by one function, which bounds what they can cost."""

import io

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from olt_generator import InputError

LARGEST_BYTES = 64 * 2**20
# Larger than that of any camera here; a small file can claim to be far larger.
_MOST_PIXELS = 64 * 2**20
# By how much the decoder can make an image smaller while it decodes it.
REDUCTIONS = {
    1: cv2.IMREAD_COLOR,
    2: cv2.IMREAD_REDUCED_COLOR_2,
    4: cv2.IMREAD_REDUCED_COLOR_4,
    8: cv2.IMREAD_REDUCED_COLOR_8,
}


def decode_picture(content: bytes, where: str, reduction: int = 1) -> NDArray[np.uint8]:
    """A coded picture as (H, W, 3) RGB; an `InputError`, which calls it `where`, if it is damaged or far too large.

    Each side is divided by `reduction`, 1, 2, 4 or 8, and rounded up; little else is decoded.
    """
    try:
        width, height = Image.open(io.BytesIO(content)).size
        if width * height > _MOST_PIXELS:
            raise InputError(f"{where}: claims {width} x {height} pixels; no camera here has as many, copy it again")
        image = cv2.imdecode(np.frombuffer(content, np.uint8), REDUCTIONS[reduction])
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError, cv2.error) as error:
        raise InputError(f"{where}: cannot be decoded as an image; copy it again") from error
    if image is None:
        raise InputError(f"{where}: cannot be decoded as an image; copy it again")
    return np.ascontiguousarray(image[..., ::-1], dtype=np.uint8)
