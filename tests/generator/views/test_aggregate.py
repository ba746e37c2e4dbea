"""What frames show of another view: which of them wins, and how they are joined."""

import numpy as np
import pytest

from olt_generator.cameras import PinholeCamera, pixel_rays
from olt_generator.distance.depth import road_distance
from olt_generator.poses import camera_pose_in_rig, invert, planar_pose, transform
from olt_generator.views.aggregate import Gathered, SourceFrame, gather
from olt_generator.views.surface_mesh import build_mesh

CAMERA = PinholeCamera.from_field_of_view(160, 100, float(np.radians(70.0)))
T_RIG_CAMERA = camera_pose_in_rig([1.7, 0.0, 1.45], 0.0, 0.0, 0.0)
NOTHING = np.full((100, 160), np.nan, np.float32)
FRONT = PinholeCamera.from_field_of_view(320, 180, np.radians(90.0))
SIDE = PinholeCamera.from_field_of_view(160, 90, np.radians(90.0))
T_RIG_SIDE = camera_pose_in_rig([2.5, 0.9, 0.9], 0.0, 0.1, np.radians(66.0))


def frame(colour: int | np.ndarray, distance: np.ndarray, T_target_camera: np.ndarray | None = None) -> SourceFrame:
    image = np.broadcast_to(np.asarray(colour, np.uint8), (*distance.shape, 3)).copy()
    camera = CAMERA if distance.shape == (100, 160) else FRONT
    T = np.eye(4) if T_target_camera is None else T_target_camera
    return SourceFrame(image, distance, build_mesh(distance, camera, 2), T)


def wall(depth: float) -> np.ndarray:
    """Distance to a wall ahead, above the horizon only, so that no road is meant."""
    distance = (depth / pixel_rays(CAMERA)[..., 2]).astype(np.float32)
    distance[50:] = np.nan
    return distance


EMPTY = frame(0, NOTHING)


def see(same: SourceFrame, others: list[SourceFrame]) -> Gathered:
    return gather(same, others, CAMERA, CAMERA, T_RIG_CAMERA)


def middle(seen: Gathered) -> list[int]:
    return np.unique(seen.image[15:35, 40:120]).tolist()


def test_the_nearest_of_the_others_wins_in_any_order():
    near, far = frame(200, wall(8.0)), frame(90, wall(16.0))
    assert middle(see(EMPTY, [near, far])) == [200]
    assert middle(see(EMPTY, [far, near])) == [200]


def test_the_same_frame_wins_even_where_it_shows_something_farther():
    seen = see(frame(90, wall(16.0)), [frame(200, wall(8.0))])
    assert middle(seen) == [90]
    assert seen.from_same[15:35, 40:120].all()


def test_of_one_surface_the_frame_nearest_to_it_counts_most():
    """Frames 8 and 16 m from a wall, the latter 8 m behind the camera."""
    back = np.eye(4)
    back[2, 3] = -8.0
    seen = see(EMPTY, [frame(90, wall(16.0), back), frame(200, wall(8.0))])
    assert np.abs(seen.image[20:30, 60:100].astype(int) - 200).max() <= 8


def test_frames_of_one_surface_fade_into_one_another():
    """The right half of the view is shown by one frame alone: no step is larger than the fade makes it."""
    left = wall(8.0)
    left[:, 80:] = np.nan
    seen = see(EMPTY, [frame(100, left), frame(160, wall(8.0))])
    row = seen.image[25, 20:140, 0].astype(int)
    assert row[0] in range(125, 136)
    assert row[-1] == 160
    assert np.abs(np.diff(row)).max() <= 12
    same = see(frame(100, left), [frame(160, wall(8.0))]).image[25, 20:140, 0].astype(int)
    assert same[0] == 100
    assert same[-1] == 160
    assert np.abs(np.diff(same)).max() <= 16


def test_brightness_is_matched_and_saturates():
    bright = SourceFrame(*list(vars(frame(100, wall(8.0))).values())[:4], 1.5)
    assert middle(see(EMPTY, [bright])) == [150]
    assert middle(see(EMPTY, [SourceFrame(*list(vars(frame(200, wall(8.0))).values())[:4], 1.5)])) == [255]


def test_patches_that_touch_nothing_are_dropped_but_not_those_at_the_same_frame():
    patch = NOTHING.copy()
    patch[20:28, 60:69] = wall(8.0)[20:28, 60:69]
    alone = see(EMPTY, [frame(200, patch)])
    assert not np.isfinite(alone.distance).any()
    assert not alone.image.any()
    beside = wall(8.0)
    beside[:, 64:] = np.nan
    larger = NOTHING.copy()
    larger[16:32, 56:72] = wall(8.0)[16:32, 56:72]
    seen = see(frame(90, beside), [frame(200, larger)])
    assert (np.isfinite(seen.distance) & ~seen.from_same).any()


def test_distances_that_disagree_leave_no_specks():
    random = np.random.default_rng(3)
    leaves = np.where(random.random((100, 160)) < 0.5, wall(8.0), wall(20.0)).astype(np.float32)
    assert np.isfinite(see(EMPTY, [frame(200, leaves)]).distance).mean() < 0.01


def test_what_is_infinitely_far_is_turned_and_not_moved():
    image = np.random.default_rng(1).integers(0, 256, (100, 160, 3)).astype(np.uint8)
    sky = np.full((100, 160), np.inf, np.float32)
    sky[50:] = np.nan
    moved = np.eye(4)
    moved[:3, 3] = 5.0, -2.0, 30.0
    seen = see(EMPTY, [frame(image, sky, moved)])
    shown = np.isfinite(seen.distance)
    assert shown[4:46, 4:156].all()
    assert (seen.distance[shown] > 1e5).all()
    assert np.abs(seen.image[4:46, 4:156].astype(int) - image[4:46, 4:156]).max() <= 1


def test_nothing_is_shown_of_what_must_not_be_taken():
    seen = see(EMPTY, [EMPTY])
    assert not np.isfinite(seen.distance).any()
    assert not seen.image.any()
    assert not seen.from_same.any()


def stripes(camera, T_world_camera, T_rig_camera):
    """A road painted in metres: red tells x, green tells y."""
    distance = np.minimum(road_distance(camera, T_rig_camera), 1e3)
    places = transform(T_world_camera, (pixel_rays(camera) * distance[..., None]).reshape(-1, 3))
    image = np.zeros((*distance.shape, 3), np.uint8)
    image[..., :2] = np.clip(6.0 * places.reshape(*distance.shape, 3)[..., :2] + 120.0, 0.0, 255.0)
    return image


def road(x: float, factor: float = 1.0) -> SourceFrame:
    """What the front camera shows of the road from `x` metres ahead of the rig."""
    T_world_camera = planar_pose(x, 0.0, 0.0) @ T_RIG_CAMERA
    distance = road_distance(FRONT, T_RIG_CAMERA)
    distance = np.where(distance < 100.0, factor * distance, np.float32(np.nan)).astype(np.float32)
    return frame(stripes(FRONT, T_world_camera, T_RIG_CAMERA), distance, invert(T_RIG_SIDE) @ T_world_camera)


@pytest.mark.parametrize("size", [(160, 90), (480, 270)])
def test_road_has_the_colours_of_its_places(size):
    target = SIDE.resized(*size)
    empty = SourceFrame(
        *list(vars(road(-8.0)).values())[:1], np.full((180, 320), np.nan, np.float32), EMPTY.mesh, np.eye(4)
    )
    seen = gather(empty, [road(-8.0), road(-14.0)], FRONT, target, T_RIG_SIDE)
    shown = np.isfinite(seen.distance)
    assert 0.1 < shown.mean() < 0.6
    truth = stripes(target, T_RIG_SIDE, T_RIG_SIDE)
    assert np.abs(seen.image[shown].astype(int) - truth[shown]).max() <= 8


def test_road_is_not_looked_for_where_a_frame_sees_something_nearer():
    empty = SourceFrame(
        *list(vars(road(-8.0)).values())[:1], np.full((180, 320), np.nan, np.float32), EMPTY.mesh, np.eye(4)
    )
    seen = gather(empty, [road(-8.0, 0.6)], FRONT, SIDE, T_RIG_SIDE)
    shown = np.isfinite(seen.distance)
    road_there = road_distance(SIDE, T_RIG_SIDE)
    assert (seen.distance[shown] < 0.95 * road_there[shown]).all()
