"""LPIPS: how different two images look to a network trained on photographs.

Zhang et al. 2018, version 0.1 of the published metric, with AlexNet.
"""

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from olt_generator.errors import InputError
from olt_generator.metrics.weight_files import read_weights

BACKBONE_FILE = "alexnet"
HEADS_FILE = "alex"
SUFFIXES = (".safetensors", ".pth")
MIN_SIDE = 63  # AlexNet's last pooling has nothing left of smaller images

# Of images between -1 and 1 (the published metric's own normalisation).
_MEAN, _DEVIATION = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
# AlexNet's convolutions: index in the state dictionary, stride, padding, and whether pooling comes before.
_LAYERS = ((0, 4, 2, False), (3, 1, 2, True), (6, 1, 1, True), (8, 1, 1, False), (10, 1, 1, False))


class Lpips:
    """Measures LPIPS with published weights.

    Args:
        folder: holds torchvision's AlexNet, `alexnet*.pth` (alexnet-owt-7be5be79.pth, tensors `features.0.weight`,
            ...), and the heads of the reference implementation, `alex.pth` (weights/v0.1, tensors
            `lin0.model.1.weight`, ...). Either may be a `.safetensors` file of the same tensors.
        device: where torch runs the network.

    Raises:
        InputError: a file is missing or holds another network.
    """

    def __init__(self, folder: Path, device: str = "cpu") -> None:
        backbone = read_weights(_only_file(folder, f"{BACKBONE_FILE}*"), device)
        heads = read_weights(_only_file(folder, HEADS_FILE), device)
        self.name = f"LPIPS AlexNet ({backbone.path.name}, {heads.path.name})"
        self._device = device
        self._layers = [
            (backbone[f"features.{index}.weight"], backbone[f"features.{index}.bias"], heads[f"lin{k}.model.1.weight"])
            for k, (index, *_) in enumerate(_LAYERS)
        ]

    def __call__(self, a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
        """LPIPS of two images (H, W, 3), 0 where they are equal.

        Raises:
            InputError: the shapes differ or the images are too small.
        """
        if a.shape != b.shape:
            raise InputError(f"LPIPS: images of shapes {a.shape} and {b.shape}; give both at one size")
        if min(a.shape[:2]) < MIN_SIDE:
            raise InputError(f"LPIPS: images of {a.shape[1]} x {a.shape[0]}; they need {MIN_SIDE} pixels a side")
        with torch.inference_mode():
            distance = sum(
                functional.conv2d((x - y) ** 2, head).mean()
                for x, y, (*_, head) in zip(self._features(a), self._features(b), self._layers, strict=True)
            )
        return float(distance)

    def _features(self, image: NDArray[np.uint8]) -> list[Tensor]:
        """The activations (1, c, h, w) of each layer, scaled to unit length at every place."""
        mean, deviation = (torch.tensor(values, device=self._device).view(3, 1, 1) for values in (_MEAN, _DEVIATION))
        x = torch.from_numpy(np.ascontiguousarray(image)).to(self._device).permute(2, 0, 1)[None] / 127.5 - 1.0
        x = (x - mean) / deviation
        features = []
        for (_, stride, padding, pooled), (weight, bias, _) in zip(_LAYERS, self._layers, strict=True):
            if pooled:
                x = functional.max_pool2d(x, kernel_size=3, stride=2)
            x = functional.relu(functional.conv2d(x, weight, bias, stride, padding))
            features.append(x / (x.norm(dim=1, keepdim=True) + 1e-10))
        return features


def _only_file(folder: Path, pattern: str) -> Path:
    found = sorted(path for suffix in SUFFIXES for path in folder.glob(pattern + suffix))
    if len(found) != 1:
        raise InputError(
            f"{folder}: holds {len(found)} files {pattern}{{{','.join(SUFFIXES)}}}; LPIPS needs torchvision's "
            "alexnet-owt-7be5be79.pth and alex.pth of the reference implementation's weights/v0.1"
        )
    return found[0]
