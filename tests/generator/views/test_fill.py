"""Holes are filled from around them; what was seen keeps its bytes."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_generator.seeds import make_generator
from olt_generator.views.fill import MID_GREY, fill_holes, interpolate


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32), height=st.integers(1, 50), width=st.integers(1, 50), share=st.floats(0.0, 1.0))
def test_visible_pixels_keep_their_bytes_and_holes_stay_in_range(seed, height, width, share):
    random = make_generator(seed)
    image = random.integers(0, 256, (height, width, 3)).astype(np.uint8)
    visible = random.random((height, width)) < share
    filled = fill_holes(image, visible)
    assert filled.shape == image.shape
    assert filled.dtype == np.uint8
    assert np.array_equal(filled[visible], image[visible])
    if visible.any():
        low, high = image[visible].min(axis=0).astype(int), image[visible].max(axis=0).astype(int)
        assert np.all(filled >= low - 1)
        assert np.all(filled <= high + 1)


def test_unseen_image_becomes_mid_grey():
    filled = fill_holes(np.zeros((9, 12, 3), np.uint8), np.zeros((9, 12), bool))
    assert np.all(filled == MID_GREY)


def test_hidden_bytes_do_not_leak():
    random = make_generator("hidden")
    visible = random.random((40, 60)) < 0.3
    image = random.integers(0, 256, (40, 60, 3)).astype(np.uint8)
    other = np.where(visible[..., None], image, 255 - image)
    assert np.array_equal(fill_holes(image, visible), fill_holes(other, visible))


def test_a_hole_takes_the_colour_of_its_surroundings():
    image = np.zeros((64, 96, 3), np.uint8)
    image[:, :48], image[:, 48:] = (200, 40, 10), (10, 60, 220)
    visible = np.ones((64, 96), bool)
    visible[20:30, 10:20] = visible[20:30, 70:80] = False
    filled = fill_holes(image, visible).astype(int)
    assert np.abs(filled - image).max() <= 2


def test_interpolation_runs_smoothly_between_known_edges():
    values = np.tile(np.linspace(0.0, 1.0, 65, dtype=np.float32), (65, 1))[..., None]
    known = np.zeros((65, 65), bool)
    known[:, [0, -1]] = True
    middle = interpolate(values, known)[32, :, 0]
    assert middle[0] == 0.0
    assert middle[-1] == 1.0
    assert np.all(np.diff(middle) > -0.02)
    assert abs(middle[32] - 0.5) < 0.1
