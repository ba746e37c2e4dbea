import numpy as np
import pytest

from olt_generator.cameras import PinholeCamera, fit_camera
from olt_toolkit.clips.images import fit_images


@pytest.mark.parametrize("size", [(320, 200), (100, 56), (64, 64), (40, 100)])
def test_images_are_fitted_as_their_camera_is(size):
    """The picture of a ramp in x and y tells where each pixel came from; the fitted camera must say the same."""
    source = PinholeCamera.from_field_of_view(200, 120, np.radians(60.0))
    rows, columns = np.mgrid[0:120, 0:200]
    ramp = np.stack([columns, rows, np.zeros_like(rows)], axis=-1).astype(np.uint8)
    fitted = fit_images(ramp[None], *size)[0]
    camera = fit_camera(source, *size)
    assert fitted.shape == (size[1], size[0], 3)
    v, u = np.mgrid[2 : size[1] - 2, 2 : size[0] - 2]
    expected, _ = source.project(camera.rays(np.stack([u, v], axis=-1).astype(float)))
    np.testing.assert_allclose(fitted[2:-2, 2:-2, :2], expected, atol=1.5)
