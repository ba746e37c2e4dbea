"""The action expert: a transformer that turns noise into a planned trajectory by flow matching.

Its 64 tokens, one a waypoint, attend to each other in both directions and, layer by layer, to the keys and values that
the language model kept for the prefix (docs/formats/alpamayo.md).

Flow matching: t = 0 is noise, t = 1 is data, x_t = t x + (1 - t) noise, and the expert learns the velocity x - noise.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import torch
from torch import Tensor, nn
from torch.nn import functional

from olt_sft_recipes.toy.config import ToyPolicyConfig
from olt_sft_recipes.toy.language_model import KeysValues, Prefix, join_heads, make_perceptron, split_heads
from olt_toolkit.policy.contract import FUTURE_STEPS

ACTION_SIZE = 2
TIME_FREQUENCIES = 10
SPREAD = 0.5
"""How far normalised actions are taken to lie around the regression before anything is learned."""


class ExpertBlock(nn.Module):
    """One layer: attention to the prefix of the same layer of the language model and to all waypoints."""

    def __init__(self, config: ToyPolicyConfig) -> None:
        super().__init__()
        width = config.expert_width
        self.heads = config.heads
        self.attention_norm = nn.LayerNorm(width)
        self.queries_keys_values = nn.Linear(width, 3 * config.width, bias=False)
        self.attention_out = nn.Linear(config.width, width, bias=False)
        self.perceptron = make_perceptron(width)

    def forward(self, x: Tensor, prefix: KeysValues) -> Tensor:
        """Advance hidden states (batch, 64, expert width)."""
        projected = self.queries_keys_values(self.attention_norm(x)).chunk(3, dim=-1)
        queries, keys, values = (split_heads(part, self.heads) for part in projected)
        keys, values = torch.cat([prefix[0], keys], dim=2), torch.cat([prefix[1], values], dim=2)
        x = x + self.attention_out(join_heads(functional.scaled_dot_product_attention(queries, keys, values)))
        return x + self.perceptron(x)


class ActionExpert(nn.Module):
    """Predicts the velocity of noisy actions, given the language model's cache of the prefix."""

    def __init__(self, config: ToyPolicyConfig) -> None:
        super().__init__()
        self.integration_steps = config.integration_steps
        self.action_in = nn.Sequential(
            nn.Linear(2 * ACTION_SIZE + 2 * TIME_FREQUENCIES, config.expert_width),
            nn.SiLU(),
            nn.Linear(config.expert_width, config.expert_width),
        )
        self.waypoints = nn.Parameter(0.02 * torch.randn(FUTURE_STEPS, config.expert_width))
        self.blocks = nn.ModuleList([ExpertBlock(config) for _ in range(config.layers)])
        self.norm = nn.LayerNorm(config.expert_width)
        self.action_out = nn.Linear(config.expert_width, ACTION_SIZE)
        nn.init.zeros_(self.action_out.weight)
        nn.init.zeros_(self.action_out.bias)

    def forward(self, noisy: Tensor, time: Tensor, prefix: Prefix) -> Tensor:
        """Velocity (batch, 64, 2) of noisy actions (batch, 64, 2) at flow times (batch,).

        The network learns what is left of a guess: that of actions spread evenly around the model's regression. The
        toy's few steps do not suffice to find in the cache what the regression knows.
        """
        return self._velocity(noisy, FlowTime.of(time), prefix)

    def _velocity(self, noisy: Tensor, time: "FlowTime", prefix: Prefix) -> Tensor:
        waves = time.waves.expand(-1, FUTURE_STEPS, -1)
        x = self.action_in(torch.cat([noisy, waves, prefix.regressed], dim=-1)) + self.waypoints
        for block, cache in zip(self.blocks, prefix.cache, strict=True):
            x = block(x, cache)
        guess = prefix.regressed + time.factor * (noisy - time.share * prefix.regressed)
        return self.action_out(self.norm(x)) + guess

    def loss(self, actions: Tensor, time: Tensor, noise: Tensor, prefix: Prefix) -> Tensor:
        """Mean squared errors (batch,) of the velocity between noise and normalised actions, each (batch, 64, 2)."""
        share = time[:, None, None]
        noisy = share * actions + (1.0 - share) * noise
        return (self(noisy, time, prefix) - (actions - noise)).square().mean(dim=(1, 2))

    def sample(self, noise: Tensor, prefix: Prefix) -> Tensor:
        """Integrate noise (batch, 64, 2) to normalised actions by equal Euler steps."""
        x = noise
        for time in _euler_times(self.integration_steps, len(x)):
            x = x + self._velocity(x, time, prefix) / self.integration_steps
        return x


@dataclass(frozen=True)
class FlowTime:
    """What the expert makes of flow times.

    Attributes:
        share: (batch, 1, 1) the times.
        waves: (batch, 1, 20) of `fourier_features`.
        factor: (batch, 1, 1) of `spread_factor`.
    """

    share: Tensor
    waves: Tensor
    factor: Tensor

    @classmethod
    def of(cls, time: Tensor) -> "FlowTime":
        """That of times (batch,)."""
        share = time[:, None, None]
        return cls(share, fourier_features(time)[:, None], spread_factor(share))


@lru_cache(maxsize=8)
@torch.inference_mode(False)
def _euler_times(steps: int, batch: int) -> list[FlowTime]:
    return [FlowTime.of(torch.full((batch,), step / steps)) for step in range(steps)]


def spread_factor(time: Tensor) -> Tensor:
    """Factor by which noisy actions, apart from the middle, give the best guess of their velocity.

    With actions of SPREAD s around m, E[x - noise | x_t] = m + (t s^2 - (1 - t)) / (t^2 s^2 + (1 - t)^2) (x_t - t m).
    """
    variance = SPREAD**2
    return (variance * time - (1.0 - time)) / (variance * time**2 + (1.0 - time) ** 2)


def fourier_features(time: Tensor) -> Tensor:
    """Waves (batch, 20) of flow times (batch,), of log-spaced frequencies from 1 to 100, with unit mean square."""
    angles = 2.0 * math.pi * time[:, None] * torch.logspace(0.0, 2.0, TIME_FREQUENCIES)
    return math.sqrt(2.0) * torch.cat([angles.sin(), angles.cos()], dim=-1)


def draw_training_times(count: int, generator: torch.Generator) -> Tensor:
    """Flow times (count,) in [0, 0.999], 0.999 (1 - B) with B from Beta(1.5, 1): noise is seen more often.

    The distribution function of Beta(1.5, 1) is b^1.5, so B is a uniform draw to the power 2/3.
    """
    return 0.999 * (1.0 - torch.rand(count, generator=generator) ** (2.0 / 3.0))
