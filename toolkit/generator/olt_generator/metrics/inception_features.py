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
# Layers that move by two pixels, and those that are not padded.
_HALVING = {
    *("Conv2d_1a_3x3", "Mixed_6a.branch3x3", "Mixed_6a.branch3x3dbl_3", "Mixed_7a.branch3x3_2"),
    "Mixed_7a.branch7x7x3_4",
}
_UNPADDED = _HALVING | {"Conv2d_2a_3x3", "Conv2d_4a_3x3"}
# The branches of each block: what is done one after the other, layers or pooling.
_MIXED_5 = ("1x1", "5x5_1 5x5_2", "3x3dbl_1 3x3dbl_2 3x3dbl_3", "mean _pool")
_MIXED_6 = ("1x1", "7x7_1 7x7_2 7x7_3", "7x7dbl_1 7x7dbl_2 7x7dbl_3 7x7dbl_4 7x7dbl_5", "mean _pool")
_MIXED_7 = ("1x1", "3x3_1 3x3_2a", "3x3_1 3x3_2b", "3x3dbl_1 3x3dbl_2 3x3dbl_3a", "3x3dbl_1 3x3dbl_2 3x3dbl_3b")
_BLOCKS = (
    *((f"Mixed_5{letter}", _MIXED_5) for letter in "bcd"),
    ("Mixed_6a", ("3x3", "3x3dbl_1 3x3dbl_2 3x3dbl_3", "halve")),
    *((f"Mixed_6{letter}", _MIXED_6) for letter in "bcde"),
    ("Mixed_7a", ("3x3_1 3x3_2", "7x7x3_1 7x7x3_2 7x7x3_3 7x7x3_4", "halve")),
    ("Mixed_7b", (*_MIXED_7, "mean _pool")),
    ("Mixed_7c", (*_MIXED_7, "max _pool")),
)


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
        features = []
        with torch.inference_mode():
            for image in images:
                x = torch.from_numpy(np.ascontiguousarray(image)).to(self._device).permute(2, 0, 1)[None] / 255.0
                x = functional.interpolate(x, (INPUT_SIDE, INPUT_SIDE), mode="bilinear", align_corners=False)
                features.append(_pooled(self._weights, 2.0 * x - 1.0).double().cpu().numpy())
        return np.concatenate(features)


def _pooled(weights: Weights, x: Tensor) -> Tensor:
    x = _layer(weights, x, "Conv2d_1a_3x3")
    x = _layer(weights, _layer(weights, x, "Conv2d_2a_3x3"), "Conv2d_2b_3x3")
    x = _layer(weights, functional.max_pool2d(x, 3, 2), "Conv2d_3b_1x1")
    x = functional.max_pool2d(_layer(weights, x, "Conv2d_4a_3x3"), 3, 2)
    for name, branches in _BLOCKS:
        x = torch.cat([_branch(weights, x, name, branch) for branch in branches], dim=1)
    return x.mean(dim=(2, 3))


def _branch(weights: Weights, x: Tensor, name: str, branch: str) -> Tensor:
    """Layers one after the other."""
    for step in branch.split():
        if step == "mean":
            x = functional.avg_pool2d(x, 3, 1, padding=1, count_include_pad=False)
        elif step == "max":
            x = functional.max_pool2d(x, 3, 1, padding=1)
        elif step == "halve":
            x = functional.max_pool2d(x, 3, 2)
        else:
            x = _layer(weights, x, f"{name}.branch{step}")
    return x


def _layer(weights: Weights, x: Tensor, name: str) -> Tensor:
    """Convolution, normalisation and rectification with the tensors of one name."""
    kernel = weights[f"{name}.conv.weight"]
    padding = (0, 0) if name in _UNPADDED else (kernel.shape[2] // 2, kernel.shape[3] // 2)
    x = functional.conv2d(x, kernel, None, 2 if name in _HALVING else 1, padding)
    mean, variance, scale, shift = (
        weights[f"{name}.bn.{part}"] for part in ("running_mean", "running_var", "weight", "bias")
    )
    return functional.relu(functional.batch_norm(x, mean, variance, scale, shift, eps=_NORM_EPSILON))
