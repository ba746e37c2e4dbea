"""Interlaced pictures: the two fields of a frame were taken one after the other, and what moves shows a comb.

One field of each frame is kept, and the lines between are the mean of their neighbours. That halves the vertical
resolution, leaves no trace of the other moment, and makes each picture from its own frame alone, so that a window of a
video holds the pictures of the whole.
"""

import av
import av.filter
import cv2
import numpy as np
from av.video.frame import VideoFrame
from numpy.typing import NDArray

# A pixel is combed if it differs from both lines beside it, in one direction, by more than so many of 255 grey levels.
_COMB_LEVELS = 12.0
# A picture is, if this share of its pixels are, and so many times more than are in its single fields: scenes vary less
# from one line to the next than over two lines, and noise as much.
_COMBED_SHARE = 0.004
_TIMES_FIELD = 1.4
_COLUMN_STEP = 4


def is_combed(luma: NDArray[np.uint8]) -> bool:
    """Whether a picture (H, W) of 8-bit brightness is made of two fields that show different moments.

    Fine horizontal lines in the scene look like a comb too, but they do so in single fields as well.
    """
    if luma.shape[0] < 8:
        return False
    lines = luma[:, ::_COLUMN_STEP].astype(np.int16)
    across = _combed_share(lines)
    within = 0.5 * (_combed_share(lines[::2]) + _combed_share(lines[1::2]))
    return across > _COMBED_SHARE and across > _TIMES_FIELD * within


def _combed_share(lines: NDArray[np.int16]) -> float:
    above, below = lines[:-2] - lines[1:-1], lines[2:] - lines[1:-1]
    both_up = (above > _COMB_LEVELS) & (below > _COMB_LEVELS)
    both_down = (above < -_COMB_LEVELS) & (below < -_COMB_LEVELS)
    return float(np.mean(both_up | both_down))


class FieldReader:
    """Takes the upper field out of frames of one size and format; colour planes too are interlaced."""

    def __init__(self, frame: VideoFrame) -> None:
        self._graph = av.filter.Graph()
        source = self._graph.add_buffer(
            width=frame.width, height=frame.height, format=frame.format, time_base=frame.time_base
        )
        field, sink = self._graph.add("field", "type=top"), self._graph.add("buffersink")
        source.link_to(field)
        field.link_to(sink)
        self._graph.configure()
        self._source, self._sink = source, sink
        self.layout = frame.width, frame.height, frame.format.name

    def read(self, frame: VideoFrame) -> VideoFrame:
        """The upper field, of half the height."""
        self._source.push(frame)
        field = self._sink.pull()
        assert isinstance(field, VideoFrame)
        return field


def fill_lines(field: NDArray[np.uint8], height: int) -> NDArray[np.uint8]:
    """A picture (height, W, 3) whose even lines are those of an upper field, and the others the mean of two."""
    picture = np.empty((height, *field.shape[1:]), np.uint8)
    picture[0::2] = field
    between = np.concatenate([field[1:], field[-1:]]) if height % 2 == 0 else field[1:]
    picture[1::2] = cv2.addWeighted(field[: len(between)], 0.5, between, 0.5, 0.0)
    return picture
