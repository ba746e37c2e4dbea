"""Videos of a clip, decoded from the first frame to the last, once for all checks that look at them."""

import io
from collections.abc import Sequence
from dataclasses import dataclass

import av
import av.error
import numpy as np
from av.video.reformatter import VideoReformatter
from numpy.typing import NDArray

from olt_generator.poses import Array
from olt_toolkit.clips.pai_layout import VIDEO
from olt_toolkit.clips.store import ClipStore

# Images are looked at with at most so many columns, at most so often, and so many of them.
WIDEST = 480
LEAST_GAP_US = 80_000
MOST_IMAGES = 250

_SHRINK = 4  # along both sides, before each image is compared with the one before


@dataclass(frozen=True)
class DecodedVideo:
    """What decoding a whole video told.

    Attributes:
        sizes: width and height of the frames, one pair if all are alike.
        numbers: (n,) what the public reader takes each frame for, in the order of decoding.
        rate: frames per second that the container states; 0.0 where it states none.
        change: (n - 1,) mean absolute difference of each image from the one before, grey levels.
        problem: what stopped the decoder, and at which frame; None where nothing did.
        kept: (m, h, w) brightness, 0 to 255, of the frames that were asked for and are there.
    """

    sizes: frozenset[tuple[int, int]]
    numbers: NDArray[np.int64]
    rate: float
    change: Array
    problem: str | None
    kept: NDArray[np.uint8]


def decode_video(data: bytes, keep: Sequence[int] = (), size: tuple[int, int] = (1, 1)) -> DecodedVideo:
    """Decode a video from its first frame to its last; what cannot be decoded is told, not raised.

    Args:
        data: the video file.
        keep: which frames are kept, by their place in the order of decoding.
        size: width and height with which they are kept.
    """
    sizes: set[tuple[int, int]] = set()
    numbers, change, kept = [], [], []
    rate, problem, before = 0.0, None, None
    small_reformatter, kept_reformatter, wanted = VideoReformatter(), VideoReformatter(), frozenset(keep)
    try:
        with av.open(io.BytesIO(data), "r") as container:
            stream = container.streams.video[0]
            stream.codec_context.thread_count = 1
            rate = float(stream.average_rate or 0.0)
            ticks = int(1 / stream.average_rate / stream.time_base) if stream.average_rate and stream.time_base else 1
            for frame in container.decode(stream):
                if frame.is_corrupt:
                    problem = f"frame {len(numbers)} is damaged"
                    break
                sizes.add((frame.width, frame.height))
                small = max(frame.width // _SHRINK, 1), max(frame.height // _SHRINK, 1)
                image = _grey(small_reformatter, frame, small).astype(np.int16)
                if before is not None and before.shape == image.shape:
                    change.append(float(np.abs(image - before).mean()))
                before = image
                if len(numbers) in wanted:
                    kept.append(_grey(kept_reformatter, frame, size))
                numbers.append(round((frame.pts or 0) / max(ticks, 1)))
    except (av.error.FFmpegError, IndexError, OSError, ValueError) as error:
        problem = f"decoding stops after {len(numbers)} frames ({error})"
    images = np.array(kept, np.uint8).reshape(len(kept), size[1], size[0])
    return DecodedVideo(frozenset(sizes), np.array(numbers, np.int64), rate, np.array(change), problem, images)


class ClipVideos:
    """The videos of one clip of a store; each is decoded when it is first asked for, and then known."""

    def __init__(self, store: ClipStore, clip_id: str) -> None:
        self._store, self._clip_id = store, clip_id
        self._decoded: dict[str, DecodedVideo] = {}

    def decode(self, camera: str) -> DecodedVideo:
        """The video of a camera, with its `looked_at` frames kept, of `small_size`.

        Raises:
            InputError: the file, its timestamps or its lens cannot be read.
        """
        if camera not in self._decoded:
            lens = self._store.read_camera(self._clip_id, camera).camera
            keep = looked_at(self._store.read_timestamps(self._clip_id, camera))
            data = self._store.read_member(self._clip_id, camera, VIDEO)
            self._decoded[camera] = decode_video(data, keep.tolist(), small_size(lens.width, lens.height))
        return self._decoded[camera]


def looked_at(timestamps_us: NDArray[np.int64]) -> NDArray[np.int64]:
    """Numbers (m,) of the frames at times (n,) that lie far enough apart to be looked at, from the first on."""
    kept = [0]
    for index, time_us in enumerate(timestamps_us.tolist()):
        if time_us - timestamps_us[kept[-1]] >= LEAST_GAP_US:
            kept.append(index)
    return np.array(kept[:MOST_IMAGES])


def small_size(width: int, height: int) -> tuple[int, int]:
    """Width and height with which frames of that size are looked at."""
    small = min(WIDEST, width)
    return small, max(round(height * small / width), 1)


def _grey(reformatter: VideoReformatter, frame: av.VideoFrame, size: tuple[int, int]) -> NDArray[np.uint8]:
    return np.asarray(
        reformatter.reformat(frame, *size, "gray", interpolation="AREA", threads=1).to_ndarray(), np.uint8
    )
