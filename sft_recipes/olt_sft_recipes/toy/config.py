"""The sizes of the toy policy."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, PositiveInt, field_validator, model_validator

from olt_generator.errors import InputError
from olt_toolkit.policy.contract import IMAGE_FRAMES
from olt_toolkit.rigs.contracts import DEFAULT_CONTRACT, CameraContract, find_contract


class ToyPolicyConfig(BaseModel):
    """Sizes of the toy policy; saved as `config.json` beside its weights.

    Attributes:
        rig: camera contract whose cameras it takes (`olt_toolkit.rigs.contracts`).
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

    rig: str = DEFAULT_CONTRACT.name
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

    @field_validator("rig")
    @classmethod
    def _is_known(cls, rig: str) -> str:
        try:
            return find_contract(rig).name
        except InputError as error:
            raise ValueError(str(error)) from error

    @model_validator(mode="after")
    def _fits(self) -> "ToyPolicyConfig":
        if self.width % self.heads:
            raise ValueError(f"width {self.width} is not a multiple of heads {self.heads}")
        if self.image_height % 16 or self.image_width % 16:
            raise ValueError(f"image size {self.image_height} x {self.image_width} is not a multiple of 16")
        return self

    @property
    def contract(self) -> CameraContract:
        """The cameras that it takes."""
        return find_contract(self.rig)

    @property
    def image_tokens(self) -> int:
        """Tokens of all images together."""
        return len(self.contract.cameras) * self.image_frames * self.tokens_per_image

    @property
    def head_width(self) -> int:
        """Width of one attention head."""
        return self.width // self.heads
