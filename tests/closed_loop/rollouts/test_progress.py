"""Position along a path."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_closed_loop.rollouts.progress import PathTracker


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
