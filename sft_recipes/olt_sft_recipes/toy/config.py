"""The sizes of the toy policy."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from olt_generator.errors import InputError
from olt_toolkit.policy.contract import IMAGE_FRAMES
from olt_toolkit.rigs.contracts import DEFAULT_CONTRACT, CameraContract, find_contract

_MOST_WEIGHTS = 1 << 26


class ToyPolicyConfig(BaseModel):
    """Sizes of the toy policy, which fit any machine; saved as `config.json` beside its weights.

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
    image_height: Annotated[int, Field(ge=1, le=1024)] = 64
    image_width: Annotated[int, Field(ge=1, le=1024)] = 112
    image_channels: Annotated[int, Field(ge=1, le=128)] = 16
    image_frames: Annotated[int, Field(ge=1, le=IMAGE_FRAMES)] = 1
    tokens_per_image: Annotated[int, Field(ge=1, le=256)] = 4
    width: Annotated[int, Field(ge=1, le=512)] = 64
    layers: Annotated[int, Field(ge=1, le=32)] = 2
    heads: Annotated[int, Field(ge=1, le=64)] = 4
    expert_width: Annotated[int, Field(ge=1, le=512)] = 64
    integration_steps: Annotated[int, Field(ge=1, le=1000)] = 10

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
        cells = (self.image_height // 16) * (self.image_width // 16)
        weights = 4 * self.image_channels * cells * self.tokens_per_image * self.width
        if weights > _MOST_WEIGHTS:
            raise ValueError(f"images would become tokens by {weights} weights, more than {_MOST_WEIGHTS}; take fewer")
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
