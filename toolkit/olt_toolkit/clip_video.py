"""Frames out of a clip's video, by index."""

import io

import av
import av.error
import numpy as np
from numpy.typing import NDArray

from olt_generator.errors import InputError


def decode_frames(video: bytes, indices: NDArray[np.int64], where: str) -> NDArray[np.uint8]:
    """Decode frames (m, H, W, 3), RGB, in one pass from the key frame before the first to the last that is wanted.

    Frame k of a stream of constant rate starts at k whole periods of container time, which is how the public reader
    counts (facts sheet pai_dataset, section 5).

    Args:
        video: a whole video file.
        indices: (m,) frame numbers, ascending; a number may repeat.
        where: what an error message calls the video.

    Raises:
        InputError: the video is damaged or has fewer frames.
    """
    wanted = set(indices.tolist())
    found: dict[int, NDArray[np.uint8]] = {}
    try:
        with av.open(io.BytesIO(video), "r") as container:
            stream = container.streams.video[0]
            stream.codec_context.thread_count = 1
            if stream.average_rate is None or stream.time_base is None:
                raise InputError(f"{where}: the video has no frame rate; build the clip again")
            period = int(1 / stream.average_rate / stream.time_base)
            container.seek(int(indices[0]) * period, stream=stream)
            for frame in container.decode(stream):
                index = round((frame.pts or 0) / period)
                if frame.is_corrupt:
                    raise InputError(f"{where}: frame {index} of the video is damaged; build the clip again")
                if index in wanted:
                    found[index] = np.asarray(frame.to_ndarray(format="rgb24"), np.uint8)
                if index >= indices[-1]:
                    break
    except (av.error.FFmpegError, IndexError) as error:
        raise InputError(f"{where}: the video cannot be decoded; build the clip again") from error
    if len(found) < len(wanted):
        missing = min(wanted - found.keys())
        raise InputError(f"{where}: the video has no frame {missing}, which its timestamps promise; build it again")
    return np.stack([found[index] for index in indices.tolist()])
