"""Images of one camera seen through another with the same centre."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from olt_generator.cameras import BrownConradyCamera, FthetaCamera, KannalaBrandtCamera, PinholeCamera, pixel_rays
from olt_generator.errors import InputError
from olt_generator.lenses.remap import Remapper

FISHEYE = FthetaCamera.equidistant(400, 240, 199.5, 130.0, 190.0)
SOURCES = [
    PinholeCamera(400, 240, 210.0, 215.0, 195.0, 118.0),
    FISHEYE,
    KannalaBrandtCamera(400, 240, 190.0, 190.0, 201.0, 121.0, -0.02, 0.003),
    BrownConradyCamera(400, 240, 300.0, 300.0, 198.0, 122.0, -0.3, 0.1, 1e-3, -5e-4, -0.02),
]
STRAIGHT = np.eye(3)


def painted(camera, height_of=240, width_of=400):
    """An image whose colours are linear functions of the pixel."""
    v, u = np.mgrid[:height_of, :width_of].astype(float)
    return np.rint(np.stack([u / 2.0, v, (u + v) / 3.0], axis=-1)).astype(np.uint8)


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("yaw", [0.0, 35.0])
@pytest.mark.parametrize("samples", [1, 2])
def test_each_pixel_shows_what_lies_in_its_direction(source, yaw, samples):
    target = PinholeCamera.from_field_of_view(128, 80, float(np.radians(50.0)))
    R_source_target = Rotation.from_euler("y", yaw, degrees=True).as_matrix()
    remapper = Remapper(source, target, R_source_target, samples)
    result = remapper.remap(painted(source)).astype(float)
    pixels, seen = source.project(pixel_rays(target) @ R_source_target.T)
    u, v = pixels[..., 0], pixels[..., 1]
    expected = np.stack([u / 2.0, v, (u + v) / 3.0], axis=-1)
    assert 0.3 < remapper.seen.mean() <= seen.mean()
    # Away from the border, where there is nothing to interpolate with.
    inner = remapper.seen & (u > 4) & (u < 395) & (v > 4) & (v < 235)
    assert np.abs(result - expected)[inner].max() < 2.1
    # Halving rounds halves up, which brightens by a quarter of a grey level.
    assert abs((result - expected)[inner].mean()) < 0.35
    assert not result[~remapper.seen].any()


def test_the_same_camera_changes_nothing():
    image = np.random.default_rng(0).integers(0, 256, (240, 400, 3), dtype=np.uint8)
    remapper = Remapper(FISHEYE, FISHEYE, STRAIGHT)
    assert remapper.seen.all()
    assert np.array_equal(remapper.remap(image), image)


def test_a_sequence_is_its_images_one_by_one():
    images = np.random.default_rng(1).integers(0, 256, (3, 240, 400, 3), dtype=np.uint8)
    remapper = Remapper(FISHEYE, PinholeCamera.from_field_of_view(64, 40, 1.5), STRAIGHT)
    result = remapper.remap(images)
    assert result.shape == (3, 40, 64, 3)
    assert all(np.array_equal(result[index], remapper.remap(images[index])) for index in range(3))
    assert remapper.remap(images[:0]).shape == (0, 40, 64, 3)


@pytest.mark.parametrize("shrink", [2, 3, 8, 20])
def test_shrinking_does_not_alias(shrink):
    """Stripes a pixel wide become grey, in whatever direction they run."""
    source = FthetaCamera.equidistant(800, 480, 399.5, 239.5, 380.0)
    target = source.resized(800 // shrink, 480 // shrink)
    v, u = np.mgrid[:480, :800]
    remapper = Remapper(source, target, STRAIGHT)
    for stripes in (u % 2, v % 2, (u + v) % 2):
        image = np.repeat((200 * stripes).astype(np.uint8)[..., None], 3, axis=-1)
        plain = cv2.resize(image, (target.width, target.height), interpolation=cv2.INTER_NEAREST).astype(int)
        assert np.abs(remapper.remap(image).astype(int) - 100)[1:-1, 1:-1].max() < 30
        assert np.abs(plain - 100).max() == 100


def test_shrinkage_that_varies_over_the_image_is_followed():
    """A perspective view of 150 degrees shrinks its middle and enlarges its edge: neither flickers nor blurs."""
    source = FthetaCamera.equidistant(1200, 700, 599.5, 349.5, 420.0)
    target = PinholeCamera.from_field_of_view(300, 120, float(np.radians(150.0)))
    v, u = np.mgrid[:700, :1200]
    fine = np.repeat((200 * ((u + v) % 2)).astype(np.uint8)[..., None], 3, axis=-1)
    assert np.abs(Remapper(source, target, STRAIGHT).remap(fine).astype(int) - 100)[30:90, 130:170].max() < 5
    coarse = np.repeat((200 * (u // 12 % 2)).astype(np.uint8)[..., None], 3, axis=-1)
    edge = Remapper(source, target, STRAIGHT).remap(coarse)[60, 250:, 0].astype(int)
    assert np.ptp(edge) > 190


def test_more_samples_come_closer_to_the_mean_of_the_pixel():
    source = FthetaCamera.equidistant(800, 480, 399.5, 239.5, 380.0)
    target = PinholeCamera.from_field_of_view(200, 120, float(np.radians(80.0)))
    image = np.random.default_rng(2).integers(0, 256, (480, 800, 3), dtype=np.uint8)
    best = Remapper(source, target, STRAIGHT, 8).remap(image).astype(float)
    errors = [np.std(Remapper(source, target, STRAIGHT, samples).remap(image) - best) for samples in (1, 2, 4)]
    assert errors[0] > 1.3 * errors[1] > 1.3**2 * errors[2]


@pytest.mark.parametrize("degrees", [1.0, 90.0, 174.0])
def test_any_field_of_view_and_a_view_of_nothing(degrees):
    target = PinholeCamera.from_field_of_view(60, 40, float(np.radians(degrees)))
    image = np.full((240, 400, 3), 77, np.uint8)
    remapper = Remapper(FISHEYE, target, STRAIGHT)
    assert np.array_equal(remapper.remap(image), 77 * np.repeat(remapper.seen[..., None], 3, axis=-1))
    assert remapper.seen[20, 30]
    away = Remapper(FISHEYE, PinholeCamera.from_field_of_view(60, 40, 0.5), np.diag([-1.0, 1.0, -1.0]))
    assert not away.seen.any() and not away.remap(image).any()


def test_odd_sizes_and_tiny_images():
    source = PinholeCamera.from_field_of_view(37, 5, 1.0)
    remapper = Remapper(source, source.resized(3, 2), STRAIGHT)
    assert np.array_equal(remapper.remap(np.full((5, 37, 3), 9, np.uint8)), np.full((2, 3, 3), 9, np.uint8))


def test_images_of_another_size_are_refused():
    with pytest.raises(InputError, match="give the camera at their size"):
        Remapper(FISHEYE, FISHEYE, STRAIGHT).remap(np.zeros((10, 10, 3), np.uint8))


def test_a_place_beside_is_taken_to_see_everything_at_one_distance():
    """1 m to the right of the source a point 10 m ahead lies a tenth of the focal length to the right."""
    camera = PinholeCamera(64, 48, 100.0, 100.0, 31.5, 23.5)
    columns = np.broadcast_to(np.arange(64, dtype=np.uint8)[:, None], (48, 64, 3))
    beside = Remapper(camera, camera, np.eye(3), shift=(0.1, 0.0, 0.0))
    # Every ray is 10 m long, so that away from the axis depth is a little less and the step a little larger.
    assert beside.remap(np.ascontiguousarray(columns))[23, 31, 0] == pytest.approx(41, abs=1)
    assert not beside.seen[:, 54:].any()
    assert Remapper(camera, camera, np.eye(3), shift=(0.0, 0.0, 0.0)).seen.all()
