"""Changed copies of drives, as people make them: cropped, mirrored, coded anew, shifted, with words on them."""

import io
from collections.abc import Callable
from dataclasses import dataclass

import av
import cv2
import numpy as np
from numpy.typing import NDArray

Frames = NDArray[np.uint8]
Generator = np.random.Generator
Change = Callable[[Frames, Generator], Frames]


@dataclass(frozen=True)
class Drive:
    """Images (n, H, W, 3) RGB at ascending times (n,) in microseconds."""

    name: str
    frames: Frames
    times_us: NDArray[np.int64]

    def window(self, start: float, share: float) -> "Drive":
        """What is between two shares of the whole: `share` of it from `start` on."""
        first, length = self.times_us[0], np.ptp(self.times_us)
        inside = (self.times_us >= first + start * length) & (self.times_us <= first + (start + share) * length)
        return Drive(self.name, self.frames[inside], self.times_us[inside])


def crop(frames: Frames, generator: Generator) -> Frames:
    """Up to a tenth off each side, each its own."""
    height, width = frames.shape[1:3]
    left, right, above, below = generator.uniform(0.0, 0.1, 4)
    rows = slice(round(above * height), round((1.0 - below) * height))
    return frames[:, rows, round(left * width) : round((1.0 - right) * width)]


def add_bars(frames: Frames, generator: Generator) -> Frames:
    """Black bars above and below, or left and right: 5 to 20 % of the image each."""
    height, width = frames.shape[1:3]
    share = generator.uniform(0.05, 0.2)
    rows, columns = (round(share * height), 0) if generator.random() < 0.5 else (0, round(share * width))
    return np.pad(frames, ((0, 0), (rows, rows), (columns, columns), (0, 0)))


def turn(frames: Frames, generator: Generator) -> Frames:
    """By 1.5 to 3 degrees either way, with black corners."""
    height, width = frames.shape[1:3]
    degrees = generator.choice([-1.0, 1.0]) * generator.uniform(1.5, 3.0)
    matrix = cv2.getRotationMatrix2D((0.5 * width, 0.5 * height), degrees, 1.0)
    return np.stack([cv2.warpAffine(frame, matrix, (width, height)) for frame in frames]).astype(np.uint8)


def brighten(frames: Frames, generator: Generator) -> Frames:
    """Half to one and a half times as bright, cut at white."""
    return np.clip(frames * generator.choice([0.5, 0.7, 1.3, 1.5]), 0.0, 255.0).astype(np.uint8)


def bend_tones(frames: Frames, generator: Generator) -> Frames:
    """Gamma of 0.55 to 1.8."""
    table = 255.0 * (np.arange(256) / 255.0) ** np.exp(generator.uniform(-0.6, 0.6))
    return table.astype(np.uint8)[frames]


def code_anew(frames: Frames, generator: Generator) -> Frames:
    """H.264 of low bitrate: constant rate factor 34 to 40."""
    rows, columns = frames.shape[1] // 2 * 2, frames.shape[2] // 2 * 2
    buffer = io.BytesIO()
    with av.open(buffer, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=10, options={"crf": str(generator.integers(34, 41))})
        stream.width, stream.height, stream.pix_fmt, stream.thread_count = columns, rows, "yuv420p", 1
        for frame in frames[:, :rows, :columns]:
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")
            container.mux(stream.encode(picture))
        container.mux(stream.encode())
    buffer.seek(0)
    with av.open(buffer, "r") as coded:
        return np.stack([frame.to_ndarray(format="rgb24") for frame in coded.decode(video=0)]).astype(np.uint8)


def shrink(frames: Frames, generator: Generator) -> Frames:
    """A quarter to 60 % of the size."""
    scale = generator.uniform(0.25, 0.6)
    return np.stack([cv2.resize(frame, None, fx=scale, fy=scale) for frame in frames])


def to_grey(frames: Frames, generator: Generator) -> Frames:
    """Without colour."""
    del generator
    return np.stack([cv2.cvtColor(cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB) for frame in frames])


def mirror(frames: Frames, generator: Generator) -> Frames:
    """Left for right."""
    del generator
    return frames[:, :, ::-1]


def write_over(frames: Frames, generator: Generator) -> Frames:
    """A logo in a corner, a clock above, or a caption in a black strip below."""
    frames = frames.copy()
    height, width = frames.shape[1:3]
    kind = generator.integers(3)
    if kind == 0:
        size, color = round(0.15 * width), generator.integers(0, 256, 3)
        row = int(generator.choice([0.03, 0.85]) * height)
        column = int(generator.choice([0.03, 0.82]) * width)
        frames[:, row : row + size // 2, column : column + size] = color.astype(np.uint8)
        return frames
    if kind == 1:
        frames[:, round(0.9 * height) :] = 0
    place = (round(0.02 * width), round((0.97 if kind == 1 else 0.08) * height))
    for number, frame in enumerate(frames):
        words = f"2026-11-29 08:{number // 60:02d}:{number % 60:02d} {40 + number % 7} km/h"
        cv2.putText(frame, words, place, cv2.FONT_HERSHEY_SIMPLEX, height / 450.0, (255, 255, 255), 1)
    return frames


CHANGES: dict[str, Change] = {
    "crop": crop,
    "bars": add_bars,
    "turn": turn,
    "brightness": brighten,
    "gamma": bend_tones,
    "low bitrate": code_anew,
    "resize": shrink,
    "grey": to_grey,
    "mirror": mirror,
    "words or logo": write_over,
}
"""Changes of images alone, by name."""


def copy_window(drive: Drive, kind: str, generator: Generator) -> tuple[Drive, Drive]:
    """A window of a drive and a copy of it, changed in one way or, for "two at once", in two.

    Kinds are those of `CHANGES`, "shift" by up to 2 s, "part" (another start and length), "speed" and "two at once".
    """
    share = generator.uniform(0.6, 0.75)
    start = generator.uniform(0.0, 1.0 - share)
    window = drive.window(start, share)
    if kind == "shift":
        most = min(2e6 / np.ptp(drive.times_us), 1.0 - share)
        moved = float(np.clip(start + generator.choice([-1.0, 1.0]) * generator.uniform(0.1, 1.0) * most, 0, 1 - share))
        return window, drive.window(moved, share)
    if kind == "part":
        part = generator.uniform(0.5, 0.8)
        return window, window.window(generator.uniform(0.0, 1.0 - part), part)
    if kind == "speed":
        times_us = window.times_us / np.exp(generator.uniform(-0.69, 0.69))
        return window, Drive(drive.name, window.frames, times_us.astype(np.int64))
    if kind == "two at once":
        first, second = generator.choice(["shift", "speed", *CHANGES], 2, replace=False)
        original, copy = copy_window(drive, str(first), generator)
        if second in CHANGES:
            return original, Drive(drive.name, CHANGES[str(second)](copy.frames, generator), copy.times_us)
        return original, copy_window(Drive(drive.name, copy.frames, copy.times_us), str(second), generator)[1]
    return window, Drive(drive.name, CHANGES[kind](window.frames, generator), window.times_us)


KINDS = (*CHANGES, "shift", "part", "speed", "two at once")
