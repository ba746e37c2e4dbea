"""The image encoder: a small convolutional network, and a bird's-eye grid that gathers what all images show.

Every image is encoded with the same weights. Each cell of the grid (`birds_eye`) looks up the features where it is in
each image, at its foot and above it; images of an earlier time are looked up from where the vehicle was then, so that
what stands is in the same cell and what moves is not. The grid becomes the image tokens of the language model. Heads
on it are trained to tell what is where and what will be (`training.auxiliary`); the choice of plans reads them.
"""

from dataclasses import dataclass
from typing import Any

import torch
from scipy.sparse import csr_array
from torch import Tensor, nn
from torch.nn import functional

from olt_sft_recipes.toy.birds_eye import HEIGHTS, ROUTE_OFFSETS, STATIONS, TOLD
from olt_sft_recipes.toy.config import PATCH, ToyPolicyConfig

SECONDS_AHEAD = tuple(0.5 * step for step in range(9))
"""Seconds from t0 on at which the heads tell which cells are taken."""
TAKEN_WEIGHT = 4.0
"""How much a taken cell counts of one that is free when the heads are trained, since few are."""
IMAGE_TOKENS = len(STATIONS) // 2


@dataclass(frozen=True)
class Sight:
    """What the encoder makes of the images of a batch.

    Attributes:
        tokens: (batch, IMAGE_TOKENS, width), along the route.
        route: logits (batch, seconds + 2, stations, OFFSETS): cell taken at each of SECONDS_AHEAD; way held there now;
            road.
    """

    tokens: Tensor
    route: Tensor


class ImageEncoder(nn.Module):
    """See the module."""

    def __init__(self, config: ToyPolicyConfig) -> None:
        super().__init__()
        channels, cameras, frames = config.image_channels, len(config.camera_rows), len(config.frames)
        self.in_bfloat16 = config.precision == "bfloat16"
        inputs = 3 * PATCH**2
        self.patches = nn.Parameter(torch.empty(channels, 3, PATCH, PATCH).uniform_(-1.0, 1.0) / inputs**0.5)
        self.patch_bias = nn.Parameter(torch.zeros(channels))
        self.image_positions = nn.Parameter(0.02 * torch.randn(cameras, *config.feature_size, channels))
        self.image_blocks = nn.ModuleList([_Residual(channels) for _ in range(config.image_blocks)])
        self.by_camera = nn.Parameter(torch.randn(cameras, channels, len(HEIGHTS) * channels) / channels**0.5)
        self.grid_net = _GridNet(frames * channels, channels, len(SECONDS_AHEAD) + 2)
        self.tokens = nn.Linear(2 * len(ROUTE_OFFSETS) * channels, config.width)

    def forward(self, images: Tensor, route: csr_array) -> Sight:
        """Encode images (batch, cameras, frames, 3, rows, W) uint8 RGB, with where cells of the grid are in them."""
        batch, cameras = images.shape[:2]
        # Whole numbers up to 255 are the same in either precision; laid out as channels_last in one go.
        pixels = images.permute(0, 2, 1, 4, 5, 3)
        pixels = pixels.to(torch.bfloat16 if self.in_bfloat16 else torch.float32, memory_format=torch.contiguous_format)
        pixels = pixels.flatten(0, 2).permute(0, 3, 1, 2)
        with torch.autocast("cpu", torch.bfloat16, enabled=self.in_bfloat16):
            grid, logits = self.grid_net(_gather(self._features(pixels, cameras), route, batch))
        tokens = self.tokens(grid.float().permute(0, 2, 3, 1).reshape(batch, IMAGE_TOKENS, -1))
        return Sight(tokens, logits.float())

    def _features(self, pixels: Tensor, cameras: int) -> Tensor:
        """Features (places, channels) of the pixels of all images, in the order that `birds_eye.look_up` tells."""
        # The weights take grey levels to about unit size, which is cheaper than to change the pixels.
        bias = self.patch_bias - 2.0 * self.patches.sum((1, 2, 3))
        features = functional.conv2d(pixels, self.patches / 64.0, bias, stride=PATCH)
        # The layout of channels_last, in which cells find their features side by side.
        named = features.permute(0, 2, 3, 1).unflatten(0, (-1, cameras))
        features = (named + self.image_positions.to(named.dtype)).flatten(0, 1).permute(0, 3, 1, 2)
        for block in self.image_blocks:
            features = block(features)
        images = features.permute(0, 2, 3, 1).flatten(1, 2).unflatten(0, (-1, cameras))
        table = torch.einsum("bcpi,cio->bcpo", images, self.by_camera)
        return table.float().reshape(-1, features.shape[1])


class _Residual(nn.Module):
    """Norm, 3 x 3 convolution of what is positive, added to what came in."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.norm = nn.GroupNorm(1, channels)
        self.convolution = nn.Conv2d(channels, channels, kernel_size=3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.convolution(functional.relu(self.norm(x)))


class _GridNet(nn.Module):
    """A U-net over the grid: features (batch, channels, rows, columns) and logits (batch, heads, rows, OFFSETS).

    Who comes in four seconds is now far from the cell that is taken then, so it looks over the whole grid.
    """

    def __init__(self, inputs: int, channels: int, heads: int) -> None:
        super().__init__()
        half, quarter = channels * 3 // 2, channels * 2
        self.first = nn.Conv2d(inputs, channels, kernel_size=3, padding=1)
        self.positions = nn.Parameter(0.02 * torch.randn(len(STATIONS), len(ROUTE_OFFSETS), channels))
        self.fine = _Residual(channels)
        self.to_coarse = nn.Conv2d(channels, half, kernel_size=3, stride=2, padding=1)
        self.coarse = nn.Sequential(_Residual(half), _Residual(half))
        self.to_coarsest = nn.Conv2d(half, quarter, kernel_size=3, stride=2, padding=1)
        self.coarsest = nn.Sequential(_Residual(quarter), _Residual(quarter), _Residual(quarter))
        self.from_coarsest = nn.Conv2d(quarter, half, kernel_size=1)
        self.coarse_again = _Residual(half)
        self.from_coarse = nn.Conv2d(half, channels, kernel_size=1)
        self.fine_again = _Residual(channels)
        self.heads = nn.Conv2d(channels, heads, kernel_size=1, bias=False)
        self.rarity = nn.Parameter(torch.full((heads, 1, 1), -3.0))  # few cells are taken

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        x = self.first(x)
        fine = self.fine(x + self.positions.permute(2, 0, 1).to(x.dtype))
        half = self.coarse(self.to_coarse(fine))
        quarter = self.coarsest(self.to_coarsest(half))
        half = self.coarse_again(half + functional.interpolate(self.from_coarsest(quarter), size=half.shape[-2:]))
        fine = self.fine_again(fine + functional.interpolate(self.from_coarse(half), size=fine.shape[-2:]))
        x = functional.relu(fine)
        return x, self.heads(x[..., TOLD]) + self.rarity


def _gather(table: Tensor, lookup: csr_array, batch: int) -> Tensor:
    """Cells (batch, frames * channels, rows, columns) of the grid from features (places, channels)."""
    cells: Tensor = _Sparse.apply(table, lookup)  # pyright: ignore[reportAssignmentType]
    cells = functional.layer_norm(cells, cells.shape[-1:])
    return cells.view(batch, len(STATIONS), len(ROUTE_OFFSETS), -1).permute(0, 3, 1, 2)


class _Sparse(torch.autograd.Function):
    """The product of a sparse matrix and a dense one; scipy's has a fast transpose, torch's has not."""

    @staticmethod
    def forward(ctx: Any, table: Tensor, matrix: csr_array) -> Tensor:
        ctx.matrix = matrix
        return torch.from_numpy(matrix @ table.detach().numpy())

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        return torch.from_numpy(ctx.matrix.T @ grads[0].contiguous().numpy()), None
