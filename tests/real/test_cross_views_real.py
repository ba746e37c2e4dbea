"""Side views warped from a real front camera against the real side cameras; numbers are printed (`pytest -s`)."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from olt_generator.distance.depth import estimate_distance
from olt_generator.metrics.image_metrics import psnr
from olt_generator.poses import invert
from olt_generator.views.front_view import FrontView
from olt_generator.views.moving_objects import check_distances
from olt_generator.views.synthesis import PixelOrigin, SynthesisSettings, synthesize_view

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def front(six_cameras):
    record = six_cameras.camera("front")
    found = estimate_distance(record.frames, record.camera, record.trajectory, record.T_rig_camera)
    view = FrontView(
        record.frames, found.distance, record.trajectory, record.camera, record.T_rig_camera, found.confidence
    )
    return record, check_distances(replace(view, moving=found.moving))


@pytest.mark.parametrize("name", ["front left", "front right"])
def test_warped_side_views_show_what_the_side_cameras_saw(six_cameras, front, name):
    record, view = front
    side = six_cameras.camera(name)
    index = 1
    # The cameras are triggered one after the other: the mounting is that between their true places.
    T_rig_side = invert(record.trajectory.T_world_rig[index]) @ side.T_world_camera[index]
    made = synthesize_view(view, side.camera, T_rig_side, [index], SynthesisSettings())
    image, truth = made.images[0], side.frames[index]
    same = made.origin[0] == PixelOrigin.SAME_FRAME
    observed = made.observed[0]
    seen = {"same frame": same, "all observed": observed}
    print(f"\n{name}: {same.mean():.3f} same frame, {observed.mean():.3f} observed")
    for what, mask in seen.items():
        print(f"  {what}: PSNR {psnr(image, truth, mask):.2f} dB, correlation {correlation(image, truth, mask):.3f}")
    assert 0.02 < observed.mean() < 0.6
    assert correlation(image, truth, same) > 0.5
    # A picture put elsewhere must be worse, or the numbers above say nothing.
    shifted = np.roll(truth, 40, axis=1)
    assert correlation(image, truth, same) > correlation(image, shifted, same) + 0.05


def correlation(image, truth, mask):
    """Of the grey levels of two pictures, a little blurred, over some pixels."""
    a, b = (
        cv2.GaussianBlur(cv2.cvtColor(each, cv2.COLOR_RGB2GRAY).astype(np.float64), (0, 0), 2.0)[mask]
        for each in (image, np.ascontiguousarray(truth))
    )
    return float(np.corrcoef(a, b)[0, 1])
