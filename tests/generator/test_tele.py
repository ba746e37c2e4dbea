"""The tele crop is exact in angle and shows the pixels of the front image."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_generator.cameras import FthetaCamera, PinholeCamera, pixel_rays
from olt_generator.errors import InputError
from olt_generator.tele import crop_tele, tele_camera

PINHOLE = PinholeCamera(832, 480, 600.0, 620.0, 420.3, 250.7)
EQUIDISTANT = FthetaCamera.equidistant(832, 468, 413.4, 327.9, 410.0)
STRETCHED = EQUIDISTANT.resized(832, 480)
FRONTS = [PINHOLE, EQUIDISTANT, STRETCHED]


@pytest.mark.parametrize("front", FRONTS)
@settings(max_examples=20, deadline=None)
@given(width=st.integers(32, 900), field_of_view=st.floats(0.1, 0.8))
def test_outer_column_edges_are_half_the_field_of_view_from_the_axis(front, width, field_of_view):
    tele = tele_camera(front, width, width // 2, field_of_view)
    edges = np.array([[-0.5, tele.cy], [width - 0.5, tele.cy]])
    rays = tele.rays(edges)
    assert np.degrees(np.arctan2(rays[:, 0], rays[:, 2])) == pytest.approx(
        np.degrees([-0.5 * field_of_view, 0.5 * field_of_view]), abs=1e-9
    )


@pytest.mark.parametrize("front", FRONTS)
def test_pixels_are_square_and_the_axis_is_in_the_middle(front):
    tele = tele_camera(front, 576, 320)
    axis = np.array([0.0, 0.0, 1.0])
    assert tele.project(axis)[0] == pytest.approx([287.5, 159.5])
    right, _ = tele.project(np.array([1e-4, 0.0, 1.0]))
    down, _ = tele.project(np.array([0.0, 1e-4, 1.0]))
    assert right[0] - 287.5 == pytest.approx(down[1] - 159.5, rel=1e-6)


@pytest.mark.parametrize("front", FRONTS)
def test_tele_pixels_show_the_front_pixels_of_the_same_ray(front):
    """On an image whose value is a linear function of the pixel, bicubic cropping is exact up to rounding."""
    v, u = np.mgrid[: front.height, : front.width].astype(float)
    ramp = np.stack([u / 4.0, v / 3.0, (u + v) / 6.0], axis=-1)
    tele = tele_camera(front, 576, 320)
    cropped = crop_tele(np.rint(ramp).astype(np.uint8)[None], front, tele)[0]
    pixels, seen = front.project(pixel_rays(tele))
    assert seen.all()
    u, v = pixels[..., 0], pixels[..., 1]
    expected = np.stack([u / 4.0, v / 3.0, (u + v) / 6.0], axis=-1)
    assert np.abs(cropped - expected).max() <= 1.6
    assert abs(np.mean(cropped - expected)) < 0.02


@pytest.mark.parametrize("front", FRONTS)
@settings(max_examples=20, deadline=None)
@given(u=st.floats(0.0, 575.0), v=st.floats(0.0, 319.0))
def test_a_tele_pixel_and_its_front_pixel_share_their_ray(front, u, v):
    tele = tele_camera(front, 576, 320)
    pixel, seen = front.project(tele.rays(np.array([u, v])))
    assert seen
    back, _ = tele.project(front.rays(pixel))
    assert back == pytest.approx([u, v], abs=1e-6)


def test_shrinking_does_not_alias():
    front = PinholeCamera.from_field_of_view(3000, 200, float(np.radians(60.0)))
    stripes = np.zeros((1, 200, 3000, 3), np.uint8)
    stripes[:, :, ::2] = 200
    cropped = crop_tele(stripes, front, tele_camera(front, 200, 20))
    assert np.abs(cropped.astype(int) - 100).max() < 12


def test_a_front_camera_too_narrow_is_refused():
    narrow = PinholeCamera.from_field_of_view(832, 480, float(np.radians(25.0)))
    with pytest.raises(InputError, match="30 degree"):
        tele_camera(narrow, 576, 320)
    with pytest.raises(InputError, match="rows"):
        tele_camera(PINHOLE.cropped(0, 200, 832, 80), 576, 320)
