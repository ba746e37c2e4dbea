"""Pieces of a textured plane matched between pictures of a camera that moved by a known distance."""

from functools import lru_cache

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from olt_generator.cameras import PinholeCamera, pixel_rays
from olt_generator.errors import InputError
from olt_generator.motion.road_grid import RoadGrid, find_peak, road_frame

CAMERA = PinholeCamera.from_field_of_view(416, 240, np.radians(70.0))
HEIGHT = 1.5
FORWARD, UP = np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])
AXES = road_frame(FORWARD, UP, FORWARD)
SHOWN = np.zeros((240, 416), np.bool_)
TEXEL = 0.05


@lru_cache(maxsize=1)
def texture():
    noise = np.random.default_rng(1).standard_normal((1024, 1024)).astype(np.float32)
    return 128.0 + 200.0 * cv2.GaussianBlur(noise, (0, 0), 2.0)


def film(driven, turned=None):
    """Grey picture of the plane after driving so far, by a camera turned by `turned`."""
    rays = pixel_rays(CAMERA) @ (np.eye(3) if turned is None else turned).T
    down = np.maximum(rays[..., 1], 1e-3)
    along, across = driven + HEIGHT * rays[..., 2] / down, HEIGHT * rays[..., 0] / down
    places = [(value / TEXEL + 400.0).astype(np.float32) for value in (along, across)]
    picture = cv2.remap(texture(), places[0], places[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    return np.clip(picture, 0, 255).astype(np.uint8)


def match(first, second, hidden=SHOWN, turned=None):
    grid = RoadGrid(CAMERA, HEIGHT, AXES, hidden)
    later = AXES if turned is None else AXES.rotated(turned.T)
    return grid, grid.match(grid.rectify(first, AXES), grid.rectify(second, later))


def best_shifts(grid, matches):
    """Shift (columns, rows) with which each cell agrees best, NaN where it shows nothing."""
    known = np.isfinite(matches.correlation).any(axis=-1)
    best = grid.shifts[np.argmax(np.nan_to_num(matches.correlation, nan=-2.0), axis=-1)]
    return np.where(known, best, np.nan)


@settings(max_examples=15, deadline=None)
@given(st.floats(-2.5, 2.5))
def test_every_cell_shifts_by_the_distance_driven_and_its_sign(driven):
    grid, matches = match(film(0.0), film(driven))
    # Farther away a pixel is longer than the texture of this plane; nearer, backward, the grid had not begun.
    rows = (matches.along < 12.0) & (matches.along + driven > matches.along[0])
    found = best_shifts(grid, matches)[1:-1, rows]
    assert np.mean(np.isfinite(found)) > 0.9
    assert np.nanmedian(np.abs(found - driven)) < 0.06
    assert np.nanmean(np.abs(found - driven) < 0.11) > 0.8


def test_a_turn_between_the_pictures_is_taken_out():
    turned = Rotation.from_euler("yx", [1.5, -0.7], degrees=True).as_matrix()
    grid, matches = match(film(0.0), film(1.2, turned), turned=turned)
    assert np.nanmedian(np.abs(best_shifts(grid, matches) - 1.2)) < 0.04


def test_what_covers_a_part_of_the_road_shifts_on_its_own():
    first, second = film(0.0), film(1.0)
    static = film(33.0)
    for picture in (first, second):
        picture[:, :208] = static[:, :208]
    grid, matches = match(first, second)
    found = best_shifts(grid, matches)
    left, right = matches.across > 1.0, matches.across < -1.0
    assert np.nanmax(np.abs(found[left])) < 0.06
    assert np.nanmedian(np.abs(found[right] - 1.0)) < 0.04


def test_what_is_hidden_or_shows_nothing_says_nothing():
    hidden = SHOWN.copy()
    hidden[:, 240:] = True
    grid, matches = match(film(0.0), film(1.0), hidden)
    known = np.isfinite(matches.correlation).any(axis=(1, 2))
    assert not known[matches.across < -2.9].any()
    assert known[(matches.across > 0.6) & (matches.across < 3.0)].all()
    assert np.nanmedian(np.abs(best_shifts(grid, matches) - 1.0)) < 0.04
    blank = np.full((240, 416), 90, np.uint8)
    assert not np.isfinite(match(blank, blank)[1].correlation).any()
    assert not np.isfinite(match(film(0.0), blank)[1].correlation).any()


def test_shifts_to_where_the_road_was_not_seen_are_not_tried():
    hidden = SHOWN.copy()
    hidden[:150] = True
    _, matches = match(film(0.0), film(0.5), hidden)
    assert not np.isfinite(matches.correlation[:, -1]).any(), "the farthest cells lie in the hidden rows"
    near = matches.correlation[len(matches.across) // 2, 0]
    assert 0 < np.count_nonzero(np.isfinite(near)) < len(near)


def test_a_direction_aside_moves_the_grid_but_not_its_plane():
    aside = np.array([np.sin(0.1), 0.05, np.cos(0.1)])
    axes = road_frame(FORWARD, UP + 0.2 * FORWARD, aside)
    assert axes.up == pytest.approx(UP)
    assert axes.along @ axes.up == pytest.approx(0.0, abs=1e-12)
    assert np.cross(axes.up, axes.along) == pytest.approx(axes.left)
    assert np.degrees(np.arctan2(axes.along[0], axes.along[2])) == pytest.approx(np.degrees(0.1))


def test_a_view_without_road_is_refused():
    sky = CAMERA.cropped(0, 0, 416, 118)
    with pytest.raises(InputError, match="check its pitch and height"):
        RoadGrid(sky, HEIGHT, AXES, np.zeros((118, 416), np.bool_))


@given(st.floats(2.0, 17.0), st.floats(0.01, 10.0), st.integers(0, 3))
def test_the_peak_of_a_parabola_is_exact(place, curvature, margin):
    scores = -curvature * (np.arange(20) - place) ** 2
    assert find_peak(scores, int(place) - margin, int(place) + 1 + margin) == pytest.approx(place, abs=1e-6)


def test_a_slope_has_no_peak():
    assert find_peak(np.arange(9.0), 2, 6) is None
    assert find_peak(-np.arange(9.0), 2, 6) is None
    assert find_peak(np.zeros(9), 2, 6) is None
    assert find_peak(np.array([0.0, 1.0, 0.0]), 2, 1) is None
