"""The encoder of a camera: frames after they went through H.264 at a low rate."""

import io
from fractions import Fraction

import av
import numpy as np

from olt_closed_loop.sensors.textures import Image

_KEY_FRAME_SECONDS = 2.0


def compress(frames: Image, frame_rate: float, kilobits_per_second: float) -> Image:
    """Frames (n, H, W, 3), encoded at a rate and decoded again; equal frames give equal bytes."""
    height, width = frames.shape[1:3]
    # H.264 wants even sizes.
    frames = np.pad(frames, ((0, 0), (0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    rate = Fraction(frame_rate).limit_denominator(1001)
    file = io.BytesIO()
    with av.open(file, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=rate)
        stream.height, stream.width = frames.shape[1:3]
        stream.pix_fmt, stream.time_base, stream.thread_count = "yuv420p", 1 / rate, 1
        stream.gop_size = max(1, round(_KEY_FRAME_SECONDS * frame_rate))
        stream.bit_rate = round(1000.0 * kilobits_per_second)
        # As in `olt_generator.video.write_video`: without the macroblock tree the same frames give the same bytes.
        buffer = f"vbv-maxrate={kilobits_per_second:.0f}:vbv-bufsize={kilobits_per_second:.0f}"
        stream.options = {"preset": "veryfast", "threads": "1", "x264-params": f"mbtree=0:{buffer}"}
        for index, image in enumerate(frames):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
            frame.pts, frame.time_base = index, 1 / rate
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    file.seek(0)
    with av.open(file, "r") as coded:
        decoded = [np.asarray(frame.to_ndarray(format="rgb24"), np.uint8) for frame in coded.decode(video=0)]
    return np.stack(decoded)[:, :height, :width]
