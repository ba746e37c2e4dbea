"""Position along a path."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_toolkit.policy.route import (
    LOOK_AHEAD,
    ROUTE_LENGTH,
    ROUTE_POINTS,
    PathTracker,
    route_ahead,
    routes_ahead,
)


def test_progress_does_not_jump_where_a_path_passes_twice():
    angle = np.linspace(0.0, 4.0 * np.pi, 401)
    loop = 20.0 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    tracker = PathTracker(loop)
    reached = np.array([tracker.advance(point) for point in loop])
    assert np.all(np.diff(reached) >= 0.0)
    assert np.diff(reached).max() < 1.0
    assert reached[-1] == pytest.approx(tracker.length)


@settings(max_examples=30)
@given(offset=st.floats(0.0, 3.9), step=st.floats(0.1, 2.0))
def test_progress_gets_around_a_cut_corner(offset, step):
    tracker = PathTracker(np.array([[0.0, 0.0], [30.0, 0.0], [30.0, 30.0]]))
    for x in np.arange(0.0, 30.0 - offset, step):
        tracker.advance(np.array([x, offset]))
    for y in np.arange(offset, 30.0, step):
        tracker.advance(np.array([30.0 - offset, y]))
    assert tracker.arc_length == pytest.approx(30.0 + y, abs=1e-6)


def nearest_between(path, point, low, high):
    """Arc length and distance of the nearest point of a path between two arc lengths, by trying every segment."""
    best, start = (np.inf, low), 0.0
    for begin, end in itertools.pairwise(path):
        length = float(np.linalg.norm(end - begin))
        if length and start + length >= low and start <= high:
            along = np.clip((point - begin) @ (end - begin) / length, max(low - start, 0.0), min(high - start, length))
            best = min(best, (float(np.linalg.norm(point - begin - along / length * (end - begin))), start + along))
        start += length
    return best[1], best[0]


@settings(max_examples=100)
@given(seed=st.integers(0, 100_000))
def test_the_nearest_point_within_reach_is_taken(seed):
    generator = np.random.default_rng(seed)
    path = np.cumsum(generator.normal(scale=3.0, size=(generator.integers(2, 30), 2)), axis=0)
    path = np.repeat(path, generator.integers(1, 3, len(path)), axis=0)
    tracker, last, reached = PathTracker(path), path[0], 0.0
    assert tracker.length == pytest.approx(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    for point in path[0] + np.cumsum(generator.normal(scale=2.0, size=(20, 2)), axis=0):
        reach = LOOK_AHEAD + 2.0 * np.linalg.norm(point - last)
        expected, distance = nearest_between(path, point, reached, min(reached + reach, tracker.length))
        reached, last = tracker.advance(point), point
        assert tracker.distance == pytest.approx(distance, abs=1e-9)
        assert reached == tracker.arc_length == pytest.approx(expected, abs=1e-6)
    anywhere = path[0] + generator.normal(scale=10.0, size=2)
    tracker.start_at(anywhere)
    expected = nearest_between(path, anywhere, 0.0, tracker.length)
    assert (tracker.arc_length, tracker.distance) == pytest.approx(expected, abs=1e-6)


def test_a_detour_is_followed_for_twice_the_movement_and_four_metres():
    detour = PathTracker(np.array([[0.0, 0.0], [0.0, 6.0], [6.0, 6.0], [6.0, 0.0], [20.0, 0.0]]))
    assert detour.advance(np.array([6.0, 0.0])) == pytest.approx(4.0 + 2.0 * 6.0)
    assert detour.distance == pytest.approx(2.0)


def test_who_stands_does_not_reach_the_way_back_beside_it():
    hairpin = PathTracker(np.array([[0.0, 0.0], [2.5, 0.0], [2.5, 0.1], [-10.0, 0.1]]))
    assert hairpin.advance(np.array([0.0, 0.09])) == 0.0
    assert hairpin.distance == pytest.approx(0.09)


def test_points_ahead_end_with_the_path():
    with np.errstate(all="raise"):  # a point that stands twice is no segment
        tracker = PathTracker(np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 0.0], [3.0, 4.0]]))
    tracker.advance(np.array([1.0, 0.5]))
    ahead = tracker.points_ahead(np.array([0.0, 1.0, 4.0, 6.0, 6.001]))
    np.testing.assert_allclose(ahead, [[1.0, 0.0], [2.0, 0.0], [3.0, 2.0], [3.0, 4.0]])


def test_a_path_of_one_point_is_as_far_as_that_point():
    tracker = PathTracker(np.array([[1.0, 2.0], [1.0, 2.0]]))
    assert (tracker.arc_length, tracker.distance) == (0.0, 0.0)
    assert (tracker.advance(np.array([4.0, 6.0])), tracker.distance, tracker.length) == (0.0, 5.0, 0.0)


def test_the_route_ahead_is_seen_from_the_rig():
    route = np.array([[0.0, 0.0], [50.0, 0.0], [50.0, 100.0]])
    poses = np.array([[10.0, 1.0, 0.0], [11.0, 1.0, 0.0], [50.0, 60.0, np.pi / 2]])
    ahead = routes_ahead(route, poses[:2])
    assert ahead.shape == (2, ROUTE_POINTS, 2)
    np.testing.assert_allclose(ahead[0, 0], (0.0, -1.0), atol=1e-9)
    step = ROUTE_LENGTH / (ROUTE_POINTS - 1)
    np.testing.assert_allclose(ahead[1, 1], (step, -1.0), atol=1e-9)
    np.testing.assert_allclose(ahead[0, -1], (40.0, ROUTE_LENGTH - 40.0 - 1.0), atol=1e-9)
    # It ends 40 m ahead: what lies beyond is not known.
    last = routes_ahead(route, poses[2:])[0]
    inside = step * np.arange(ROUTE_POINTS) <= 40.0
    np.testing.assert_allclose(last[inside, 0], step * np.arange(ROUTE_POINTS)[inside], atol=1e-9)
    assert np.isnan(last[~inside]).all()


def test_no_route_is_not_a_number():
    assert np.isnan(route_ahead(None, 1.0, 2.0, 0.5)).all()
