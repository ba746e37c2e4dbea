"""The language model: a small causal transformer that reads images and history and says the future word by word.

The sequence is [image tokens | 48 history words | future-start | 128 future words]. Everything up to and including
future-start is the prefix; the action expert sees the prefix and nothing after it.

Where the toy differs from the real model: no text, chat template or reasoning; learned positions in place of rotary
ones. The real model starts from pre-training, the toy from nothing and with a minute to learn, so it gets four helps:
words start out as smooth functions of the value that they say; future-start carries the measured motion and a glance
at all image tokens, so that attention need not find them first; and Stage 1 hides some of the words said so far, so
that the answer must come from images and history; and Stage 1 also asks future-start for the whole future in numbers,
which teaches the image encoder faster than words do.
"""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from olt_sft_recipes.image_encoder import ImageEncoder
from olt_sft_recipes.tokens import FUTURE_BINS, FUTURE_TOKENS, HISTORY_BINS, HISTORY_TOKENS, VOCABULARY_SIZE
from olt_sft_recipes.toy_config import ToyPolicyConfig
from olt_sft_recipes.toy_inputs import MOTION_FEATURES

KeysValues = tuple[Tensor, Tensor]
"""Keys and values of one layer, each (batch, heads, tokens, head width)."""


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

    def __init__(self, config: ToyPolicyConfig) -> None:
        super().__init__()
        width = config.width
        self.image_encoder = ImageEncoder(config)
        self.words = nn.Embedding(VOCABULARY_SIZE, width)
        self.future_start = nn.Parameter(0.02 * torch.randn(width))
        self.glance = nn.Sequential(
            nn.Linear(config.image_tokens * width + MOTION_FEATURES, 2 * width), nn.GELU(), nn.Linear(2 * width, width)
        )
        self.positions = nn.Parameter(0.02 * torch.randn(HISTORY_TOKENS + 1 + FUTURE_TOKENS, width))
        self.blocks = nn.ModuleList([CausalBlock(config) for _ in range(config.layers)])
        self.norm = nn.LayerNorm(width)
        self.outlook = nn.Linear(width, FUTURE_TOKENS)
        with torch.no_grad():
            self.words.weight.copy_(torch.cat([smooth_words(FUTURE_BINS, width), smooth_words(HISTORY_BINS, width)]))

    def forward(
        self, images: Tensor, history_tokens: Tensor, motion: Tensor, future_tokens: Tensor, hidden: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Predict every future word from what comes before it, and the whole future from the prefix alone.

        Args:
            images: (batch, cameras, frames, 3, H, W) uint8.
            history_tokens: (batch, 48) words.
            motion: (batch, features) of the history.
            future_tokens: (batch, 128) words, given as if the model had said them itself.
            hidden: (batch, 128) bool: which of them are hidden from those after; future-start stands in their place.

        Returns:
            States (batch, 128, width) from which `logits` reads each next word, and normalised actions (batch, 64, 2)
            as future-start sees them.
        """
        seen, history, start = self._embed_prefix(images, history_tokens, motion)
        said = torch.where(hidden[:, :-1, None], start, self.words(future_tokens[:, :-1]))
        sequence = torch.cat([history, start, said], dim=1) + self.positions[:-1]
        states, _ = self._run(torch.cat([seen, sequence], dim=1))
        spoken = self.norm(states[:, -FUTURE_TOKENS:])
        return spoken, self.outlook(start[:, 0]).unflatten(-1, (-1, 2))

    def logits(self, spoken: Tensor) -> Tensor:
        """Logits (..., 3000) over the future words for states (..., width)."""
        return spoken @ self.words.weight[:FUTURE_BINS].T

    def look(self, images: Tensor, history_tokens: Tensor, motion: Tensor) -> Tensor:
        """Normalised actions (batch, 64, 2) as future-start sees them, without running the transformer."""
        _, _, start = self._embed_prefix(images, history_tokens, motion)
        return self.outlook(start[:, 0]).unflatten(-1, (-1, 2))

    def prefix_cache(self, images: Tensor, history_tokens: Tensor, motion: Tensor) -> list[KeysValues]:
        """Keys and values of every layer for the prefix, which ends with future-start."""
        seen, history, start = self._embed_prefix(images, history_tokens, motion)
        sequence = torch.cat([history, start], dim=1) + self.positions[: HISTORY_TOKENS + 1]
        _, cache = self._run(torch.cat([seen, sequence], dim=1))
        return cache

    def _embed_prefix(self, images: Tensor, history_tokens: Tensor, motion: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Image tokens, history words and future-start, each (batch, tokens, width) and still without positions."""
        seen = self.image_encoder(images)
        start = self.future_start + self.glance(torch.cat([seen.flatten(1), motion], dim=1))
        return seen, self.words(history_tokens), start[:, None]

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


def smooth_words(bins: int, width: int) -> Tensor:
    """First embeddings (bins, width) of words that say values: log-spaced waves, so that neighbours are alike."""
    values = torch.linspace(-1.0, 1.0, bins)[:, None]
    angles = math.pi * values * torch.logspace(0.0, math.log10(bins / 32), width // 2)
    return 0.3 * torch.cat([angles.sin(), angles.cos()], dim=-1)
