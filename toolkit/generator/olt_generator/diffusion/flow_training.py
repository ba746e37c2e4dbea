"""Flow matching of the conditioned model: what a sample is made of, and its loss.

z_sigma = (1 - sigma) z + sigma eps, the model tells eps - z (paper, section Training; docs/formats/generator.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from olt_generator.diffusion.conditioned_model import Conditions
from olt_generator.diffusion.memory_bank import ConditionViews
from olt_generator.diffusion.sampling import shift_sigma
from olt_generator.diffusion.splits import Split
from olt_generator.diffusion.training_clips import TrainingClip
from olt_generator.diffusion.training_settings import FlowSettings
from olt_generator.diffusion.view_graph import CONDITIONS, MOST_CONDITIONS, VIEWS
from olt_generator.diffusion.warp_control import no_warp, vace_control
from olt_generator.seeds import derive_seed, make_generator

_GENERATED = len(VIEWS) - 1
Tree = TypeVar("Tree")


class ClipSource(Protocol):
    """Where training clips come from: `training_cache.TrainingCache`, or `released_cache.ReleasedCache`."""

    def numbers(self, split: Split) -> list[int]:
        """The clips of a split."""
        ...

    def clip(self, number: int) -> TrainingClip:
        """The tensors of a clip, in single precision."""
        ...


@dataclass(frozen=True)
class FlowBatch:
    """Samples of a step.

    Attributes:
        latents, target: (b, 16, t, h, w) noised latents, and the velocities that the model should tell.
        sigma: (b,) noise levels.
        conditions: of the views.
        weight: (b,) of the losses.
        visibility: (b, 1, t, h, w) 0 to 1, how far a warp saw each cell.
    """

    latents: Tensor
    target: Tensor
    sigma: Tensor
    conditions: Conditions
    weight: Tensor
    visibility: Tensor


class FlowTraining:
    """Draws samples of a cache, and tells the losses of a model on them.

    Args:
        prompt, empty: (l, text_dim) embeddings of the prompt, and of none.
    """

    def __init__(self, cache: ClipSource, settings: FlowSettings, seed: int, prompt: Tensor, empty: Tensor) -> None:
        self._cache, self._settings, self._seed = cache, settings, seed
        self._numbers = cache.numbers("train")
        self._prompt, self._empty = prompt, empty

    def losses(self, model: nn.Module, numbers: list[int]) -> Tensor:
        """Weighted mean square errors (b,) of the samples of these numbers, cells weighted by `seen_weight`."""
        device = next(model.parameters()).device
        batch = move(self.draw(numbers), device)
        velocity = model(batch.latents, batch.sigma, batch.conditions)
        errors = ((velocity.float() - batch.target) ** 2).mean(dim=1).flatten(1)
        weights = (1.0 - (1.0 - self._settings.seen_weight) * batch.visibility).flatten(1)
        return batch.weight * (errors * weights).sum(dim=1) / weights.sum(dim=1)

    def draw(self, numbers: Sequence[int]) -> FlowBatch:
        """The samples of these numbers; the same number is always the same sample. Views take turns."""
        settings = self._settings
        views = [1 + number % _GENERATED for number in numbers]
        drawn = [self._draw_one(number, view) for number, view in zip(numbers, views, strict=True)]
        latents, target, sigma, texts = (torch.stack([tensors[key] for tensors, _, _ in drawn]) for key in range(4))
        conditions = collect_conditions(
            [clip for _, clip, _ in drawn], views, texts, [seen for *_, seen in drawn], settings.use_warp
        )
        weight = [settings.rear_weight if view == _GENERATED else 1.0 for view in views]
        visibility = torch.stack([clip.visibility[view] for (_, clip, _), view in zip(drawn, views, strict=True)])
        return FlowBatch(latents, target, sigma, conditions, torch.tensor(weight), visibility)

    def _draw_one(self, number: int, view: int) -> tuple[list[Tensor], TrainingClip, list[Tensor]]:
        """Noised latents, target, noise level and text; the clip; the latents of what the view is conditioned on."""
        settings, draw = self._settings, make_generator("flow sample", self._seed, number)
        noises = torch.Generator().manual_seed(derive_seed("flow noise", self._seed, number))
        clip = self._cache.clip(self._numbers[int(draw.integers(len(self._numbers)))])
        sigma = torch.tensor(float(shift_sigma(np.array(draw.random()), settings.shift)))
        clean = clip.latents[view]
        noise = torch.randn(clean.shape, generator=noises)
        text = self._empty if draw.random() < settings.text_drop else self._prompt
        seen = []
        for condition in CONDITIONS[view]:
            chance, least, most = settings.front_noise if condition == 0 else settings.neighbour_noise
            level = draw.uniform(least, most) if draw.random() < chance else 0.0
            other = torch.randn(clean.shape, generator=noises)
            seen.append((1.0 - level) * clip.latents[condition] + level * other)
        return [(1.0 - sigma) * clean + sigma * noise, noise - clean, sigma, text], clip, seen


def collect_conditions(
    clips: Sequence[TrainingClip],
    views: Sequence[int],
    text: Tensor,
    seen: Sequence[Sequence[Tensor]],
    use_warp: bool = True,
) -> Conditions:
    """The conditions of one view of each clip.

    Args:
        text: (b, l, text_dim).
        seen: for each sample the latents (16, t, h, w) of the views that it is conditioned on (`CONDITIONS`).
    """
    slots = max(len(CONDITIONS[view]) for view in views)
    pairs = list(zip(clips, views, strict=True))
    filled = torch.tensor([[slot < len(CONDITIONS[view]) for slot in range(slots)] for view in views])
    # Empty slots hold the front view once more, which nobody looks at.
    padded = [list(CONDITIONS[view]) + [0] * (MOST_CONDITIONS - len(CONDITIONS[view])) for view in views]
    latents = [torch.stack([*own, *[own[0]] * (slots - len(own))]) for own in seen]
    rays = [clip.rays[ids[:slots]] for clip, ids in zip(clips, padded, strict=True)]
    warped = torch.stack([clip.warped[view] for clip, view in pairs])
    visibility = torch.stack([clip.visibility[view] for clip, view in pairs])
    return Conditions(
        text=text,
        camera=torch.tensor(views),
        rays=torch.stack([clip.rays[view] for clip, view in pairs]),
        motion=torch.stack([clip.motion for clip in clips]),
        control=vace_control(warped, visibility) if use_warp else no_warp(warped),
        views=ConditionViews(
            torch.stack(latents),
            torch.tensor([ids[:slots] for ids in padded]),
            torch.stack(rays),
            None if bool(filled.all()) else filled,
        ),
    )


def move(tree: Tree, device: torch.device) -> Tree:
    """A dataclass of tensors, dataclasses of them, and None, on a device."""
    anything: Any = tree
    if isinstance(tree, Tensor):
        anything = tree.to(device)
    elif tree is not None:
        anything = type(tree)(**{name: move(part, device) for name, part in vars(tree).items()})
    return anything
