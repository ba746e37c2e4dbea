"""Where the pixels of an image come from."""

from enum import IntEnum


class PixelOrigin(IntEnum):
    """Where a pixel comes from.

    Attributes:
        INVENTED: no camera saw it at any time; its colour is made up.
        SAME_FRAME: a camera saw it at the moment of the image.
        OTHER_FRAME: the front camera saw it at another moment.
        UNSEEN: no camera looked there and nothing is made up: black, beyond the border of a real image.
    """

    INVENTED = 0
    SAME_FRAME = 1
    OTHER_FRAME = 2
    UNSEEN = 3
