"""Procedural noise of ground and sky, shared by all scenes.

Noise is periodic, has mean 0 and unit spread, and each layer holds one band of sizes, so that a layer can be faded out
where a pixel covers more than its texels.
"""

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.poses import Array
from olt_generator.seeds import make_generator

FloatImage = NDArray[np.floating[Any]]
"""Single precision in all pixel work."""

Image = NDArray[np.uint8]

# Ground noise: metres per texel and texels per side, from fine grain to broad stains.
NOISE_LAYERS: tuple[tuple[float, int], ...] = ((0.02, 1024), (0.09, 1024), (0.7, 512))


def sample(image: NDArray[Any], x: FloatImage, y: FloatImage) -> NDArray[Any]:
    """Values (n, m, ...) of an image at columns x and rows y, each (n, m), blended between the four pixels around."""
    return cv2.remap(image, x, y, cv2.INTER_LINEAR)


def sample_pairs(image: NDArray[Any], places: NDArray[Any], method: int = cv2.INTER_LINEAR) -> NDArray[Any]:
    """Values (n, m, ...) of an image at pairs (n, m, 2) of column and row."""
    no_second_map: Any = None
    return cv2.remap(image, places, no_second_map, method)


def look_up(image: NDArray[Any], places: FloatImage, matrix: Array) -> NDArray[Any]:
    """Values (n, m, ...) of an image at places (n, m, 2), of which the matrix (2, 3) makes columns and rows."""
    return sample_pairs(image, cv2.transform(places, matrix))


def sample_list(image: NDArray[Any], x: FloatImage, y: FloatImage) -> NDArray[Any]:
    """Values (n, ...) of an image at columns x and rows y, each (n,), however many."""
    # Rows of 512, the last one filled up: `cv2.remap` takes none longer than 32766.
    rows = max(1, -(-len(x) // 512))
    found = sample(image, np.resize(x, (rows, 512)), np.resize(y, (rows, 512)))
    return found.reshape(-1, *image.shape[2:])[: len(x)]


@lru_cache(maxsize=1)
def ground_noise() -> tuple[FloatImage, ...]:
    """One square layer (n + 1, n + 1) for each of `NOISE_LAYERS`; last row and column repeat the first."""
    generator = make_generator("ground noise")
    grain, wear, stains = (_band_noise(generator, size, 1.5, 7.0) for _, size in NOISE_LAYERS)
    wear = wear + _patches_and_cracks(generator, NOISE_LAYERS[1][1])
    return _periodic(grain), _periodic(wear), _periodic(stains)


@lru_cache(maxsize=1)
def clouds() -> FloatImage:
    """Cloud density (n + 1, n + 1), mean 0 and unit spread; last row and column repeat the first."""
    return _periodic(_band_noise(make_generator("clouds"), 1024, 12.0, 160.0))


def _band_noise(generator: np.random.Generator, size: int, finest: float, coarsest: float) -> FloatImage:
    """Periodic noise (size, size) whose power falls with frequency between two wavelengths in texels."""
    white = generator.standard_normal((size, size), dtype=np.float32)
    fy, fx = np.meshgrid(np.fft.fftfreq(size), np.fft.rfftfreq(size), indexing="ij")
    frequency = np.hypot(fx, fy)
    band = np.exp(-((frequency * finest) ** 2)) * (1.0 - np.exp(-((frequency * coarsest) ** 2)))
    spectrum = np.fft.rfft2(white) * band / np.maximum(frequency, 1.0 / size)
    return np.fft.irfft2(spectrum, s=(size, size)).astype(np.float32)


def _periodic(layer: FloatImage) -> FloatImage:
    """The layer with mean 0 and unit spread, and its first row and column again at the end."""
    standard = ((layer - layer.mean()) / layer.std()).astype(np.float32)
    return np.pad(standard, ((0, 1), (0, 1)), mode="wrap")


def _patches_and_cracks(generator: np.random.Generator, size: int) -> FloatImage:
    """Repaired rectangles and dark wandering cracks, periodic like the noise below them."""
    canvas = np.zeros((size, size), dtype=np.float32)
    for _ in range(60):
        x, y = generator.integers(0, size, 2).tolist()
        width, height = generator.integers(8, 40, 2).tolist()
        cv2.rectangle(canvas, (x, y), (x + width, y + height), float(generator.uniform(-0.02, 0.015)), cv2.FILLED)
    for _ in range(160):
        steps = generator.normal(0.0, 4.0, (25, 2)) + generator.normal(0.0, 3.0, 2)
        points = generator.uniform(0, size, 2) + np.cumsum(steps, axis=0)
        for shift in (-size, 0, size):
            shifted = np.round(points + np.array([shift, 0])).astype(np.int32)
            cv2.polylines(canvas, [shifted], False, -0.06, 1, cv2.LINE_AA)
    return canvas


def noise_spread(layer: int, footprint: Array | FloatImage) -> FloatImage:
    """How much of a noise layer a pixel of the given size (metres) still resolves: 1 fine, 0 averaged away."""
    return np.clip(1.6 - footprint / (2.5 * NOISE_LAYERS[layer][0]), 0.0, 1.0).astype(np.float32)
