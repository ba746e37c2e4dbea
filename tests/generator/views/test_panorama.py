"""Road and sky run on where no frame shows them."""

import numpy as np

from olt_generator.cameras import PinholeCamera
from olt_generator.poses import camera_pose_in_rig
from olt_generator.views.panorama import Panorama

CAMERA = PinholeCamera.from_field_of_view(96, 64, float(np.radians(80.0)))
T_RIG_AHEAD = camera_pose_in_rig([1.7, 0.0, 1.4], 0.0, 0.0, 0.0)
T_RIG_BEHIND = camera_pose_in_rig([0.0, 0.0, 1.4], 0.0, 0.0, np.pi)
SKY, ROAD = (120, 160, 220), (90, 90, 95)
ALL, NONE = np.ones((64, 96), bool), np.zeros((64, 96), bool)
UPPER = np.arange(64)[:, None] < np.full(96, 32)


def half_and_half() -> np.ndarray:
    return np.where(UPPER[..., None], SKY, ROAD).astype(np.uint8)


def test_the_unseen_rear_looks_like_the_front():
    panorama = Panorama(CAMERA, T_RIG_BEHIND, CAMERA, T_RIG_AHEAD)
    background = panorama.background(np.zeros((64, 96, 3), np.uint8), NONE, NONE, half_and_half(), ALL, UPPER)
    np.testing.assert_allclose(background[:20], np.broadcast_to(SKY, (20, 96, 3)), atol=12)
    np.testing.assert_allclose(background[44:], np.broadcast_to(ROAD, (20, 96, 3)), atol=12)


def test_what_the_view_itself_knows_comes_first():
    image = np.full((64, 96, 3), 30, np.uint8)
    panorama = Panorama(CAMERA, T_RIG_BEHIND, CAMERA, T_RIG_AHEAD)
    background = panorama.background(image, ALL, UPPER, half_and_half(), ALL, UPPER)
    np.testing.assert_allclose(background, 30.0, atol=8.0)


def test_a_house_does_not_become_sky():
    """The left half above the horizon is a near house: only the sky on the right lends its colours."""
    image, far = half_and_half(), UPPER.copy()
    image[:32, :48], far[:, :48] = (200, 40, 40), False
    visible = np.broadcast_to(np.arange(96) < 72, (64, 96))
    blank = np.zeros((64, 96, 3), np.uint8)
    background = Panorama(CAMERA, T_RIG_AHEAD, CAMERA, T_RIG_AHEAD).background(image, visible, far, blank, NONE, NONE)
    assert np.abs(background[:20, 80:] - SKY).max() < 25


def test_nothing_known_gives_nothing():
    blank = np.zeros((64, 96, 3), np.uint8)
    assert Panorama(CAMERA, T_RIG_AHEAD, CAMERA, T_RIG_AHEAD).background(blank, NONE, NONE, blank, NONE, NONE) is None
