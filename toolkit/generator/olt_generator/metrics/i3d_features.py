"""Video features for FVD: the class scores of an inflated Inception network (Carreira and Zisserman 2017).

Unterthiner et al. 2018 take the 400 scores of I3D trained on Kinetics-400. Weights ported to torch differ in the last
digits from the original TensorFlow ones, so distances compare only with distances under the same file: it is named in
every result. Layer sizes come from the weights.
"""

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from olt_generator.errors import InputError
from olt_generator.metrics.weight_files import Weights, read_weights
from olt_generator.poses import Array

INPUT_SIDE = 224
MIN_FRAMES = 9  # what is left of fewer after three halvings is less than the last pooling takes
_NORM_EPSILON = 0.001
_FINAL_POOL = (2, 7, 7)


class I3dFeatures:
    """Computes FVD features.

    Args:
        weights: `rgb_imagenet.pt` of the public torch port of I3D (tensors `Conv3d_1a_7x7.conv3d.weight`,
            `Mixed_3b.b1a.bn.weight`, `logits.conv3d.weight`, ...), or its state dictionary as safetensors. TorchScript
            files are not read.
        device: where torch runs the network.

    Raises:
        InputError: the file is missing or damaged.
    """

    def __init__(self, weights: Path, device: str = "cpu") -> None:
        self.name = f"I3D ({weights.name})"
        self._weights = read_weights(weights, device)
        self._device = device

    def __call__(self, clips: NDArray[np.uint8]) -> Array:
        """Features (n, 400) float64 of clips (n, t, H, W, 3), scaled to 224 x 224.

        Raises:
            InputError: the clips are too short, or the weights are those of another network.
        """
        if clips.shape[1] < MIN_FRAMES:
            raise InputError(f"FVD: clips of {clips.shape[1]} frames; the network needs at least {MIN_FRAMES}")
        features = []
        with torch.inference_mode():
            for clip in clips:
                x = torch.from_numpy(np.ascontiguousarray(clip)).to(self._device).permute(0, 3, 1, 2) / 127.5 - 1.0
                x = functional.interpolate(x, (INPUT_SIDE, INPUT_SIDE), mode="bilinear", align_corners=False)
                features.append(_scores(self._weights, x.permute(1, 0, 2, 3)[None]).double().cpu().numpy())
        return np.concatenate(features)


def _scores(weights: Weights, x: Tensor) -> Tensor:
    """Class scores (1, classes), mean over time, of a clip (1, 3, t, h, w) between -1 and 1."""
    x = _max_pool(_unit(weights, x, "Conv3d_1a_7x7", stride=2), (1, 3, 3), (1, 2, 2))
    x = _unit(weights, _unit(weights, x, "Conv3d_2b_1x1"), "Conv3d_2c_3x3")
    x = _mixed(weights, _max_pool(x, (1, 3, 3), (1, 2, 2)), "Mixed_3b", "Mixed_3c")
    x = _max_pool(x, (3, 3, 3), (2, 2, 2))
    x = _mixed(weights, x, "Mixed_4b", "Mixed_4c", "Mixed_4d", "Mixed_4e", "Mixed_4f")
    x = _mixed(weights, _max_pool(x, (2, 2, 2), (2, 2, 2)), "Mixed_5b", "Mixed_5c")
    x = functional.avg_pool3d(x, _FINAL_POOL, stride=1)
    x = functional.conv3d(x, weights["logits.conv3d.weight"], weights["logits.conv3d.bias"])
    return x.mean(dim=(2, 3, 4))


def _mixed(weights: Weights, x: Tensor, *names: str) -> Tensor:
    for name in names:
        branches = (
            _unit(weights, x, f"{name}.b0"),
            _unit(weights, _unit(weights, x, f"{name}.b1a"), f"{name}.b1b"),
            _unit(weights, _unit(weights, x, f"{name}.b2a"), f"{name}.b2b"),
            _unit(weights, _max_pool(x, (3, 3, 3), (1, 1, 1)), f"{name}.b3b"),
        )
        x = torch.cat(branches, dim=1)
    return x


def _unit(weights: Weights, x: Tensor, name: str, stride: int = 1) -> Tensor:
    """Convolution, normalisation and rectification with the tensors of one name."""
    kernel = weights[f"{name}.conv3d.weight"]
    x = functional.conv3d(_padded(x, tuple(kernel.shape[2:]), (stride,) * 3), kernel, None, stride)
    mean, variance, scale, shift = (
        weights[f"{name}.bn.{part}"] for part in ("running_mean", "running_var", "weight", "bias")
    )
    return functional.relu(functional.batch_norm(x, mean, variance, scale, shift, eps=_NORM_EPSILON))


def _max_pool(x: Tensor, kernel: tuple[int, ...], stride: tuple[int, ...]) -> Tensor:
    return functional.max_pool3d(_padded(x, kernel, stride), kernel, stride)


def _padded(x: Tensor, kernel: tuple[int, ...], stride: tuple[int, ...]) -> Tensor:
    """Zeros around (n, c, t, h, w) such that ceil(size / stride) outputs come out, the odd one at the end."""
    pads: list[int] = []
    for size, width, step in zip(reversed(x.shape[2:]), reversed(kernel), reversed(stride), strict=True):
        total = max(width - (size % step or step), 0)
        pads += [total // 2, total - total // 2]
    return functional.pad(x, pads)
