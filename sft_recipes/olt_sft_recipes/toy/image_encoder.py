"""The image encoder: a small convolutional network, and two bird's-eye grids that gather what all images show.

Every image is encoded with the same weights. Each cell of a grid (`birds_eye`) looks up the features where it is in
each image, at its foot and above it; images of an earlier time are looked up from where the vehicle was then, so that
what stands is in the same cell and what moves is not. The grids become the image tokens of the language model. Heads
on the grids are trained to tell what is where and what will be (`training.losses`); nothing reads them when it drives.
"""

from dataclasses import dataclass
from typing import Any

import torch
from scipy.sparse import csr_array
from torch import Tensor, nn
from torch.nn import functional

from olt_sft_recipes.toy.birds_eye import HEIGHTS, OFFSETS, STATIONS, WORLD_X, WORLD_Y
from olt_sft_recipes.toy.config import PATCH, ToyPolicyConfig

SECONDS_AHEAD = tuple(0.5 * step for step in range(9))
"""Seconds from t0 on at which the heads tell which cells are taken."""
TAKEN_WEIGHT = 4.0
"""How much a taken cell counts of one that is free when the heads are trained, since few are."""
ROUTE_TOKENS, WORLD_TOKENS = len(STATIONS) // 2, len(WORLD_X) * len(WORLD_Y) // 16
IMAGE_TOKENS = ROUTE_TOKENS + WORLD_TOKENS


@dataclass(frozen=True)
class Sight:
    """What the encoder makes of the images of a batch.

    Attributes:
        tokens: (batch, IMAGE_TOKENS, width), along the route, then of the world.
        route: logits (batch, seconds + 1, stations, offsets): cell taken at each of SECONDS_AHEAD; way held there now.
        world: logits (batch, seconds, rows, columns): cell taken.
    """

    tokens: Tensor
    route: Tensor
    world: Tensor


class ImageEncoder(nn.Module):
    """See the module."""

    def __init__(self, config: ToyPolicyConfig) -> None:
        super().__init__()
        channels, cameras, frames = config.image_channels, len(config.camera_rows), len(config.frames)
        self.top, self.in_bfloat16 = config.image_top, config.precision == "bfloat16"
        inputs = 3 * PATCH**2
        self.patches = nn.Parameter(torch.empty(channels, 3, PATCH, PATCH).uniform_(-1.0, 1.0) / inputs**0.5)
        self.patch_bias = nn.Parameter(torch.zeros(channels))
        self.image_positions = nn.Parameter(0.02 * torch.randn(cameras, *config.feature_size, channels))
        self.image_blocks = nn.ModuleList([_Residual(channels) for _ in range(2)])
        self.by_camera = nn.Parameter(torch.randn(cameras, channels, len(HEIGHTS) * channels) / channels**0.5)
        self.route_net = _GridNet(frames * channels, channels, len(STATIONS), len(OFFSETS), len(SECONDS_AHEAD) + 1)
        self.world_net = _GridNet(frames * channels, channels, len(WORLD_X), len(WORLD_Y), len(SECONDS_AHEAD))
        self.route_tokens = nn.Linear(2 * len(OFFSETS) * channels, config.width)
        self.world_tokens = nn.Linear(16 * channels, config.width)

    def forward(self, images: Tensor, route: csr_array, world: csr_array) -> Sight:
        """Encode images (batch, cameras, frames, 3, H, W) uint8 RGB, with where the cells of the grids are in them."""
        batch, cameras = images.shape[:2]
        # Whole numbers up to 255 are the same in either precision; laid out as channels_last in one go.
        pixels = images[..., self.top :, :].permute(0, 2, 1, 4, 5, 3)
        pixels = pixels.to(torch.bfloat16 if self.in_bfloat16 else torch.float32, memory_format=torch.contiguous_format)
        pixels = pixels.flatten(0, 2).permute(0, 3, 1, 2)
        with torch.autocast("cpu", torch.bfloat16, enabled=self.in_bfloat16):
            table = self._features(pixels, cameras)
            along, route_logits = self.route_net(_gather(table, route, batch, len(STATIONS), len(OFFSETS)))
            around, world_logits = self.world_net(_gather(table, world, batch, len(WORLD_X), len(WORLD_Y)))
        along, around = along.float(), around.float()
        tokens = [
            self.route_tokens(along.permute(0, 2, 3, 1).reshape(batch, ROUTE_TOKENS, -1)),
            self.world_tokens(functional.pixel_unshuffle(around, 4).flatten(2).transpose(1, 2)),
        ]
        return Sight(torch.cat(tokens, dim=1), route_logits.float(), world_logits.float())

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
    """Convolutions over a grid: features (batch, channels, rows, columns) and logits (batch, heads, rows, columns)."""

    def __init__(self, inputs: int, channels: int, rows: int, columns: int, heads: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(inputs, channels, kernel_size=3, padding=1)
        self.positions = nn.Parameter(0.02 * torch.randn(rows, columns, channels))
        self.blocks = nn.ModuleList([_Residual(channels) for _ in range(2)])
        self.heads = nn.Conv2d(channels, heads, kernel_size=1, bias=False)
        self.rarity = nn.Parameter(torch.full((heads, 1, 1), -3.0))  # few cells are taken

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        x = self.first(x)
        x = x + self.positions.permute(2, 0, 1).to(x.dtype)
        for block in self.blocks:
            x = block(x)
        x = functional.relu(x)
        return x, self.heads(x) + self.rarity


def _gather(table: Tensor, lookup: csr_array, batch: int, rows: int, columns: int) -> Tensor:
    """Cells (batch, frames * channels, rows, columns) of a grid from features (places, channels)."""
    cells: Tensor = _Sparse.apply(table, lookup)  # pyright: ignore[reportAssignmentType]
    cells = functional.layer_norm(cells, cells.shape[-1:])
    return cells.view(batch, rows, columns, -1).permute(0, 3, 1, 2)


class _Sparse(torch.autograd.Function):
    """The product of a sparse matrix and a dense one; scipy's has a fast transpose, torch's has not."""

    @staticmethod
    def forward(ctx: Any, table: Tensor, matrix: csr_array) -> Tensor:
        ctx.matrix = matrix
        return torch.from_numpy(matrix @ table.detach().numpy())

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        return torch.from_numpy(ctx.matrix.T @ grads[0].contiguous().numpy()), None
