"""Corners and tracks on images that move by whole pixels."""

import cv2
import numpy as np
import pytest

from olt_generator.motion.features import detect_corners, track_corners, track_from_keyframes

STEP = 3
HIDDEN = np.zeros((160, 240), np.bool_)


@pytest.fixture(scope="module")
def moving_picture():
    """Frames that look at a wide picture from a window that moves right."""
    noise = np.random.default_rng(1).integers(0, 256, (160, 400)).astype(np.uint8)
    wide = cv2.GaussianBlur(noise, (0, 0), 2.0)
    wide = cv2.normalize(wide, wide, 0, 255, cv2.NORM_MINMAX)
    return [np.ascontiguousarray(wide[:, STEP * k : STEP * k + 240]) for k in range(16)]


def test_corners_are_spread_over_the_cells(moving_picture):
    corners = detect_corners(moving_picture[0], 2)
    cells = (corners // 32).astype(int)
    _, count = np.unique(cells, axis=0, return_counts=True)
    assert count.max() <= 2
    assert len(count) > 25


def test_corners_keep_away_from_what_is_hidden_and_what_is_there(moving_picture):
    present = detect_corners(moving_picture[0], 4)
    hidden = HIDDEN.copy()
    hidden[:, :120] = True
    added = detect_corners(moving_picture[0], 8, hidden, present)
    assert len(added) > 0
    assert added[:, 0].min() >= 120
    distances = np.linalg.norm(added[:, None] - present[None], axis=-1)
    assert distances.min() > 5.0


def test_points_are_followed_and_lost_at_the_border(moving_picture):
    corners = detect_corners(moving_picture[0], 4)
    moved, found = track_corners(moving_picture[0], moving_picture[1], corners)
    assert np.allclose(moved[found] - corners[found], [-STEP, 0.0], atol=0.1)
    assert found.mean() > 0.8
    assert moved[found].min() >= 0.0


def test_points_keep_their_identity_over_keyframes(moving_picture):
    place = {}
    keyframes = [0, 2, 4, 6, 8, 10, 12, 15]
    life = {}
    for pair in track_from_keyframes(moving_picture, keyframes, HIDDEN, 4, window=4):
        for point, pixel in zip(pair.points.tolist(), pair.current_pixels, strict=True):
            in_picture = pixel[0] + STEP * pair.current
            assert place.setdefault(point, in_picture) == pytest.approx(in_picture, abs=0.7)
        if pair.current in keyframes:
            for point in pair.points.tolist():
                life[point] = life.get(point, 0) + 1
    assert max(life.values()) == 4


def test_points_that_run_onto_what_is_hidden_are_dropped(moving_picture):
    hidden = HIDDEN.copy()
    hidden[:, :100] = True
    for pair in track_from_keyframes(moving_picture, [0, 5, 10, 15], hidden, 4, window=10):
        assert pair.key_pixels[:, 0].min() > 99.0
