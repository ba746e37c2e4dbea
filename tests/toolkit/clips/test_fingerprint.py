"""Hashes of images that look alike are close, those of others are not."""

import cv2
import numpy as np
import pytest

from olt_generator.seeds import make_generator
from olt_toolkit.clips.fingerprint import FINGERPRINT_IMAGES, fingerprint_images, hash_image


def make_picture(name):
    """Smooth structure of a few grey levels per quarter of the image, as pictures have and noise has not."""
    coarse = make_generator("picture", name).integers(0, 256, (6, 10, 3)).astype(np.uint8)
    return cv2.resize(coarse, (160, 96), interpolation=cv2.INTER_CUBIC)


def distance(first, second):
    return (hash_image(first) ^ hash_image(second)).bit_count()


@pytest.mark.parametrize("name", range(5))
def test_another_size_brightness_or_coding_changes_few_bits(name):
    picture = make_picture(name)
    small = cv2.resize(picture, (80, 48), interpolation=cv2.INTER_AREA)
    coded = cv2.imdecode(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 30])[1], cv2.IMREAD_COLOR)
    dark = (0.6 * picture).astype(np.uint8)
    assert max(distance(picture, other) for other in (small, coded, dark)) <= 3


def test_other_pictures_differ_in_many_bits():
    pictures = [make_picture(name) for name in range(12)]
    distances = [distance(a, b) for index, a in enumerate(pictures) for b in pictures[:index]]
    assert min(distances) >= 15


def test_a_picture_that_darkens_to_the_right_sets_every_bit():
    ramp = np.repeat(np.linspace(255, 0, 90).astype(np.uint8), 3).reshape(1, 90, 3).repeat(40, axis=0)
    assert hash_image(ramp) == 2**64 - 1
    assert hash_image(ramp[:, ::-1]) == 0


@pytest.mark.parametrize("count", [1, 2, 5, 41])
def test_a_fingerprint_is_of_images_spread_over_the_sequence(count):
    frames = np.stack([make_picture(index) for index in range(count)])
    hashes = [hash_image(frame) for frame in frames]
    fingerprint = fingerprint_images(frames, np.arange(count))
    assert len(fingerprint) == 8 * FINGERPRINT_IMAGES
    places = [hashes.index(int(each)) for each in np.frombuffer(fingerprint, ">u8")]
    assert places == [min(count - 1, count * (2 * part + 1) // 10) for part in range(5)]
