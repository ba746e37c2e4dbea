"""Which way up a video is shown: its display matrix, and turns that the user asks for."""

from dataclasses import dataclass

import numpy as np
from av.video.frame import VideoFrame
from numpy.typing import NDArray

from olt_generator.errors import InputError

# A matrix is a quarter turn if what is left beside it is below this share; players round half a degree away, too.
_NEGLIGIBLE = 0.01


@dataclass(frozen=True)
class Orientation:
    """One of the eight ways to show a rectangle upright: rows may become columns, then either axis may be reversed."""

    transposed: bool = False
    reverse_columns: bool = False
    reverse_rows: bool = False

    def apply(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The image (H, W, 3) as it is shown; (W, H, 3) where rows become columns."""
        shown = image.swapaxes(0, 1) if self.transposed else image
        shown = shown[:: -1 if self.reverse_rows else 1, :: -1 if self.reverse_columns else 1]
        return np.ascontiguousarray(shown)


AS_STORED = Orientation()
# Clockwise turns in degrees, as users give them.
TURNS = {
    0: AS_STORED,
    90: Orientation(transposed=True, reverse_columns=True),
    180: Orientation(reverse_columns=True, reverse_rows=True),
    270: Orientation(transposed=True, reverse_rows=True),
}


def turned(clockwise: int, mirror: bool) -> Orientation:
    """A clockwise turn by so many degrees, and then left for right; InputError if it is no multiple of 90 below 360."""
    if clockwise not in TURNS:
        raise InputError(f"a turn by {clockwise} degrees: give 0, 90, 180 or 270")
    turn = TURNS[clockwise]
    return Orientation(turn.transposed, turn.reverse_columns != mirror, turn.reverse_rows)


def read_orientation(frame: VideoFrame, where: str) -> Orientation:
    """How the display matrix of a decoded frame turns and mirrors it.

    The matrix maps (x, y) of the stored picture, y down, to (a x + c y, b x + d y); it is kept as nine 32-bit integers,
    a, b, u, c, d, v, x, y, w (ISO/IEC 14496-12, 8.3.2; FFmpeg's AV_FRAME_DATA_DISPLAYMATRIX).

    Raises:
        InputError: it turns by an odd angle or shears, which no upright rectangle is.
    """
    data = frame.side_data.get("DISPLAYMATRIX")
    if data is None:
        return AS_STORED
    a, b, _, c, d = np.frombuffer(bytes(data), dtype=np.int32)[:5].astype(float)
    straight, crossed = max(abs(a), abs(d)), max(abs(b), abs(c))
    if min(straight, crossed) > _NEGLIGIBLE * max(straight, crossed) or not (a * d or b * c):
        angle = np.degrees(np.arctan2(b, a))
        raise InputError(
            f"{where}: is shown turned by {angle:.1f} degrees, which leaves no upright rectangle; convert the video so "
            "that its pictures are stored upright"
        )
    if straight > crossed:
        return Orientation(False, a < 0, d < 0)
    return Orientation(True, c < 0, b < 0)
