"""Meshes drawn from elsewhere show their surfaces at the right distance, whole, and nothing between them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_generator.cameras import FthetaCamera, PinholeCamera, pixel_rays
from olt_generator.poses import make_pose, pose_from_quaternion
from olt_generator.views.surface_mesh import INFINITY, build_mesh, draw_mesh

CAMERA = PinholeCamera.from_field_of_view(160, 100, float(np.radians(80.0)))
WIDE = FthetaCamera.equidistant(144, 80, 71.0, 41.0, 70.0)


def wall(camera, depth: float) -> np.ndarray:
    """Distance (h, w) to a wall square to the axis."""
    return (depth / np.maximum(pixel_rays(camera)[..., 2], 0.05)).astype(np.float32)


@settings(max_examples=20, deadline=None)
@given(
    depth=st.floats(5.0, 40.0),
    turn=st.tuples(st.floats(-0.15, 0.15), st.floats(-0.3, 0.3), st.floats(-0.1, 0.1)),
    move=st.tuples(st.floats(-1.5, 1.5), st.floats(-0.5, 0.5), st.floats(-3.0, 3.0)),
    target=st.sampled_from([CAMERA, WIDE]),
    step=st.integers(1, 4),
)
def test_a_wall_is_drawn_where_it_is(depth, turn, move, target, step):
    T_target_camera = pose_from_quaternion([*turn, 1.0], move)
    drawn = draw_mesh(build_mesh(wall(CAMERA, depth), CAMERA, step), target, T_target_camera)
    shown = np.isfinite(drawn)
    assert shown.mean() > 0.1
    # The plane z = depth of the camera, cut by the rays of the target.
    rotation, translation = T_target_camera[:3, :3], T_target_camera[:3, 3]
    normal = rotation[:, 2]
    expected = (depth + normal @ translation) / (pixel_rays(target) @ normal)
    # A point lies up to half a pixel and a bit beside the pixel's middle.
    assert np.quantile(np.abs(drawn[shown] / expected[shown] - 1.0), 0.99) < 0.04


def test_a_wall_that_is_enlarged_has_no_gaps():
    nearer = make_pose(np.eye(3), [0.0, 0.0, -6.0])
    drawn = draw_mesh(build_mesh(wall(CAMERA, 8.0), CAMERA, 2), CAMERA, nearer)
    assert np.isfinite(drawn).all()


def test_what_was_seen_too_coarsely_is_not_drawn():
    nearer = make_pose(np.eye(3), [0.0, 0.0, -7.5])
    assert not np.isfinite(draw_mesh(build_mesh(wall(CAMERA, 8.0), CAMERA, 2), CAMERA, nearer)).any()


def test_nothing_joins_two_surfaces_and_the_nearer_hides():
    distance = wall(CAMERA, 20.0)
    distance[:, 60:100] = wall(CAMERA, 5.0)[:, 60:100]
    mesh = build_mesh(distance, CAMERA)
    aside = make_pose(np.eye(3), [2.0, 0.0, 0.0])
    depth = draw_mesh(mesh, CAMERA, aside) * pixel_rays(CAMERA)[..., 2]
    shown = np.isfinite(depth)
    near, far = np.abs(depth - 5.0) < 0.3, np.abs(depth - 20.0) < 1.0
    assert (near | far)[shown].all()
    assert near.any()
    # What the near wall hid from the frame is a gap.
    assert not shown[50].all()


def test_noise_leaves_no_trace():
    random = np.random.default_rng(5)
    noise = random.uniform(3.0, 60.0, (100, 160)).astype(np.float32)
    assert np.isfinite(draw_mesh(build_mesh(noise, CAMERA), CAMERA, np.eye(4))).mean() < 0.002


def test_a_wall_is_not_seen_from_behind():
    behind = make_pose(np.diag([-1.0, 1.0, -1.0]), [0.0, 0.0, 16.0])
    assert not np.isfinite(draw_mesh(build_mesh(wall(CAMERA, 8.0), CAMERA), CAMERA, behind)).any()


def test_the_far_is_turned_and_not_moved():
    sky = np.full((100, 160), np.inf, np.float32)
    moved = make_pose(np.eye(3), [30.0, -5.0, 40.0])
    drawn = draw_mesh(build_mesh(sky, CAMERA), CAMERA, moved)
    assert (drawn > 0.9 * INFINITY)[2:-2, 2:-2].all()


@pytest.mark.parametrize("unknown", [np.nan])
def test_what_is_not_known_is_not_drawn(unknown):
    distance = np.full((100, 160), unknown, np.float32)
    assert not np.isfinite(draw_mesh(build_mesh(distance, CAMERA), CAMERA, np.eye(4))).any()


def test_a_mesh_out_of_view_is_empty():
    away = make_pose(np.diag([-1.0, 1.0, -1.0]), [0.0, 0.0, 0.0])
    assert not np.isfinite(draw_mesh(build_mesh(wall(CAMERA, 8.0), CAMERA), CAMERA, away)).any()
