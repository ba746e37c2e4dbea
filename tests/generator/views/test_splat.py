"""The splat against its plain reference, and where single points must land."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_generator.cameras import Camera, FthetaCamera, PinholeCamera
from olt_generator.errors import InputError
from olt_generator.poses import make_pose, pose_from_quaternion
from olt_generator.seeds import make_generator
from olt_generator.views.splat import Warp, land, splat, splat_reference

PINHOLE = PinholeCamera.from_field_of_view(40, 24, float(np.radians(80.0)))
WIDE = FthetaCamera.equidistant(40, 24, 18.0, 13.5, 20.0)
STILL = np.eye(4)


def same(a: Warp, b: Warp) -> bool:
    return all(np.array_equal(x, y) for x, y in zip(vars(a).values(), vars(b).values(), strict=True))


def painted(image, distance, source, target, T_target_source, radius=1) -> Warp:
    return splat_reference(image, land(distance, source, target, T_target_source, radius), target, radius)


def one_point(camera: Camera, row: int, column: int, distance: float) -> np.ndarray:
    distances = np.full((camera.height, camera.width), np.inf, np.float32)
    distances[row, column] = distance
    return distances


def noise_image(camera: Camera) -> np.ndarray:
    return make_generator("image").integers(0, 256, (camera.height, camera.width, 3)).astype(np.uint8)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    source=st.sampled_from([PINHOLE, WIDE]),
    target=st.sampled_from([PINHOLE, WIDE]),
    radius=st.integers(0, 2),
    levels=st.integers(1, 50),
)
def test_equals_the_painters_algorithm_bit_for_bit(seed, source, target, radius, levels):
    random = make_generator(seed)
    image = random.integers(0, 256, (24, 40, 3)).astype(np.uint8)
    # Few levels of distance make many ties; odd values stand for what depth networks and sensors return.
    distance = random.integers(1, levels + 1, (24, 40)).astype(np.float32)
    odd = np.array([np.nan, np.inf, -np.inf, -3.0, 0.0, 0.5, 200.0, 1e6, 1e-40], np.float32)
    distance = np.where(random.random((24, 40)) < 0.1, random.choice(odd, (24, 40)), distance)
    T_target_source = pose_from_quaternion([*random.normal(0.0, 0.2, 3), 1.0], random.normal(0.0, 0.5, 3))
    arguments = (image, distance, source, target, T_target_source, radius)
    assert same(splat(*arguments), painted(*arguments))


def test_equals_the_painters_algorithm_when_everything_ties():
    # All points are equally far, and four of them meet in every target pixel.
    distance = np.full((24, 40), 5.0, np.float32)
    target = PINHOLE.resized(20, 12)
    arguments = (noise_image(PINHOLE), distance, PINHOLE, target, STILL)
    assert same(splat(*arguments), painted(*arguments))


def test_identity_returns_the_image():
    image = noise_image(WIDE)
    warp = splat(image, np.full((24, 40), 7.0, np.float32), WIDE, WIDE, STILL, radius=0)
    assert warp.visible.all()
    assert np.array_equal(warp.image, image)
    assert np.allclose(warp.distance, 7.0)


@pytest.mark.parametrize("camera", [PINHOLE, WIDE])
def test_a_point_lands_where_its_projection_says(camera):
    T_target_source = make_pose(np.eye(3), [0.4, -0.2, 0.3])
    pixel = np.array([25.0, 9.0])
    point = 6.0 * camera.rays(pixel) + T_target_source[:3, 3]
    (u, v), _ = camera.project(point)
    warp = splat(noise_image(camera), one_point(camera, 9, 25, 6.0), camera, camera, T_target_source, radius=1)
    rows, columns = np.nonzero(warp.visible)
    assert sorted(set(rows)) == [round(v) - 1, round(v), round(v) + 1]
    assert sorted(set(columns)) == [round(u) - 1, round(u), round(u) + 1]
    assert warp.distance[round(v), round(u)] == pytest.approx(np.linalg.norm(point))


def test_the_nearest_surface_covers_the_far_one_whatever_the_order():
    for near_column, far_column in ((18, 22), (22, 18)):
        image = np.zeros((24, 40, 3), np.uint8)
        image[12, near_column], image[12, far_column] = 200, 90
        distance = np.full((24, 40), np.inf, np.float32)
        distance[12, near_column], distance[12, far_column] = 3.0, 4.0
        warp = splat(image, distance, PINHOLE, PINHOLE.resized(10, 6), STILL, radius=2)
        shared = warp.distance < 3.5
        assert shared.any()
        assert np.all(warp.image[shared] == 200)
        assert np.all(warp.image[warp.visible & ~shared] == 90)


def test_of_equally_near_points_the_first_in_the_image_wins():
    image = noise_image(PINHOLE)
    distance = np.full((24, 40), np.inf, np.float32)
    distance[10, 15] = distance[10, 24] = 5.0  # mirrored about the axis: exactly the same distance everywhere
    tiny = PinholeCamera(1, 1, 1e-3, 1e-3, 0.0, 0.0)
    warp = splat(image, distance, PINHOLE, tiny, STILL, radius=0)
    assert np.array_equal(warp.image[0, 0], image[10, 15])


def test_footprints_reach_in_from_outside():
    # The point projects half a pixel outside of the left edge.
    shifted = PINHOLE.cropped(11, 0, 29, 24)
    warp = splat(noise_image(PINHOLE), one_point(PINHOLE, 5, 10, 4.0), PINHOLE, shifted, STILL, radius=1)
    assert warp.visible[4:7, 0].all()
    assert warp.visible.sum() == 3


@pytest.mark.parametrize("distance", [np.nan, np.inf, -np.inf, -1.0, 0.0, 0.5, 200.0, 1e6])
def test_invalid_distances_are_dropped(distance):
    warp = splat(noise_image(WIDE), np.full((24, 40), distance, np.float32), WIDE, WIDE, STILL)
    assert not warp.visible.any()
    assert not warp.image.any()
    assert np.all(warp.distance == np.inf)


def test_surfaces_close_to_the_target_are_dropped():
    T_target_source = make_pose(np.eye(3), [0.0, 0.0, -4.8])  # the target stands 4.8 m further on
    distance = one_point(PINHOLE, 12, 20, 5.0)
    assert not splat(noise_image(PINHOLE), distance, PINHOLE, PINHOLE, T_target_source).visible.any()
    assert splat(noise_image(PINHOLE), distance, PINHOLE, PINHOLE, T_target_source, limits=(0.1, 200.0)).visible.any()


def test_large_coordinates_cost_nothing():
    """Only the relative pose enters, so a map position of 5000 km changes no byte."""
    T_world = make_pose(np.eye(3), [5e6, -3e6, 100.0])
    T_world_target, T_world_source = T_world, T_world @ make_pose(np.eye(3), [0.25, 0.5, 0.0])
    distance = make_generator("distance").uniform(2.0, 90.0, (24, 40)).astype(np.float32)
    near = splat(noise_image(WIDE), distance, WIDE, WIDE, make_pose(np.eye(3), [0.25, 0.5, 0.0]))
    far = splat(noise_image(WIDE), distance, WIDE, WIDE, np.linalg.inv(T_world_target) @ T_world_source)
    assert same(near, far)


def test_thread_count_does_not_matter():
    distance = make_generator("distance").uniform(2.0, 90.0, (24, 40)).astype(np.float32)
    T_target_source = make_pose(np.eye(3), [0.3, 0.1, -0.4])
    threads = cv2.getNumThreads()
    warps = []
    for count in (1, 4):
        cv2.setNumThreads(count)
        warps.append(splat(noise_image(WIDE), distance, WIDE, PINHOLE, T_target_source))
    cv2.setNumThreads(threads)
    assert same(*warps)


def test_sizes_that_do_not_match_are_refused():
    with pytest.raises(InputError, match="40 x 24"):
        splat(np.zeros((24, 41, 3), np.uint8), np.ones((24, 41), np.float32), WIDE, WIDE, STILL)
    with pytest.raises(InputError, match="distance"):
        splat(noise_image(WIDE), np.ones((24, 41), np.float32), WIDE, WIDE, STILL)


NARROW_TO_EXTREME = [
    PinholeCamera.from_field_of_view(40, 24, float(np.radians(174.9))),
    FthetaCamera.equidistant(40, 24, 19.5, 11.5, 40.0 / np.radians(175.0)),
]


@pytest.mark.parametrize("camera", NARROW_TO_EXTREME)
@pytest.mark.parametrize("baseline", [0.0, 100.0])
@pytest.mark.parametrize("along", [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
def test_extreme_lenses_baselines_and_distances(camera, baseline, along):
    distance = make_generator("extreme").uniform(0.6, 199.0, (24, 40)).astype(np.float32)
    distance[::3, ::5] = np.resize(np.array([0.0, -1.0, np.nan, np.inf, -np.inf, 1e6, 1e-38], np.float32), (8, 8))
    T_target_source = make_pose(np.eye(3), baseline * np.array(along))
    arguments = (noise_image(camera), distance, camera, camera, T_target_source)
    warp = splat(*arguments)
    assert same(warp, painted(*arguments))
    assert warp.visible.any()
    assert np.all(warp.distance[warp.visible] > 0.5)
    assert warp.distance[warp.visible].max() < 200.0 + baseline


@pytest.mark.parametrize("translation", [5e6, 1e30, np.inf, np.nan])
def test_targets_out_of_reach_see_nothing_behind_them(translation):
    """The camera has moved on by that much: everything lies behind it, or nowhere."""
    T_target_source = make_pose(np.eye(3), [0.0, 0.0, -translation])
    with np.errstate(over="ignore"):
        warp = splat(noise_image(PINHOLE), np.full((24, 40), 9.0, np.float32), PINHOLE, PINHOLE, T_target_source)
    assert not warp.visible.any()
