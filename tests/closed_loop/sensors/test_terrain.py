"""Rays against hills: where they meet the ground, compared with marching along them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_closed_loop.scenes.hills import Wave, lay_hills
from olt_closed_loop.scenes.scene import Hills
from olt_closed_loop.sensors.terrain import meet_ground
from olt_generator.poses import Array

angles = st.floats(-np.pi, np.pi)


def march(hills: Hills, position: Array, ray: Array) -> float:
    """Distance at which a ray first goes below the ground, in steps of 5 cm up to 400 m."""
    steps = np.arange(0.05, 400.0, 0.05)
    points = position + steps[:, None] * ray
    below = points[:, 2] < hills.height(points)
    return float(steps[np.argmax(below)]) if below.any() else np.inf


@settings(max_examples=60, deadline=None)
@given(st.floats(-400.0, 400.0), st.floats(-400.0, 400.0), angles, angles, st.floats(-0.6, 0.25), st.floats(0.5, 4.0))
def test_a_ray_meets_the_first_ground_in_its_way(
    x: float, y: float, direction: float, azimuth: float, elevation: float, height: float
) -> None:
    hills = lay_hills(direction, (Wave(5.0, 110.0, 0.3), Wave(1.5, 47.0, 2.0)))
    position = np.array([x, y, float(hills.height(np.array([x, y]))) + height])
    level = np.cos(elevation)
    ray = np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
    hit = meet_ground(hills, position, ray.astype(np.float32).reshape(3, 1, 1))
    found, expected = float(hit.distance[0, 0]), march(hills, position, ray)
    if np.isfinite(expected):
        place = position + found * ray
        # A ray that grazes a crest may pass it by a hair; it still ends on the ground.
        assert place[2] == pytest.approx(float(hills.height(place)), abs=0.02 + 1e-4 * found)
        passed = position + np.arange(0.05, min(found, 400.0), 0.05)[:, None] * ray
        assert (passed[:, 2] - hills.height(passed)).min(initial=0.0) > -0.02 - 1e-4 * found
    elif np.isfinite(found):
        assert found > 395.0 or abs((position + found * ray)[2] - hills.height(position + found * ray)) < 0.05


def test_level_hills_are_the_plane() -> None:
    rays = np.random.default_rng(1).normal(size=(3, 5, 40)).astype(np.float32)
    rays /= np.linalg.norm(rays, axis=0)
    position = np.array([3.0, -8.0, 1.5])
    plane, hills = (meet_ground(ground, position, rays) for ground in (None, lay_hills(0.7, ())))
    near = plane.distance < 1000.0
    np.testing.assert_allclose(hills.distance[near], plane.distance[near], rtol=1e-4)
    np.testing.assert_allclose(hills.sine[near], plane.sine[near], atol=1e-5)
    assert np.array_equal(np.isinf(hills.distance), np.isinf(plane.distance))


def test_the_angle_to_the_ground_is_that_to_its_normal() -> None:
    hills = Hills(0.0, -100.0, 100.0, np.array([-20.0, 0.0, 20.0]))  # a slope of 20 %, straight
    ray = np.array([1.0, 0.0, -0.3]) / np.hypot(1.0, 0.3)
    hit = meet_ground(hills, np.array([0.0, 0.0, 2.0]), ray.astype(np.float32).reshape(3, 1, 1))
    normal = np.array([-0.2, 0.0, 1.0]) / np.hypot(1.0, 0.2)
    assert float(hit.sine[0, 0]) == pytest.approx(-float(ray @ normal), rel=1e-5)
    assert float(hit.distance[0, 0]) == pytest.approx(4.0 * np.hypot(1.0, 0.3), rel=1e-5)
