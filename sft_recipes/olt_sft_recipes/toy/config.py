"""The sizes of the toy policy."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, PositiveInt, model_validator

from olt_toolkit.policy.contract import IMAGE_FRAMES
from olt_toolkit.rigs.rig import POLICY_CAMERAS

CAMERAS = len(POLICY_CAMERAS)


class ToyPolicyConfig(BaseModel):
    """Sizes of the toy policy; saved as `config.json` beside its weights.

    Attributes:
        image_height, image_width: pixels, multiples of 16.
        image_channels: channels after the first convolution; they double twice.
        image_frames: newest frames of each camera that are used, of the four that are given. The history tells
            how the vehicle moves; the toy needs the images for where the road goes.
        tokens_per_image: tokens that each image becomes.
        width: width of the language model.
        layers: layers of the language model and of the action expert, which meet layer by layer.
        heads: attention heads of both.
        expert_width: width of the action expert; its heads have the size of the language model's.
        integration_steps: Euler steps from noise to a plan.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    image_height: PositiveInt = 64
    image_width: PositiveInt = 112
    image_channels: PositiveInt = 16
    image_frames: Annotated[int, Field(ge=1, le=IMAGE_FRAMES)] = 1
    tokens_per_image: PositiveInt = 4
    width: PositiveInt = 64
    layers: PositiveInt = 2
    heads: PositiveInt = 4
    expert_width: PositiveInt = 64
    integration_steps: PositiveInt = 10

    @model_validator(mode="after")
    def _fits(self) -> "ToyPolicyConfig":
        if self.width % self.heads:
            raise ValueError(f"width {self.width} is not a multiple of heads {self.heads}")
        if self.image_height % 16 or self.image_width % 16:
            raise ValueError(f"image size {self.image_height} x {self.image_width} is not a multiple of 16")
        return self

    @property
    def image_tokens(self) -> int:
        """Tokens of all images together."""
        return CAMERAS * self.image_frames * self.tokens_per_image

    @property
    def head_width(self) -> int:
        """Width of one attention head."""
        return self.width // self.heads
