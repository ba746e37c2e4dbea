"""Leaks planted through the commands are found by the command, and nothing else is."""

import cv2
import numpy as np
import pytest

from olt_datasets.benchmarks.planted_leaks import measure_planted
from olt_generator.seeds import make_generator
from olt_generator.video import write_video


def film(path, look):
    """Nine seconds of a street by chance that grows towards the camera."""
    street = make_generator("planted", look).integers(0, 256, (60, 120, 3), dtype=np.uint8)
    frames = []
    for number in range(90):
        left, top = number // 3, number // 6
        part = street[top : 60 - top, left : 120 - left]
        frames.append(cv2.resize(part, (128, 72), interpolation=cv2.INTER_AREA))
    write_video(path, np.stack(frames), 10)
    return path


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    folder = tmp_path_factory.mktemp("planted")
    (folder / "drives").mkdir()
    (folder / "others").mkdir()
    videos = [film(folder / "drives" / f"{number:03d}.mp4", number) for number in range(3)]
    return videos, [film(folder / "others" / "100.mp4", 100)], folder


@pytest.mark.parametrize(
    ("kind", "rule"),
    [
        pytest.param("copy", "overlap", marks=pytest.mark.slow),
        ("symlink", "overlap"),
        pytest.param("renamed", "overlap", marks=pytest.mark.slow),
        pytest.param("overlap", "overlap", marks=pytest.mark.slow),
        pytest.param("re-encoded", "near-duplicate", marks=pytest.mark.slow),
        ("mirrored", "near-duplicate"),
        pytest.param("darker", "near-duplicate", marks=pytest.mark.slow),
        pytest.param("held-out scene, mirrored", "near-duplicate", marks=pytest.mark.slow),
        pytest.param("external source", "external", marks=pytest.mark.slow),
    ],
)
def test_a_planted_leak_is_found(drives, tmp_path, kind, rule):
    videos, others, _ = drives
    (row,) = measure_planted(videos, others, tmp_path, [kind])
    assert (row.planted, row.found, row.false_alarms) == (3, 3, 0)
    assert row.rules[rule] == 3
    assert row.to_dict()["found_interval"][1] == 1.0
