"""Fingerprints hold what a window shows, whatever its size, coding, brightness and bars, and nothing of fog."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_generator.seeds import make_generator
from olt_toolkit.clips.fingerprint import IMAGES, RECORD, fingerprint_images, fingerprint_times


def make_pictures(name, count=4):
    """Smooth structure of a few grey levels per quarter of the image, as pictures have and noise has not."""
    coarse = make_generator("picture", name).integers(0, 256, (count, 6, 10, 3)).astype(np.uint8)
    return np.stack([cv2.resize(image, (320, 192), interpolation=cv2.INTER_CUBIC) for image in coarse])


def read(frames, step_us=500_000):
    return np.frombuffer(fingerprint_images(frames, 7 + step_us * np.arange(len(frames))), RECORD)


def agreement(first, second):
    """Share of equal signs."""
    return 1.0 - np.unpackbits(read(first)["signs"] ^ read(second)["signs"]).mean()


def test_another_size_brightness_coding_or_black_bars_change_few_signs():
    pictures = make_pictures("street")
    small = np.stack([cv2.resize(image, (80, 48), interpolation=cv2.INTER_AREA) for image in pictures])
    quality = [cv2.IMWRITE_JPEG_QUALITY, 30]
    coded = np.stack([cv2.imdecode(cv2.imencode(".jpg", image, quality)[1], cv2.IMREAD_COLOR) for image in pictures])
    others = [small, coded, (0.5 * pictures).astype(np.uint8), np.pad(pictures, ((0, 0), (40, 40), (0, 0), (0, 0)))]
    assert min(agreement(pictures, each) for each in others) > 0.97


def test_other_pictures_agree_by_chance():
    looks = [make_pictures(name) for name in range(8)]
    agreements = [agreement(a, b) for index, a in enumerate(looks) for b in looks[:index]]
    assert max(agreements) < 0.65


def test_a_mirrored_image_has_mirrored_signs():
    pictures = make_pictures("street")
    plain, mirrored = (
        np.unpackbits(read(each)["signs"], axis=1).reshape(-1, 10, 20) for each in (pictures, pictures[:, :, ::-1])
    )
    assert (plain[:, :, ::-1] == mirrored).mean() > 0.99


def test_times_are_those_since_the_first_image():
    assert read(make_pictures("street"))["time_ms"].tolist() == [0, 500, 1000, 1500]


@pytest.mark.parametrize("level", [0, 120, 255])
def test_images_without_contrast_are_left_out(level):
    plain = np.full((3, 96, 160, 3), level, np.uint8)
    assert fingerprint_images(plain, np.arange(3)) == b""
    mixed = np.concatenate([plain, cv2.resize(make_pictures("street")[0], (160, 96))[None]])
    assert read(mixed)["time_ms"].tolist() == [1500]


def test_images_that_are_lit_in_a_small_part_are_dim():
    night = np.zeros_like(make_pictures("street"))
    night[:, 100:150, 100:200] = make_pictures("street")[:, 100:150, 100:200]
    assert read(night)["dim"].tolist() == [1] * 4
    assert read(make_pictures("street"))["dim"].tolist() == [0] * 4


@pytest.mark.parametrize("count", [1, 2, 16, 41])
def test_at_most_sixteen_images_are_kept_evenly(count):
    frames = make_pictures("street", count)
    times_ms = read(frames)["time_ms"] / 500
    assert len(times_ms) == min(count, IMAGES)
    assert np.ptp(np.diff(times_ms)) <= 1 if count > 1 else times_ms.tolist() == [0]


@given(st.integers(-(2**50), 2**50), st.integers(0, 2**40))
def test_wanted_times_are_in_the_window_and_ascend(first_us, length_us):
    times_us = fingerprint_times(first_us, first_us + length_us)
    assert len(times_us) == IMAGES
    assert first_us <= times_us[0] and times_us[-1] <= first_us + length_us
    assert np.diff(times_us).min() >= 0
