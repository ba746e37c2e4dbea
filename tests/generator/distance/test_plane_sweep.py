"""The parts of the distance estimate: sweep, colours of the sky, and what stands on the road."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_generator.cameras import FthetaCamera, PinholeCamera, pixel_rays
from olt_generator.distance.background import FAR_DISTANCE, background_distance, road_distance
from olt_generator.distance.ground_contact import contact_distance
from olt_generator.distance.plane_sweep import PlaneSweep, choose_partners, normalize_contrast
from olt_generator.distance.sky import SkyColours
from olt_generator.poses import camera_pose_in_rig, planar_pose
from olt_generator.seeds import make_generator
from olt_toolkit.benchmarks.street import Box, render_street

PINHOLE = PinholeCamera.from_field_of_view(160, 96, float(np.radians(90.0)))
FTHETA = FthetaCamera.equidistant(160, 96, 79.5, 55.0, 85.0)
T_RIG_CAMERA = camera_pose_in_rig([1.7, 0.0, 1.5], 0.0, 0.0, 0.0)
WALL = Box((26.0, -60.0, 0.0), (30.0, 60.0, 40.0), (120, 120, 120))


@pytest.mark.parametrize("camera", [PINHOLE, FTHETA], ids=["pinhole", "f-theta"])
@pytest.mark.parametrize("neighbours", [1, 2])
def test_a_wall_ahead_is_found_at_its_distance(camera, neighbours):
    poses = planar_pose(0.8 * np.arange(9), 0.0, 0.0)
    images, distance = zip(*(render_street(camera, pose @ T_RIG_CAMERA, (WALL,)) for pose in poses), strict=True)
    grey = [image[..., 1] for image in images]
    sweep = PlaneSweep(grey, camera, poses @ T_RIG_CAMERA, T_RIG_CAMERA, planes=32, neighbours=neighbours)
    match = sweep.match(5, 0, camera.height)
    assert match is not None
    wall = np.isfinite(distance[5]) & (distance[5] < 0.9 * road_distance(camera, T_RIG_CAMERA))
    away_from_travel = np.abs(np.arange(camera.width) - 80) > 25
    clear = wall & away_from_travel & (match.runner_up - match.mismatch > 6.0)
    error = np.abs(match.distance - distance[5]) / distance[5]
    assert clear.mean() > 0.1
    assert np.median(error[clear]) < 0.04
    ground = ~wall & (distance[5] < 12.0)
    assert np.median(sweep.background_mismatch(5)[ground]) < 0.5 * np.median(sweep.background_mismatch(5)[clear])


def test_rows_can_be_swept_alone():
    poses = planar_pose(0.8 * np.arange(9), 0.0, 0.0)
    grey = [render_street(PINHOLE, pose @ T_RIG_CAMERA)[0][..., 1] for pose in poses]
    sweep = PlaneSweep(grey, PINHOLE, poses @ T_RIG_CAMERA, T_RIG_CAMERA, planes=16, neighbours=2)
    whole, part = sweep.match(4, 0, 96), sweep.match(4, 32, 80)
    assert whole is not None and part is not None
    # Interpolated warps and the windows at the cut differ a little.
    inner = slice(4, -4)
    same = np.abs(part.distance[inner] - whole.distance[32:80][inner]) < 0.05 * part.distance[inner]
    assert same.mean() > 0.95


def test_standing_still_matches_nothing():
    grey = [np.full((96, 160), 90, np.uint8)] * 4
    poses = np.repeat((np.eye(4) @ T_RIG_CAMERA)[None], 4, axis=0)
    sweep = PlaneSweep(grey, PINHOLE, poses, T_RIG_CAMERA, planes=8, neighbours=2)
    assert sweep.match(1, 0, 96) is None
    assert sweep.background_mismatch(1) is None


@given(gain=st.floats(0.5, 1.5), offset=st.floats(-20.0, 20.0))
def test_exposure_hardly_shows_after_normalising(gain, offset):
    texture = make_generator("texture").integers(60, 120, (40, 40)).astype(np.uint8)
    exposed = np.clip(gain * texture + offset, 0, 255).astype(np.uint8)
    difference = normalize_contrast(texture).astype(int) - normalize_contrast(exposed).astype(int)
    assert np.median(np.abs(difference)) < 16
    assert normalize_contrast(texture).min() >= 1


@given(steps=st.lists(st.floats(0.0, 5.0), min_size=1, max_size=30), index=st.integers(0, 29))
def test_partners_are_other_frames_that_lie_apart(steps, index):
    positions = np.stack([np.cumsum(steps), np.zeros(len(steps)), np.zeros(len(steps))], axis=1)
    index %= len(steps)
    for partners in choose_partners(positions, index, 2):
        assert len(partners) == len(set(partners)) <= 2
        assert all(np.linalg.norm(positions[partner] - positions[index]) >= 0.3 for partner in partners)


def test_colours_learn_the_sky():
    blue, green = np.array([90, 140, 220], np.uint8), np.array([60, 110, 50], np.uint8)
    image = np.where((np.arange(40) < 20)[:, None, None], blue, green) * np.ones((1, 30, 1), np.uint8)
    far = np.zeros((40, 30), np.bool_)
    near = far.copy()
    far[2:8], near[30:36] = True, True
    sky = SkyColours([(image, far, near)]).probability(image)
    assert sky[:20].min() > 0.9
    assert sky[20:].max() < 0.1
    assert SkyColours([]).probability(image).max() == 0.0


def test_upright_things_have_the_distance_of_their_foot():
    road = road_distance(PINHOLE, T_RIG_CAMERA)
    post = np.zeros(road.shape, np.bool_)
    post[20:70, 90] = True
    foot = contact_distance(post, road, PINHOLE, T_RIG_CAMERA)
    points = pixel_rays(PINHOLE)[20:70, 90] * foot[20:70, 90, None]
    assert np.ptp(np.hypot(points[:, 0], points[:, 2])) < 1e-3
    assert foot[69, 90] == pytest.approx(road[69, 90])
    assert np.all(np.isinf(foot[~post]))


def test_things_without_foot_on_the_road_have_no_distance():
    road = road_distance(PINHOLE, T_RIG_CAMERA)
    cloud = np.zeros(road.shape, np.bool_)
    cloud[5:20] = True
    assert np.all(np.isinf(contact_distance(cloud, road, PINHOLE, T_RIG_CAMERA)))


def test_the_background_ends_at_the_far():
    background = background_distance(PINHOLE, T_RIG_CAMERA)
    assert background.max() == FAR_DISTANCE
    assert np.array_equal(background < FAR_DISTANCE, road_distance(PINHOLE, T_RIG_CAMERA) < FAR_DISTANCE)
