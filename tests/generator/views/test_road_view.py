"""Road looked up in other frames."""

import numpy as np
import pytest

from olt_generator.cameras import PinholeCamera, pixel_rays
from olt_generator.distance.depth import road_distance
from olt_generator.poses import camera_pose_in_rig, invert, planar_pose, transform
from olt_generator.views.aggregate import SourceFrame
from olt_generator.views.road_view import RoadView

FRONT = PinholeCamera.from_field_of_view(320, 180, np.radians(90.0))
SIDE = PinholeCamera.from_field_of_view(160, 90, np.radians(90.0))
T_RIG_FRONT = camera_pose_in_rig([1.7, 0.0, 1.45], 0.0, 0.0, 0.0)
T_RIG_SIDE = camera_pose_in_rig([2.5, 0.9, 0.9], 0.0, 0.1, np.radians(66.0))


def stripes(camera, T_world_camera, T_rig_camera):
    """A road painted in metres: red tells x, green tells y."""
    distance = np.minimum(road_distance(camera, T_rig_camera), 1e3)
    places = transform(T_world_camera, (pixel_rays(camera) * distance[..., None]).reshape(-1, 3)).reshape(
        *distance.shape, 3
    )
    image = np.zeros((*distance.shape, 3), np.uint8)
    image[..., :2] = np.clip(6.0 * places[..., :2] + 120.0, 0.0, 255.0)
    return image


def source(x):
    """What the front camera shows from `x` metres ahead of the rig."""
    T_world_camera = planar_pose(x, 0.0, 0.0) @ T_RIG_FRONT
    image = stripes(FRONT, T_world_camera, T_RIG_FRONT)
    return SourceFrame(image, road_distance(FRONT, T_RIG_FRONT), invert(T_RIG_SIDE) @ T_world_camera)


TRUTH = stripes(SIDE, T_RIG_SIDE, T_RIG_SIDE)


def test_road_has_the_colours_of_its_places():
    image, seen = RoadView(FRONT, SIDE, T_RIG_SIDE).look_up([source(-8.0)])
    assert 0.1 < seen.mean() < 0.6
    assert np.abs(image[seen].astype(int) - TRUTH[seen]).max() <= 8
    assert not image[~seen].any()


def test_a_large_view_shows_the_same_road():
    large = SIDE.resized(480, 270)
    image, seen = RoadView(FRONT, large, T_RIG_SIDE).look_up([source(-8.0)])
    truth = stripes(large, T_RIG_SIDE, T_RIG_SIDE)
    assert seen.sum() > 32_767
    assert np.abs(image[seen].astype(int) - truth[seen]).max() <= 8


def test_road_at_the_very_edge_of_a_frame_is_read_from_its_last_pixels():
    # A camera whose lowest rays just miss the last row by less than single precision tells apart.
    edge = PinholeCamera(8, 8, 4.0, 4.0, 3.5, 3.5)
    down = camera_pose_in_rig([0.0, 0.0, 1.0], 0.0, np.pi / 2, 0.0)
    target = PinholeCamera(8, 8, 4.0, 4.0, 3.5, 3.0 + 1e-9)
    whole = SourceFrame(np.full((8, 8, 3), 7, np.uint8), road_distance(edge, down), np.eye(4))
    image, seen = RoadView(edge, target, down).look_up([whole])
    assert seen.any()
    assert (image[seen] == 7).all()


def test_the_nearest_frame_wins_in_any_order():
    near, far = source(-6.0), source(-14.0)
    far = SourceFrame(np.full_like(far.image, 255), far.distance, far.T_target_camera)
    view = RoadView(FRONT, SIDE, T_RIG_SIDE)
    first, second = view.look_up([near, far]), view.look_up([far, near])
    assert np.array_equal(first[0], second[0])
    _, seen_near = view.look_up([near])
    assert np.array_equal(first[0][seen_near], view.look_up([near])[0][seen_near])


def test_road_behind_something_is_not_taken():
    open_road = source(-8.0)
    hidden = SourceFrame(open_road.image, 0.7 * open_road.distance, open_road.T_target_camera)
    assert not RoadView(FRONT, SIDE, T_RIG_SIDE).look_up([hidden])[1].any()


@pytest.mark.parametrize("distance", [np.nan, np.inf, 0.0, -1.0])
def test_what_is_not_known_is_not_taken(distance):
    unknown = source(-8.0)
    unknown = SourceFrame(unknown.image, np.full_like(unknown.distance, distance), unknown.T_target_camera)
    assert not RoadView(FRONT, SIDE, T_RIG_SIDE).look_up([unknown])[1].any()


def test_a_view_of_the_sky_shows_no_road():
    upwards = camera_pose_in_rig([2.5, 0.9, 0.9], 0.0, -np.pi / 2, 0.0)
    assert not RoadView(FRONT, SIDE, upwards).look_up([source(-8.0)])[1].any()
