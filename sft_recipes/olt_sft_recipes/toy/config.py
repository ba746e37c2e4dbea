"""The sizes of the toy policy."""

from typing import Annotated, Literal

from pydantic import BaseModel, Field, field_validator, model_validator

from olt_generator.errors import InputError
from olt_toolkit.policy.contract import IMAGE_FRAMES
from olt_toolkit.rigs.contracts import DEFAULT_CONTRACT, CameraContract, find_contract

PATCH = 4
"""Pixels of an image, in either direction, that become one cell of its features."""


class ToyPolicyConfig(BaseModel, frozen=True, extra="forbid"):
    """Sizes of the toy policy, which fit any machine; saved as `config.json` beside its weights.

    Attributes:
        rig: camera contract whose cameras it takes (`olt_toolkit.rigs.contracts`).
        image_height, image_width: pixels.
        image_top: rows that are cut off above; they show the sky.
        frames: which of the four frames of each camera it uses, 0 the oldest and 3 that at t0.
        cameras: indices of the cameras of the contract that it uses, in order; None for all.
        image_channels: channels of the features of images and of the bird's-eye grid.
        image_blocks: residual blocks that images pass.
        precision: of the convolutions of the image encoder; everything else is float32.
        width: width of the language model.
        layers: layers of the language model and of the action expert, which meet layer by layer.
        heads: attention heads of both.
        expert_width: width of the action expert; its heads have the size of the language model's.
        integration_steps: Euler steps from noise to a plan.
        plans_drawn: how many plans it draws.
        chooses_plan: whether its sight chooses among them and others (`plan_choice`), the first of which starts from no
            noise then; or the first draw is driven. Where no sample told the sight what is where, the first is driven.
    """

    rig: str = DEFAULT_CONTRACT.name
    image_height: Annotated[int, Field(ge=PATCH, le=1024)] = 96
    image_width: Annotated[int, Field(ge=PATCH, le=1024)] = 168
    image_top: Annotated[int, Field(ge=0, le=1023)] = 48
    frames: tuple[Annotated[int, Field(ge=0, lt=IMAGE_FRAMES)], ...] = (0, 3)
    cameras: tuple[Annotated[int, Field(ge=0)], ...] | None = None
    image_channels: Annotated[int, Field(ge=1, le=128)] = 32
    image_blocks: Annotated[int, Field(ge=0, le=32)] = 2
    precision: Literal["bfloat16", "float32"] = "bfloat16"
    width: Annotated[int, Field(ge=1, le=512)] = 96
    layers: Annotated[int, Field(ge=1, le=32)] = 2
    heads: Annotated[int, Field(ge=1, le=64)] = 4
    expert_width: Annotated[int, Field(ge=1, le=512)] = 64
    integration_steps: Annotated[int, Field(ge=1, le=1000)] = 5
    plans_drawn: Annotated[int, Field(ge=1, le=64)] = 2
    chooses_plan: bool = True

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
        rows = self.image_height - self.image_top
        if rows < PATCH or rows % PATCH or self.image_width % PATCH:
            raise ValueError(f"images of {rows} rows (below the top) x {self.image_width}: give multiples of {PATCH}")
        if not self.frames or sorted(set(self.frames)) != list(self.frames) or self.frames[-1] != IMAGE_FRAMES - 1:
            raise ValueError(f"frames {self.frames}: give rising numbers up to {IMAGE_FRAMES - 1}, the frame at t0")
        known = len(self.contract.cameras)
        used = self.camera_rows
        if not used or sorted(set(used)) != list(used) or used[-1] >= known:
            raise ValueError(f"cameras {self.cameras}: give rising rows of the {known} of contract {self.rig}")
        return self

    @property
    def contract(self) -> CameraContract:
        """The cameras that samples are loaded with."""
        return find_contract(self.rig)

    @property
    def camera_rows(self) -> tuple[int, ...]:
        """Which rows of a sample's cameras it uses."""
        return tuple(range(len(self.contract.cameras))) if self.cameras is None else self.cameras

    @property
    def camera_names(self) -> tuple[str, ...]:
        """The cameras that it uses."""
        return tuple(self.contract.cameras[row] for row in self.camera_rows)

    @property
    def feature_size(self) -> tuple[int, int]:
        """Height and width of an image's features."""
        return (self.image_height - self.image_top) // PATCH, self.image_width // PATCH

    @property
    def head_width(self) -> int:
        """Width of one attention head."""
        return self.width // self.heads
