"""The turn of a step as a textured plane tells it, for rotations that were found too large or too small."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from olt_generator.cameras import PinholeCamera, pixel_rays
from olt_generator.motion.road_grid import RoadGrid, road_frame
from olt_generator.motion.road_turn import measure_turn

CAMERA = PinholeCamera.from_field_of_view(416, 240, np.radians(70.0))
HEIGHT, DRIVEN = 1.5, 1.2
FORWARD, UP = np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])
AXES = road_frame(FORWARD, UP, FORWARD)


def film(driven, heading=0.0, contrast=200.0):
    """Grey picture of a plane by a camera that drove so far along its first axis and now heads to the left."""
    noise = np.random.default_rng(1).standard_normal((1024, 1024)).astype(np.float32)
    texture = 128.0 + contrast * cv2.GaussianBlur(noise, (0, 0), 2.0)
    rays = pixel_rays(CAMERA) @ Rotation.from_rotvec(heading * UP).as_matrix().T
    down = np.maximum(rays[..., 1], 1e-3)
    along, across = driven + HEIGHT * rays[..., 2] / down, HEIGHT * rays[..., 0] / down
    places = [(value / 0.05 + 400.0).astype(np.float32) for value in (along, across)]
    picture = cv2.remap(texture, places[0], places[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    return np.clip(picture, 0, 255).astype(np.uint8)


def measure(second, found_turn):
    """The angle that is left when the camera is taken to have turned to the left by `found_turn`."""
    grid = RoadGrid(CAMERA, HEIGHT, AXES, np.zeros((240, 416), np.bool_))
    R_second_first = Rotation.from_rotvec(-found_turn * UP).as_matrix()
    later = grid.rectify(second, AXES.rotated(R_second_first))
    return measure_turn(grid.rectify(film(0.0), AXES), later, grid, DRIVEN)


@pytest.mark.parametrize("true", [-2.0, 0.0, 0.7])
@pytest.mark.parametrize("missed", [-0.8, -0.3, 0.0, 0.5])
def test_the_road_tells_by_how_much_a_turn_was_missed(true, missed):
    left = measure(film(DRIVEN, np.radians(true)), np.radians(true - missed))
    assert left is not None
    # A pixel of this camera is 0.17 degrees.
    assert np.degrees(left) == pytest.approx(missed, abs=0.17)


def test_a_road_without_texture_tells_no_turn():
    assert measure(film(DRIVEN, contrast=0.0), 0.0) is None


def test_what_does_not_move_as_one_road_tells_no_turn():
    scattered = np.random.default_rng(0).integers(0, 255, (240, 416)).astype(np.uint8)
    assert measure(cv2.GaussianBlur(scattered, (0, 0), 2.0), 0.0) is None
