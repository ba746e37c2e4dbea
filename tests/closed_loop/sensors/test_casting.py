"""Which box each ray meets first: the search from coarse squares to fine ones against every ray and every box."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from olt_closed_loop.sensors.boxes import Boxes
from olt_closed_loop.sensors.camera_rays import camera_rays
from olt_closed_loop.sensors.casting import cast
from olt_generator.cameras import FthetaCamera, PinholeCamera
from olt_generator.poses import Array

CAMERAS = {
    "pinhole": PinholeCamera.from_field_of_view(75, 52, np.radians(90.0)),
    "fisheye": FthetaCamera.equidistant(70, 50, 34.5, 24.5, 24.0),
}


def random_boxes(seed: int, count: int, upright: bool) -> Boxes:
    generator = np.random.default_rng(seed)
    turns = generator.uniform(-np.pi, np.pi, (count, 3)) * ([1.0, 0.0, 0.0] if upright else [1.0, 1.0, 1.0])
    return Boxes(
        center=generator.uniform(-12.0, 12.0, (count, 3)) + np.array([0.0, 0.0, 6.0]),
        half=generator.uniform(0.1, 2.0, (count, 3)),
        axes=Rotation.from_euler("zyx", turns).as_matrix(),
        color=np.zeros((count, 3), np.float32),
        surface=np.zeros((count, 6), np.int32),
        repeats=np.ones((count, 3), np.float32),
        lit=np.zeros(count, bool),
    )


def distances(boxes: Boxes, rays: Array) -> Array:
    """Distance (n, rays) along each ray (3, rays) to each box, one by one, in double precision."""
    found = []
    for center, half, axes in zip(boxes.center, boxes.half, boxes.axes, strict=True):
        origin, direction = -axes.T @ center, axes.T @ rays
        with np.errstate(divide="ignore"):
            walls = np.stack([(side * half[:, None] - origin[:, None]) / direction for side in (-1.0, 1.0)])
        entry, leave = walls.min(axis=0).max(axis=0), walls.max(axis=0).min(axis=0)
        found.append(np.where((entry <= leave) & (leave > 0.0), np.where(entry > 0.0, entry, leave), np.inf))
    return np.array(found)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**20), st.integers(1, 30), st.booleans(), st.sampled_from(sorted(CAMERAS)))
def test_every_ray_meets_the_box_that_is_nearest(seed: int, count: int, upright: bool, lens: str) -> None:
    view, boxes = camera_rays(CAMERAS[lens]), random_boxes(seed, count, upright)
    farthest = np.full(view.angles.size, 15.0, np.float32)
    hits = cast(boxes, view.squares, np.take(view.rays, view.pixels, axis=1), view.pixels, farthest)
    nearest = distances(boxes, view.rays.astype(np.float64)).min(axis=0)
    found = np.full(view.angles.size, np.inf)
    found[hits.pixel] = hits.distance
    expected = np.where(nearest < 15.0, nearest, np.inf)
    # Rays along an edge, and boxes at just the farthest distance, may be told otherwise by rounding.
    same = np.isclose(found, expected, rtol=1e-4, atol=1e-4) | (np.isinf(found) & np.isinf(expected))
    assert same.mean() > 0.998
    along = distances(boxes, view.rays[:, hits.pixel].astype(np.float64))[hits.box, np.arange(len(hits.box))]
    assert np.isclose(along, hits.distance, rtol=1e-3, atol=1e-3).sum() >= 0.998 * len(hits.box)


@pytest.mark.parametrize("lens", sorted(CAMERAS))
def test_strips_are_the_rays_of_their_rows(lens: str) -> None:
    view = camera_rays(CAMERAS[lens])
    assert np.array_equal(np.concatenate([strip.rays for strip in view.strips], axis=1), view.rays)
    assert {(strip.field, strip.finest) for strip in view.strips} == {(view.field, view.finest)}
