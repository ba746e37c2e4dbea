"""Image features for FID: the last pooled activations of the Inception network (Heusel et al. 2017).

The network is the one of the FID paper as ported to torch: Inception v3 whose average pooling does not count the
padding, and whose last block pools by maximum. Layer sizes come from the weights.
"""

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from olt_generator.metrics.weight_files import Weights, read_weights
from olt_generator.poses import Array

INPUT_SIDE = 299
_NORM_EPSILON = 0.001


class InceptionFeatures:
    """Computes FID features.

    Args:
        weights: pt_inception-2015-12-05-6726825d.pth (tensors `Conv2d_1a_3x3.conv.weight`, ...), or its state
            dictionary as safetensors.
        device: where torch runs the network.

    Raises:
        InputError: the file is missing or damaged.
    """

    def __init__(self, weights: Path, device: str = "cpu") -> None:
        self.name = f"Inception v3 ({weights.name})"
        self._weights = read_weights(weights, device)
        self._device = device

    def __call__(self, images: NDArray[np.uint8]) -> Array:
        """Features (n, 2048) float64 of images (n, H, W, 3), scaled to 299 x 299 as published.

        Raises:
            InputError: the weights are those of another network.
        """
        with torch.inference_mode():
            return np.concatenate([self._features(image) for image in images])

    def _features(self, image: NDArray[np.uint8]) -> Array:
        x = torch.from_numpy(np.ascontiguousarray(image)).to(self._device).permute(2, 0, 1)[None] / 255.0
        x = functional.interpolate(x, (INPUT_SIDE, INPUT_SIDE), mode="bilinear", align_corners=False)
        return _pooled(_Layers(self._weights), 2.0 * x - 1.0).double().cpu().numpy()


class _Layers:
    """Convolution, normalisation and rectification with the tensors of one name."""

    def __init__(self, weights: Weights) -> None:
        self._weights = weights

    def __call__(self, x: Tensor, name: str, stride: int = 1, pad: bool = True) -> Tensor:
        kernel = self._weights[f"{name}.conv.weight"]
        padding = (kernel.shape[2] // 2, kernel.shape[3] // 2) if pad else (0, 0)
        x = functional.conv2d(x, kernel, None, stride, padding)
        mean, variance, scale, shift = (
            self._weights[f"{name}.bn.{part}"] for part in ("running_mean", "running_var", "weight", "bias")
        )
        return functional.relu(functional.batch_norm(x, mean, variance, scale, shift, eps=_NORM_EPSILON))

    def chain(self, x: Tensor, *names: str) -> Tensor:
        """Layers one after the other."""
        for name in names:
            x = self(x, name)
        return x


def _pooled(layer: _Layers, x: Tensor) -> Tensor:
    x = layer(x, "Conv2d_1a_3x3", stride=2, pad=False)
    x = layer(layer(x, "Conv2d_2a_3x3", pad=False), "Conv2d_2b_3x3")
    x = layer(functional.max_pool2d(x, 3, 2), "Conv2d_3b_1x1")
    x = functional.max_pool2d(layer(x, "Conv2d_4a_3x3", pad=False), 3, 2)
    for name in ("Mixed_5b", "Mixed_5c", "Mixed_5d"):
        x = _mixed_5(layer, x, name)
    x = _reduce_6(layer, x, "Mixed_6a")
    for name in ("Mixed_6b", "Mixed_6c", "Mixed_6d", "Mixed_6e"):
        x = _mixed_6(layer, x, name)
    x = _reduce_7(layer, x, "Mixed_7a")
    x = _mixed_7(layer, x, "Mixed_7b", _mean_of_neighbours(x))
    x = _mixed_7(layer, x, "Mixed_7c", functional.max_pool2d(x, 3, 1, padding=1))
    return x.mean(dim=(2, 3))


def _mixed_5(layer: _Layers, x: Tensor, name: str) -> Tensor:
    return _joined(
        layer(x, f"{name}.branch1x1"),
        layer.chain(x, f"{name}.branch5x5_1", f"{name}.branch5x5_2"),
        layer.chain(x, *(f"{name}.branch3x3dbl_{step}" for step in (1, 2, 3))),
        layer(_mean_of_neighbours(x), f"{name}.branch_pool"),
    )


def _reduce_6(layer: _Layers, x: Tensor, name: str) -> Tensor:
    double = layer.chain(x, f"{name}.branch3x3dbl_1", f"{name}.branch3x3dbl_2")
    return _joined(
        layer(x, f"{name}.branch3x3", stride=2, pad=False),
        layer(double, f"{name}.branch3x3dbl_3", stride=2, pad=False),
        functional.max_pool2d(x, 3, 2),
    )


def _mixed_6(layer: _Layers, x: Tensor, name: str) -> Tensor:
    return _joined(
        layer(x, f"{name}.branch1x1"),
        layer.chain(x, *(f"{name}.branch7x7_{step}" for step in (1, 2, 3))),
        layer.chain(x, *(f"{name}.branch7x7dbl_{step}" for step in (1, 2, 3, 4, 5))),
        layer(_mean_of_neighbours(x), f"{name}.branch_pool"),
    )


def _reduce_7(layer: _Layers, x: Tensor, name: str) -> Tensor:
    wide = layer.chain(x, *(f"{name}.branch7x7x3_{step}" for step in (1, 2, 3)))
    return _joined(
        layer(layer(x, f"{name}.branch3x3_1"), f"{name}.branch3x3_2", stride=2, pad=False),
        layer(wide, f"{name}.branch7x7x3_4", stride=2, pad=False),
        functional.max_pool2d(x, 3, 2),
    )


def _mixed_7(layer: _Layers, x: Tensor, name: str, pooled: Tensor) -> Tensor:
    single = layer(x, f"{name}.branch3x3_1")
    double = layer.chain(x, f"{name}.branch3x3dbl_1", f"{name}.branch3x3dbl_2")
    return _joined(
        layer(x, f"{name}.branch1x1"),
        layer(single, f"{name}.branch3x3_2a"),
        layer(single, f"{name}.branch3x3_2b"),
        layer(double, f"{name}.branch3x3dbl_3a"),
        layer(double, f"{name}.branch3x3dbl_3b"),
        layer(pooled, f"{name}.branch_pool"),
    )


def _mean_of_neighbours(x: Tensor) -> Tensor:
    return functional.avg_pool2d(x, 3, 1, padding=1, count_include_pad=False)


def _joined(*branches: Tensor) -> Tensor:
    return torch.cat(branches, dim=1)
