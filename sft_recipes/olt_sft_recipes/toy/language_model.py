"""The language model: a small causal transformer that reads images and history and tells the future token by token.

The sequence is [image tokens | 48 history tokens | future-start | 128 future tokens]. Everything up to and including
future-start is the prefix; the action expert sees the prefix and nothing after it (docs/formats/alpamayo.md).

Where the toy differs from the real model: no text, chat template or reasoning; learned positions in place of rotary
ones. The real model starts from pre-training, the toy from nothing and with minutes to learn, so it gets four helps:
token embeddings start out as smooth functions of the value that they stand for; future-start carries the measured
motion and a projection of all image tokens, so that attention need not find them first; Stage 1 hides some of the
earlier future tokens, so that the answer must come from images and history; and a regression head on future-start is
trained on the whole future at once, which teaches the image encoder faster than tokens do.
"""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn
from torch.nn import functional

from olt_sft_recipes.toy.config import ToyPolicyConfig
from olt_sft_recipes.toy.image_encoder import IMAGE_TOKENS, ImageEncoder, Sight
from olt_sft_recipes.toy.inputs import MOTION_FEATURES, PolicyInputs
from olt_sft_recipes.toy.tokens import FUTURE_BINS, FUTURE_TOKENS, HISTORY_BINS, HISTORY_TOKENS, VOCABULARY_SIZE

KeysValues = tuple[Tensor, Tensor]
"""Keys and values of one layer, each (batch, heads, tokens, head width)."""


@dataclass(frozen=True)
class Prefix:
    """What the model makes of the prefix, for the action expert.

    Attributes:
        cache: keys and values of every layer up to future-start.
        regressed: (batch, 64, 2) normalised actions of the regression head. Toy only.
        sight: of the image encoder. Toy only.
    """

    cache: list[KeysValues]
    regressed: Tensor
    sight: Sight

    def repeated(self, count: int) -> "Prefix":
        """That of one observation, for as many plans."""
        cache = [(keys.expand(count, -1, -1, -1), values.expand(count, -1, -1, -1)) for keys, values in self.cache]
        return replace(self, cache=cache, regressed=self.regressed.expand(count, -1, -1))


class CausalBlock(nn.Module):
    """One layer: attention to what came before, then a two-layer perceptron."""

    def __init__(self, config: ToyPolicyConfig) -> None:
        super().__init__()
        width = config.width
        self.heads = config.heads
        self.attention_norm = nn.LayerNorm(width)
        self.queries_keys_values = nn.Linear(width, 3 * width, bias=False)
        self.attention_out = nn.Linear(width, width, bias=False)
        self.perceptron = make_perceptron(width)

    def forward(self, x: Tensor) -> tuple[Tensor, KeysValues]:
        """Advance hidden states (batch, tokens, width); also returns the layer's keys and values."""
        projected = self.queries_keys_values(self.attention_norm(x)).chunk(3, dim=-1)
        queries, keys, values = (split_heads(part, self.heads) for part in projected)
        attended = functional.scaled_dot_product_attention(queries, keys, values, is_causal=True)
        x = x + self.attention_out(join_heads(attended))
        return x + self.perceptron(x), (keys, values)


class VisionLanguageModel(nn.Module):
    """Image encoder and causal transformer; what Stage 1 trains and Stage 2 freezes."""

    sight_taught: Tensor
    """(1,) 1 once a sample has told its sight what is where: nobody chooses plans by a sight that never learned."""

    def __init__(self, config: ToyPolicyConfig) -> None:
        super().__init__()
        width = config.width
        self.image_encoder = ImageEncoder(config)
        self.token_embedding = nn.Embedding(VOCABULARY_SIZE, width)
        self.future_start = nn.Parameter(0.02 * torch.randn(width))
        self.prefix_projection = nn.Sequential(
            nn.Linear(IMAGE_TOKENS * width + MOTION_FEATURES, 2 * width),
            nn.GELU(),
            nn.Linear(2 * width, width),
        )
        self.positions = nn.Parameter(0.02 * torch.randn(HISTORY_TOKENS + 1 + FUTURE_TOKENS, width))
        self.blocks = nn.ModuleList([CausalBlock(config) for _ in range(config.layers)])
        self.norm = nn.LayerNorm(width)
        self.regression_head = nn.Linear(width, FUTURE_TOKENS)
        self.register_buffer("sight_taught", torch.zeros(1))
        with torch.no_grad():
            smooth = torch.cat([smooth_embedding(bins, width) for bins in (FUTURE_BINS, HISTORY_BINS)])
            self.token_embedding.weight.copy_(smooth)

    def forward(self, inputs: PolicyInputs, future_tokens: Tensor, hidden: Tensor) -> tuple[Tensor, Tensor, Sight]:
        """Predict every future token from what comes before it, and the whole future from the prefix alone.

        Args:
            inputs: images, history tokens and motion of a batch.
            future_tokens: (batch, 128) tokens of the true future.
            hidden: (batch, 128) bool: which of them are hidden from those after; future-start stands in their place.

        Returns:
            States (batch, 128, width) from which `logits` reads each next token, normalised actions (batch, 64, 2) of
            the regression head, and what the image encoder makes of the images.
        """
        sight, history, start = self._embed_prefix(inputs)
        future = torch.where(hidden[:, :-1, None], start, self.token_embedding(future_tokens[:, :-1]))
        sequence = torch.cat([history, start, future], dim=1) + self.positions[:-1]
        states, _ = self._run(torch.cat([sight.tokens, sequence], dim=1))
        return self.norm(states[:, -FUTURE_TOKENS:]), self._regress(start), sight

    def logits(self, states: Tensor) -> Tensor:
        """Logits (..., 3000) over the future tokens for states (..., width)."""
        return states @ self.token_embedding.weight[:FUTURE_BINS].T

    def regress(self, inputs: PolicyInputs) -> tuple[Tensor, Sight]:
        """Normalised actions (batch, 64, 2) of the regression head and the sight, without running the transformer."""
        sight, _, start = self._embed_prefix(inputs)
        return self._regress(start), sight

    @torch.no_grad()
    def read_prefix(self, inputs: PolicyInputs) -> Prefix:
        """What the expert sees, without gradient."""
        sight, history, start = self._embed_prefix(inputs)
        sequence = torch.cat([history, start], dim=1) + self.positions[: HISTORY_TOKENS + 1]
        _, cache = self._run(torch.cat([sight.tokens, sequence], dim=1))
        return Prefix(cache, self._regress(start), sight)

    def _embed_prefix(self, inputs: PolicyInputs) -> tuple[Sight, Tensor, Tensor]:
        """Sight, history tokens and future-start, (batch, tokens, width) and still without positions."""
        sight = self.image_encoder(inputs.images, inputs.route)
        projected = self.prefix_projection(torch.cat([sight.tokens.flatten(1), inputs.motion], dim=1))
        return sight, self.token_embedding(inputs.history_tokens), (self.future_start + projected)[:, None]

    def _regress(self, start: Tensor) -> Tensor:
        return self.regression_head(start[:, 0]).unflatten(-1, (-1, 2))

    def _run(self, x: Tensor) -> tuple[Tensor, list[KeysValues]]:
        cache = []
        for block in self.blocks:
            x, keys_values = block(x)
            cache.append(keys_values)
        return x, cache


def make_perceptron(width: int) -> nn.Sequential:
    """Norm, expansion by four, contraction."""
    return nn.Sequential(
        nn.LayerNorm(width),
        nn.Linear(width, 4 * width, bias=False),
        nn.GELU(),
        nn.Linear(4 * width, width, bias=False),
    )


def split_heads(x: Tensor, heads: int) -> Tensor:
    """(batch, tokens, heads * width) to (batch, heads, tokens, width)."""
    return x.unflatten(-1, (heads, -1)).transpose(1, 2)


def join_heads(x: Tensor) -> Tensor:
    """(batch, heads, tokens, width) to (batch, tokens, heads * width)."""
    return x.transpose(1, 2).flatten(2)


def smooth_embedding(bins: int, width: int) -> Tensor:
    """First embeddings (bins, width) of tokens that stand for values: log-spaced waves; neighbours are alike."""
    values = torch.linspace(-1.0, 1.0, bins)[:, None]
    angles = math.pi * values * torch.logspace(0.0, math.log10(bins / 32), width // 2)
    return 0.3 * torch.cat([angles.sin(), angles.cos()], dim=-1)
