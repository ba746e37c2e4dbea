"""GeoKPM against exact geometry, and its controls on a street whose true views are known."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_generator.cameras import FthetaCamera, PinholeCamera
from olt_generator.errors import InputError
from olt_generator.metrics.cross_view_consistency import (
    MAX_SAMPSON_ERROR,
    METRIC_HEIGHT,
    METRIC_WIDTH,
    Consistency,
    PosedView,
    fundamental_matrix,
    join,
    measure_consistency,
    metric_camera,
    sampson_errors,
)
from olt_generator.metrics.matchers import Matches, SiftMatcher
from olt_generator.poses import camera_pose_in_rig, invert, planar_pose, transform
from olt_generator.seeds import make_generator
from olt_toolkit.benchmarks.street import render_street

WIDE = FthetaCamera.equidistant(416, 240, 207.5, 140.0, 205.0)
T_RIG_FRONT = camera_pose_in_rig([1.7, 0.0, 1.45], 0.0, 0.01, 0.0)
T_RIG_LEFT = camera_pose_in_rig([2.5, 0.94, 0.92], 0.0, 0.01, np.radians(66.0))
T_RIG_RIGHT = camera_pose_in_rig([2.5, -0.94, 0.92], 0.0, -0.02, np.radians(-66.0))
DRIVE = planar_pose(np.array([6.0]), 0.0, 0.0)


def film(T_rig_camera: np.ndarray) -> PosedView:
    poses = DRIVE @ T_rig_camera
    return PosedView(np.stack([render_street(WIDE, pose)[0] for pose in poses]), WIDE, poses)


@pytest.fixture(scope="module")
def front() -> PosedView:
    return film(T_RIG_FRONT)


class KnownMatches:
    """Finds the same given pixels in every pair of images."""

    name = "known"

    def __init__(self, pixels_a: np.ndarray, pixels_b: np.ndarray) -> None:
        self.matches = Matches(pixels_a, pixels_b)

    def match(self, image_a, image_b) -> Matches:
        assert image_a.shape == image_b.shape == (METRIC_HEIGHT, METRIC_WIDTH, 3)
        return self.matches


@pytest.mark.parametrize("T_rig_side", [T_RIG_LEFT, T_RIG_RIGHT])
def test_true_views_agree_and_a_copied_front_view_does_not(front, T_rig_side):
    side = film(T_rig_side)
    true = measure_consistency(front, side, SiftMatcher())
    assert true.percent is not None
    assert true.percent > 93.0
    assert true.matches.min() > 30
    copied = measure_consistency(front, replace(side, images=front.images), SiftMatcher())
    assert copied.percent is not None
    assert copied.percent < 3.0
    assert copied.matches.min() > 300


def test_views_of_different_moments_agree_through_the_poses(front):
    """A side camera that is 0.1 s late: its images agree with its own poses and not with those of the front."""
    late = planar_pose(np.array([7.5]), 0.0, 0.0) @ T_RIG_RIGHT
    side = PosedView(np.stack([render_street(WIDE, pose)[0] for pose in late]), WIDE, late)
    right = measure_consistency(front, side, SiftMatcher()).percent
    wrong = measure_consistency(front, replace(side, T_world_camera=DRIVE @ T_RIG_RIGHT), SiftMatcher()).percent
    assert right is not None
    assert wrong is not None
    assert right > 90.0
    assert right > wrong + 10.0


seeds = st.integers(0, 2**32 - 1)
yaws = st.floats(-1.2, 1.2)


def pair_of_cameras(seed: int, yaw: float):
    """Two pinhole cameras, the pose of a in b, and pixels (n, 2) of points that both see."""
    generator = make_generator("pair", seed)
    camera_a = PinholeCamera.from_field_of_view(METRIC_WIDTH, METRIC_HEIGHT, generator.uniform(0.8, 2.0))
    camera_b = PinholeCamera.from_field_of_view(METRIC_WIDTH, METRIC_HEIGHT, generator.uniform(0.8, 2.0))
    T_rig_a = camera_pose_in_rig(generator.normal(size=3), 0.0, 0.0, 0.0)
    T_rig_b = camera_pose_in_rig(T_rig_a[:3, 3] + generator.normal(size=3), 0.05, generator.normal(0.0, 0.1), yaw)
    T_b_a = invert(T_rig_b) @ T_rig_a
    points_a = camera_a.rays(generator.uniform(0, [METRIC_WIDTH, METRIC_HEIGHT], (500, 2)))
    points_a *= generator.uniform(3.0, 80.0, (500, 1))
    pixels_a, _ = camera_a.project(points_a)
    pixels_b, seen = camera_b.project(transform(T_b_a, points_a))
    return camera_a, camera_b, T_b_a, pixels_a[seen], pixels_b[seen]


@given(seeds, yaws)
def test_points_that_both_cameras_see_have_no_sampson_error(seed, yaw):
    camera_a, camera_b, T_b_a, pixels_a, pixels_b = pair_of_cameras(seed, yaw)
    fundamental = fundamental_matrix(camera_a, camera_b, T_b_a)
    assert np.all(sampson_errors(fundamental, Matches(pixels_a, pixels_b)) < 1e-6)


@given(seeds, yaws)
def test_sampson_error_does_not_depend_on_the_order_or_scale(seed, yaw):
    camera_a, camera_b, T_b_a, pixels_a, pixels_b = pair_of_cameras(seed, yaw)
    pixels_b = pixels_b + make_generator("noise", seed).normal(0.0, 20.0, pixels_b.shape)
    there = sampson_errors(fundamental_matrix(camera_a, camera_b, T_b_a), Matches(pixels_a, pixels_b))
    T_a_b = invert(T_b_a)
    T_a_b[:3, 3] *= 7.0
    back = sampson_errors(fundamental_matrix(camera_b, camera_a, T_a_b), Matches(pixels_b, pixels_a))
    np.testing.assert_allclose(there, back, rtol=1e-6, atol=1e-9)


def test_sampson_error_of_a_sideways_pair_is_the_row_offset_over_root_two():
    """Two parallel cameras side by side: epipolar lines are rows, and both ends share the correction."""
    camera = PinholeCamera.from_field_of_view(METRIC_WIDTH, METRIC_HEIGHT, 1.5)
    T_b_a = invert(camera_pose_in_rig([0, -1, 0], 0, 0, 0)) @ camera_pose_in_rig([0, 0, 0], 0, 0, 0)
    matches = Matches(np.array([[100.0, 200.0], [500.0, 40.0]]), np.array([[60.0, 203.0], [40.0, 26.0]]))
    errors = sampson_errors(fundamental_matrix(camera, camera, T_b_a), matches)
    np.testing.assert_allclose(errors, np.array([3.0, 14.0]) / np.sqrt(2.0))


def test_ten_pixels_divide_valid_from_invalid():
    camera = PinholeCamera.from_field_of_view(METRIC_WIDTH, METRIC_HEIGHT, 1.5)
    images = np.full((1, METRIC_HEIGHT, METRIC_WIDTH, 3), 90, np.uint8)
    a = PosedView(images, camera, camera_pose_in_rig([0, 0, 0], 0, 0, 0)[None])
    b = PosedView(images, camera, camera_pose_in_rig([0, -1, 0], 0, 0, 0)[None])
    offsets = np.sqrt(2.0) * np.array([0.0, MAX_SAMPSON_ERROR - 0.01, MAX_SAMPSON_ERROR + 0.01, 50.0])
    rows = 100.0 + offsets
    matcher = KnownMatches(np.full((4, 2), 100.0), np.column_stack([np.full(4, 80.0), rows]))
    found = measure_consistency(a, b, matcher)
    assert found.matches.tolist() == [4]
    assert found.valid.tolist() == [2]
    assert found.percent == pytest.approx(50.0)


def test_matches_outside_of_what_a_view_shows_do_not_count():
    lens = FthetaCamera.equidistant(416, 240, 207.5, 119.5, 205.0)
    narrow = lens.cropped(0, 60, 416, 120)  # black above and below once undistorted
    images = np.full((1, 120, 416, 3), 90, np.uint8)
    a = PosedView(images, narrow, T_RIG_FRONT[None])
    b = PosedView(images, narrow, T_RIG_LEFT[None])
    inside, black, outside = [416.0, 240.0], [416.0, 20.0], [900.0, 240.0]
    pixels = np.array([inside, black, outside])
    assert measure_consistency(a, b, KnownMatches(pixels, pixels)).matches.tolist() == [1]


def test_the_mean_is_over_moments_with_matches_and_counts_the_others():
    first = Consistency(matches=np.array([10, 0, 2]), valid=np.array([10, 0, 1]))
    assert first.percent == pytest.approx(75.0)
    assert first.moments_without_match == 1
    second = Consistency(matches=np.array([4]), valid=np.array([0]))
    assert join([first, second]).percent == pytest.approx(50.0)
    nothing = Consistency(matches=np.array([0, 0]), valid=np.array([0, 0]))
    assert nothing.percent is None
    assert join([nothing, nothing]).moments_without_match == 4


def test_images_without_texture_have_no_matches():
    flat = np.full((1, 240, 416, 3), 90, np.uint8)
    a, b = (PosedView(flat, WIDE, pose[None]) for pose in (T_RIG_FRONT, T_RIG_LEFT))
    assert measure_consistency(a, b, SiftMatcher()).percent is None


def test_metric_camera_keeps_the_field_of_view_up_to_120_degrees():
    assert metric_camera(PinholeCamera.from_field_of_view(1242, 375, 1.4)).fx == pytest.approx(
        0.5 * METRIC_WIDTH / np.tan(0.7)
    )
    wide = metric_camera(FthetaCamera.equidistant(400, 300, 199.5, 149.5, 400 / np.radians(150.0)))
    assert wide == PinholeCamera.from_field_of_view(METRIC_WIDTH, METRIC_HEIGHT, np.radians(120.0))


def test_views_from_one_point_or_of_different_length_are_refused(front):
    with pytest.raises(InputError, match="one point"):
        measure_consistency(front, front, SiftMatcher())
    with pytest.raises(InputError, match="1 and 0 images"):
        measure_consistency(front, replace(front, images=front.images[:0]), SiftMatcher())


def test_matches_do_not_depend_on_what_was_matched_before():
    pictures = make_generator("matched").integers(0, 256, (70, 24, 32, 3), dtype=np.uint8)
    pictures = np.stack([cv2.resize(picture, (128, 96), interpolation=cv2.INTER_CUBIC) for picture in pictures])
    # The same bytes, of another shape.
    flat = pictures[0].reshape(128, 96, 3)
    matcher = SiftMatcher()
    for first, second in [*zip(pictures, np.roll(pictures, 2, axis=2), strict=True), (flat, flat), (pictures[0],) * 2]:
        found, fresh = matcher.match(first, second), SiftMatcher().match(first, second)
        assert len(fresh) > 10
        np.testing.assert_array_equal(found.pixels_a, fresh.pixels_a)
        np.testing.assert_array_equal(found.pixels_b, fresh.pixels_b)
