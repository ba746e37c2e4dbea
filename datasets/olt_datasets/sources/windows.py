"""Windows of a drive: which images lie in one."""

import numpy as np
from numpy.typing import NDArray

from olt_generator.errors import InputError
from olt_toolkit.policy.window import Span


def images_within(front_us: NDArray[np.int64], window_us: Span, where: str) -> NDArray[np.intp]:
    """Numbers (m,) of the images at times (n,) that lie in [first, last].

    Raises:
        InputError: there are none; names `where`.
    """
    inside = np.flatnonzero((front_us >= window_us[0]) & (front_us <= window_us[1]))
    if len(inside) == 0:
        raise InputError(f"{where}: no front image lies between {window_us[0]} and {window_us[1]} us of the drive")
    return inside
