"""Whether the statistics that a LeRobot data set states of its images are those of what its videos show."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from olt_generator.errors import InputError
from olt_generator.poses import Array
from olt_toolkit.clips.verification.findings import Finding, judge, not_compared, state
from olt_toolkit.clips.video import decode_images

IMAGE_STATISTICS = "image statistics"
SAMPLED_FRAMES = 32
"""Frames of each camera that are decoded, spread evenly over all of its videos."""
CODING_ERROR = 0.03
"""Of the range of levels, by which encoding may change the mean and the spread of colours."""
CERTAIN = 4.0
"""Standard errors by which the sampled frames may differ from all."""

Frames = Sequence[tuple[Path, int]]
"""Videos and how many frames episodes take of each."""


def check_image_statistics(root: Path, key: str, videos: Frames) -> Iterator[Finding]:
    """Hold mean and spread of each colour, levels 0 to 1, against a sample of the frames of one camera."""
    path = root / "meta" / "stats.json"
    where = f"{path}: {key}"
    try:
        stated = _read_stated(path, key)
    except (OSError, ValueError, KeyError, TypeError) as error:
        detail = f"mean and std of three colours, (3, 1, 1), cannot be read ({error!r}); export again"
        yield state(IMAGE_STATISTICS, where, False, detail)
        return
    try:
        levels = _sample(root, videos)
    except (InputError, OSError) as error:
        yield not_compared(IMAGE_STATISTICS, where, f"frames cannot be decoded: {error}")
        return
    means, squares = levels
    count = len(means)
    if count < 2:
        yield not_compared(IMAGE_STATISTICS, where, f"{count} frames are too few")
        return
    mean = means.mean(axis=0)
    spread = np.sqrt(np.maximum(squares.mean(axis=0) - mean**2, 0.0))
    error = means.std(axis=0, ddof=1) / np.sqrt(count)
    limit = CODING_ERROR + CERTAIN * float(error.max())
    for name, found, said in (("mean", mean, stated[0]), ("std", spread, stated[1])):
        worst = float(np.abs(found - said).max())
        shown = f"{np.round(said, 3).tolist()} is stated and {np.round(found, 3).tolist()} found in {count} frames"
        detail = f"of the range of levels between the {name} that is stated and that of red, green and blue: {shown}"
        yield judge(IMAGE_STATISTICS, f"{where}: {name}", worst, limit, f"{detail}; export again")


def _read_stated(path: Path, key: str) -> tuple[Array, Array]:
    stats: dict[str, Any] = json.loads(path.read_bytes())[key]
    mean, spread = (np.array(stats[name], np.float64).reshape(3, 1, 1)[:, 0, 0] for name in ("mean", "std"))
    return mean, spread


def _sample(root: Path, videos: Frames) -> tuple[Array, Array]:
    """Mean level and mean squared level (n, 3) of each colour in frames that are spread evenly over all videos."""
    ends = np.cumsum([frames for _, frames in videos])
    total = int(ends[-1])
    wanted = np.unique(np.linspace(0, total - 1, min(SAMPLED_FRAMES, total)).round().astype(np.int64))
    means: list[NDArray[np.float64]] = []
    squares: list[NDArray[np.float64]] = []
    for (path, frames), end in zip(videos, ends.tolist(), strict=True):
        inside = wanted[(wanted >= end - frames) & (wanted < end)] - (end - frames)
        if len(inside) == 0:
            continue
        images = decode_images((root / path).read_bytes(), inside, str(root / path), None) / 255.0
        means += list(images.mean(axis=(2, 3)))
        squares += list((images**2).mean(axis=(2, 3)))
    return np.array(means), np.array(squares)
