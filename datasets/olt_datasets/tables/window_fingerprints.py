"""Fingerprints of the windows of a drive before any clip is built: from a few small images of each."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from olt_generator.errors import InputError
from olt_toolkit.clips.fingerprint import fingerprint_images, fingerprint_times
from olt_toolkit.policy.window import Span
from olt_toolkit.recordings.drives import Dataset

WIDTH = 320
"""Pixels of the images that are looked at."""
_WINDOWS_AT_ONCE = 24
# A fingerprint needs an image every ten metres or so; the denser they are, the fewer of them are key frames.
_SPACING_US = 400_000
_FEWEST = 4


def fingerprint_windows(
    dataset: Dataset, key: str, windows: Sequence[Span]
) -> tuple[list[bytes | None], dict[str, int]]:
    """A fingerprint of each window of a drive, None where its images cannot be decoded; and why, for how many windows.

    Images that windows share are decoded once. A fingerprint depends on the drive and the window alone.
    """
    found: list[bytes | None] = []
    failed: dict[str, int] = {}
    for start in range(0, len(windows), _WINDOWS_AT_ONCE):
        together = windows[start : start + _WINDOWS_AT_ONCE]
        try:
            found += _fingerprint_some(dataset, key, together)
        except InputError:
            # One by one, so that only those without are left out whose own images are damaged.
            for window in together:
                try:
                    found += _fingerprint_some(dataset, key, [window])
                except InputError as error:
                    found.append(None)
                    failed[str(error)] = failed.get(str(error), 0) + 1
    return found, failed


def choose_moments(window: Span) -> NDArray[np.int64]:
    """Those of the moments that a fingerprint would like that are `_SPACING_US` apart, but four at least."""
    wanted = fingerprint_times(*window)
    step = -(-_SPACING_US // max(1, int(wanted[1] - wanted[0])))
    step = min(step, len(wanted) // _FEWEST)
    return wanted[step // 2 :: step]


def _fingerprint_some(dataset: Dataset, key: str, windows: Sequence[Span]) -> list[bytes]:
    wanted = [choose_moments(window) for window in windows]
    # Half of the way to the next moment that is wanted of the window.
    reach = [np.full(len(each), (each[1] - each[0]) // 2) for each in wanted]
    frames, times_us = dataset.peek(key, np.concatenate(wanted), WIDTH, np.concatenate(reach))
    fingerprints = []
    ends = np.cumsum([len(each) for each in wanted])
    for (first_us, _), end, moments in zip(windows, ends, wanted, strict=True):
        shown_us, places = np.unique(times_us[end - len(moments) : end], return_index=True)
        fingerprints.append(fingerprint_images(frames[end - len(moments) + places], shown_us - first_us))
    return fingerprints
