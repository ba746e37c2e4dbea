"""Coherence falls with each planted fault, more with more of it, and says which it is."""

import cv2
import numpy as np
import pytest

from olt_generator.cameras import FthetaCamera
from olt_generator.errors import InputError
from olt_generator.metrics.coherence import WEIGHTS, Coherence, join_coherence, measure_coherence
from olt_generator.metrics.cross_view_consistency import PosedView
from olt_generator.poses import camera_pose_in_rig, planar_pose
from olt_toolkit.benchmarks.street import render_street

FRONT = FthetaCamera.equidistant(288, 160, 143.0, 90.0, 140.0)
T_RIG_FRONT = camera_pose_in_rig([1.7, 0.0, 1.45], 0.0, 0.01, 0.0)
T_RIG_LEFT = camera_pose_in_rig([2.5, 0.94, 0.92], 0.0, 0.01, np.radians(66.0))
DRIVE = planar_pose(np.array([0.0, 0.5, 1.0]), 0.0, 0.0)


def film(T_rig_camera: np.ndarray) -> PosedView:
    poses = DRIVE @ T_rig_camera
    return PosedView(np.stack([render_street(FRONT, pose)[0] for pose in poses]), FRONT, poses)


@pytest.fixture(scope="module")
def front() -> PosedView:
    return film(T_RIG_FRONT)


@pytest.fixture(scope="module")
def side() -> PosedView:
    return film(T_RIG_LEFT)


def specks(images: np.ndarray, count: int) -> np.ndarray:
    random = np.random.default_rng(7)
    specked = images.copy()
    for image in specked:
        for row, column in random.integers((157, 285), size=(count, 2)):
            image[row : row + 3, column : column + 3] = random.integers(0, 256, 3)
    return specked


def blur(images: np.ndarray, sigma: int) -> np.ndarray:
    return np.stack([cv2.GaussianBlur(image, (0, 0), sigma) for image in images])


def seam(images: np.ndarray, step: int) -> np.ndarray:
    brighter = images.astype(int)
    brighter[:, :, 144:] += step
    return np.clip(brighter, 0, 255).astype(np.uint8)


def flicker(images: np.ndarray, step: int) -> np.ndarray:
    changed = images.astype(int)
    changed[1] += step
    return np.clip(changed, 0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    ("fault", "strengths", "name"),
    [(specks, (300, 1500), "specks"), (blur, (1, 4), "blur"), (seam, (15, 50), "gap"), (flicker, (8, 40), "flicker")],
)
def test_more_of_a_fault_is_less_coherent_and_told_by_its_name(front, side, fault, strengths, name):
    found = [
        measure_coherence(PosedView(images, side.camera, side.T_world_camera), front)
        for images in (side.images, *(fault(side.images, strength) for strength in strengths))
    ]
    percents, penalties = [each.percent for each in found], [each.penalties[name] for each in found]
    assert percents == sorted(percents, reverse=True)
    assert percents[0] > percents[2] + 3.0
    assert penalties[2] > penalties[1] >= penalties[0]


def test_the_front_view_is_coherent_with_itself(front):
    found = measure_coherence(front, front)
    assert found.percent > 97.0
    assert found.agreement == pytest.approx(1.0, abs=1e-3)
    assert found.gap == pytest.approx(0.0, abs=0.5)


def test_another_place_does_not_agree(front, side):
    mirrored = PosedView(np.ascontiguousarray(side.images[:, ::-1, ::-1]), side.camera, side.T_world_camera)
    assert measure_coherence(mirrored, front).agreement < measure_coherence(side, front).agreement


def test_what_is_not_known_is_not_counted(front):
    behind = film(camera_pose_in_rig([0.0, 0.0, 1.4], 0.0, 0.0, np.pi))
    found = measure_coherence(PosedView(behind.images[:1], FRONT, behind.T_world_camera[:1]), _first(front))
    assert found.flicker is None
    assert found.agreement is None
    assert found.penalties["flicker"] is None
    assert found.penalties["gap"] is None
    assert 0.0 < found.percent <= 100.0


def _first(view: PosedView) -> PosedView:
    return PosedView(view.images[:1], view.camera, view.T_world_camera[:1])


def test_joined_values_are_means_of_those_that_are_known():
    one = Coherence(2.0, 4.0, None, None, 0.5, 8.0)
    other = Coherence(4.0, 4.0, 3.0, 2.0, None, None)
    assert join_coherence([one, other]) == Coherence(3.0, 4.0, 3.0, 2.0, 0.5, 8.0)
    assert set(one.penalties) == set(WEIGHTS)


def test_numbers_that_do_not_match_are_refused(front, side):
    with pytest.raises(InputError, match="views of 3 and 1 images"):
        measure_coherence(side, _first(front))
    none = PosedView(front.images[:0], FRONT, front.T_world_camera[:0])
    with pytest.raises(InputError, match="views of 0 and 0 images"):
        measure_coherence(none, none)
