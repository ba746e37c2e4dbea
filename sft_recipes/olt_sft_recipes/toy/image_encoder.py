"""The image encoder: one small convolutional network that turns every image into a few tokens."""

import torch
from torch import Tensor, nn
from torch.nn import functional

from olt_sft_recipes.toy.config import ToyPolicyConfig


class ImageEncoder(nn.Module):
    """Encodes all images with the same weights; learned embeddings say which camera and which time each is from."""

    def __init__(self, config: ToyPolicyConfig) -> None:
        super().__init__()
        self.tokens_per_image = config.tokens_per_image
        channels = config.image_channels
        # Strides of 4, 2 and 2: one cell of the last map sees a patch of 16 x 16 pixels and some of its neighbours.
        self.patches = nn.Conv2d(3, channels, kernel_size=4, stride=4)
        # Takes out each image's brightness and contrast, where that is cheap: on 1/16 of the pixels.
        self.contrast = nn.GroupNorm(1, channels)
        self.blocks = nn.ModuleList(
            [
                nn.Conv2d(channels, 2 * channels, kernel_size=3, stride=2, padding=1),
                nn.Conv2d(2 * channels, 4 * channels, kernel_size=3, stride=2, padding=1),
            ]
        )
        cells = (config.image_height // 16) * (config.image_width // 16)
        self.summary = nn.Linear(4 * channels * cells, config.tokens_per_image * config.width)
        self.camera_embedding = nn.Parameter(0.02 * torch.randn(len(config.contract.cameras), 1, 1, config.width))
        self.time_embedding = nn.Parameter(0.02 * torch.randn(config.image_frames, 1, config.width))

    def forward(self, images: Tensor) -> Tensor:
        """Encode images.

        Args:
            images: (batch, cameras, frames, 3, H, W) uint8 RGB.

        Returns:
            (batch, cameras * frames * tokens_per_image, width), camera by camera, then frame by frame.
        """
        batch, cameras, frames = images.shape[:3]
        features = self.contrast(self.patches(images.flatten(0, 2).float()))
        for convolution in self.blocks:
            features = convolution(functional.gelu(features))
        tokens = self.summary(functional.gelu(features).flatten(1))
        tokens = tokens.view(batch, cameras, frames, self.tokens_per_image, -1)
        return (tokens + self.camera_embedding + self.time_embedding).flatten(1, 3)
