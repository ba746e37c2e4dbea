"""PSNR and SSIM against their definitions."""

import numpy as np
import pytest
from scipy.ndimage import correlate

from olt_generator.errors import InputError
from olt_generator.metrics.image_metrics import psnr, ssim
from olt_generator.seeds import make_generator


def noise(*shape: int) -> np.ndarray:
    return make_generator("metrics", *shape).integers(0, 256, shape).astype(np.uint8)


def test_psnr_of_a_constant_error():
    image = np.full((10, 12, 3), 100, np.uint8)
    assert psnr(image, image + np.uint8(5)) == pytest.approx(20.0 * np.log10(255.0 / 5.0))


def test_psnr_counts_wraparound_as_a_large_error():
    black, white = np.zeros((4, 4, 3), np.uint8), np.full((4, 4, 3), 255, np.uint8)
    assert psnr(black, white) == pytest.approx(0.0)


def test_psnr_of_equal_images_is_infinite():
    assert psnr(noise(8, 8, 3), noise(8, 8, 3)) == np.inf


def test_psnr_looks_at_the_mask_only():
    a, b = np.zeros((2, 6, 6, 3), np.uint8), np.zeros((2, 6, 6, 3), np.uint8)
    b[:, :3] = 255
    b[:, 3:] = 1
    mask = np.zeros((2, 6, 6), bool)
    mask[:, 3:] = True
    assert psnr(a, b, mask) == pytest.approx(20.0 * np.log10(255.0))


def test_ssim_equals_the_definition():
    a = noise(24, 30, 3)
    b = np.clip(a.astype(int) + noise(24, 30, 3) // 6 - 20, 0, 255).astype(np.uint8)
    offsets = np.arange(-5, 6)
    line = np.exp(-0.5 * (offsets / 1.5) ** 2)
    window = np.outer(line, line) / line.sum() ** 2
    values = []
    for channel in range(3):
        x, y = a[..., channel].astype(float), b[..., channel].astype(float)
        mean_x, mean_y = correlate(x, window), correlate(y, window)
        var_x, var_y = correlate(x * x, window) - mean_x**2, correlate(y * y, window) - mean_y**2
        covariance = correlate(x * y, window) - mean_x * mean_y
        c1, c2 = 6.5025, 58.5225
        similarity = ((2 * mean_x * mean_y + c1) * (2 * covariance + c2)) / (
            (mean_x**2 + mean_y**2 + c1) * (var_x + var_y + c2)
        )
        values.append(similarity[5:-5, 5:-5].mean())
    assert ssim(a, b) == pytest.approx(np.mean(values), abs=1e-9)


def test_ssim_is_one_for_equal_images_and_falls_with_noise():
    image = noise(40, 40, 3) // 4 + 90
    slightly, strongly = (np.clip(image + make_generator(s).normal(0, s, image.shape), 0, 255) for s in (5, 40))
    assert ssim(image, image) == pytest.approx(1.0)
    assert 1.0 > ssim(image, slightly.astype(np.uint8)) > ssim(image, strongly.astype(np.uint8))


def test_what_cannot_be_compared_is_refused():
    with pytest.raises(InputError, match="shapes"):
        psnr(noise(4, 4, 3), noise(4, 5, 3))
    with pytest.raises(InputError, match="mask"):
        psnr(noise(4, 4, 3), noise(4, 4, 3), np.zeros((4, 4), bool))
    with pytest.raises(InputError, match="11"):
        ssim(noise(10, 20, 3), noise(10, 20, 3))
