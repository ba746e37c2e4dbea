import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_sft_recipes.toy.birds_eye import HEIGHTS, OFFSETS, ROUTE_OFFSETS, STATIONS, TOLD, look_up, route_cells
from olt_sft_recipes.toy.config import PATCH, ToyPolicyConfig
from olt_toolkit.rigs.rig_files import pav_rig

CONFIG = ToyPolicyConfig()
UNKNOWN = np.full((20, 2), np.nan)
STANDING = np.zeros((1, 2, 3))


def place_by_hand(point, camera, height):
    """Row and column of features where the lens itself puts a point of the ground plan; None where it is not seen."""
    mounted = pav_rig().fitted(CONFIG.image_width, CONFIG.image_height)[CONFIG.camera_names[camera]]
    R, t = mounted.T_rig_camera[:3, :3], mounted.T_rig_camera[:3, 3]
    pixel, seen = mounted.camera.project((np.array([*point, height]) - t) @ R)
    row, column = (pixel[1] + 0.5 - CONFIG.image_top) / PATCH - 0.5, (pixel[0] + 0.5) / PATCH - 0.5
    return (row, column) if seen and row >= -0.5 else None


@given(x=st.floats(4.0, 50.0), y=st.floats(-30.0, 30.0))
def test_a_cell_is_looked_up_where_the_lenses_see_it(x, y):
    # The table of places has a step of a quarter of a metre.
    point = np.round(np.array([x, y]) * 4.0) / 4.0
    weights = look_up(point[None, None], STANDING, CONFIG)[[1]].toarray().ravel()
    rows, columns = CONFIG.feature_size
    weights = weights.reshape(2, len(CONFIG.camera_rows), rows, columns, len(HEIGHTS))
    assert not weights[0].any(), "the row of the second frame takes features of the second frame alone"
    places = {
        (camera, index): place_by_hand(point, camera, height)
        for camera in range(len(CONFIG.camera_rows))
        for index, height in enumerate(HEIGHTS)
    }
    seen = {key: place for key, place in places.items() if place is not None}
    assert weights.sum() == pytest.approx(1.0 if seen else 0.0, abs=1e-5)
    for (camera, index), place in places.items():
        part = weights[1, camera, ..., index]
        if place is None:
            assert not part.any()
            continue
        middle = [np.average(np.arange(size), weights=part.sum(axis=1 - axis)) for axis, size in enumerate(part.shape)]
        assert np.allclose(middle, np.clip(place, 0.0, [rows - 1, columns - 1]), atol=0.02)


def test_an_earlier_frame_is_looked_up_from_where_the_vehicle_was():
    cell = np.array([[[20.0, 3.0]]])
    moved = np.array([[[-2.5, 0.0, 0.0], [0.0, 0.0, 0.0]]])
    then, now = look_up(cell, moved, CONFIG)[[0]], look_up(cell + np.array([2.5, 0.0]), STANDING, CONFIG)[[0]]
    assert np.array_equal(then.toarray(), now.toarray())


def test_cells_of_a_straight_route_are_a_rectangle():
    route = np.column_stack([np.linspace(0.0, 80.0, 20), np.full(20, 1.0)])
    cells = route_cells(route, curvature=0.3)
    assert np.allclose(cells[..., 0], STATIONS[:, None]) and np.allclose(cells[..., 1], 1.0 + ROUTE_OFFSETS)
    assert np.array_equal(ROUTE_OFFSETS[TOLD], OFFSETS)
    assert np.allclose(cells[..., 2], 0.0)


def test_without_a_route_cells_follow_the_present_turn():
    curvature = 0.02
    cells = route_cells(UNKNOWN, curvature)[STATIONS > 0.0]
    radius = np.hypot(cells[:10, :, 0], cells[:10, :, 1] - 1.0 / curvature)
    assert np.allclose(radius, 1.0 / curvature - ROUTE_OFFSETS, atol=0.2)


def test_a_mirrored_route_has_mirrored_cells():
    route = np.column_stack([20.0 * np.sin(np.linspace(0.0, 1.2, 20)), 20.0 - 20.0 * np.cos(np.linspace(0.0, 1.2, 20))])
    flip = np.array([1.0, -1.0, -1.0])
    assert np.allclose(route_cells(route * flip[:2], 0.0), route_cells(route, 0.0)[:, ::-1] * flip)
