"""The cross-view memory bank: what a view is told of the views that were made, or recorded, before it.

Paper, section Cross-View Memory Bank and appendix Sigma-Dependent Memory Gates.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from olt_generator.diffusion.config import ConditioningConfig
from olt_generator.diffusion.geometry_encoder import zero_linear


@dataclass(frozen=True)
class ConditionViews:
    """The views that others are conditioned on, in slots: as many as the view of the batch with most of them has.

    Attributes:
        latents: (b, s, 16, t, h, w) normalised latents.
        camera: (b, s) view ids; anything where the slot is empty.
        rays: (b, s, 6, t, h / 2, w / 2), as `geometry_encoder.GeometryEncoder` takes them.
        filled: (b, s) bool, the first slot always True; None where all slots are filled.
    """

    latents: Tensor
    camera: Tensor
    rays: Tensor
    filled: Tensor | None = None


@dataclass(frozen=True)
class Memory:
    """What target tokens attend to; it depends on no noise level, so one serves all steps of a view.

    Attributes:
        dense: (b, s, t, p, d), a token for each of the p tokens of a frame.
        semantic: (b, s, t, q, d), a summary of each frame.
        filled: (b, s) bool or None, as of `ConditionViews`.
    """

    dense: Tensor
    semantic: Tensor
    filled: Tensor | None


class MemoryBank(nn.Module):
    """Makes the memory from tokens of the condition views: adapter blocks, then a resampler."""

    def __init__(self, dim: int, heads: int, config: ConditioningConfig) -> None:
        super().__init__()
        hidden = config.adapter_expansion * dim
        self.adapters = nn.ModuleList(_ResidualMlp(dim, hidden) for _ in range(config.adapter_blocks))
        self.norm = nn.LayerNorm(dim)
        self.resampler = Resampler(dim, heads, config.queries)

    def forward(self, tokens: Tensor, filled: Tensor | None) -> Memory:
        """Memory of tokens (b, s, t, p, d) of latents with their geometry encoding."""
        for adapter in self.adapters:
            tokens = adapter(tokens)
        dense = self.norm(tokens)
        return Memory(dense, self.resampler(dense), filled)


class Resampler(nn.Module):
    """Learned queries that look at the tokens of one frame (Jaegle et al., Perceiver, 2021)."""

    def __init__(self, dim: int, heads: int, queries: int) -> None:
        super().__init__()
        self.queries = nn.Parameter(torch.randn(queries, dim) / dim**0.5)
        self.attention = CrossAttention(dim, heads)
        self.mlp = _ResidualMlp(dim, 2 * dim)
        self.norm = nn.LayerNorm(dim)

    def forward(self, tokens: Tensor) -> Tensor:
        """Summaries (..., q, d) of frames (..., p, d)."""
        frames = tokens.flatten(0, -3)
        queries = self.queries.to(frames.dtype).expand(len(frames), -1, -1)
        summary = self.norm(self.mlp(queries + self.attention(queries, *self.attention.read(frames))))
        return summary.unflatten(0, tokens.shape[:-2])


class CrossAttention(nn.Module):
    """Multi-head attention to other tokens; queries and keys are normalised over all heads, as in the backbone."""

    def __init__(self, dim: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.to_q, self.to_k, self.to_v, self.to_out = (nn.Linear(dim, dim) for _ in range(4))
        self.norm_q, self.norm_k = nn.RMSNorm(dim, eps=1e-6), nn.RMSNorm(dim, eps=1e-6)

    def read(self, tokens: Tensor) -> tuple[Tensor, Tensor]:
        """Keys and values (..., d) of tokens (..., d)."""
        return self.norm_k(self.to_k(tokens)), self.to_v(tokens)

    def forward(self, tokens: Tensor, keys: Tensor, values: Tensor, mask: Tensor | None = None) -> Tensor:
        """What tokens (b, n, d) draw from keys and values (b, m, d); mask (b, m) is True where they may look."""
        # Autocast leaves norms in single precision and linear layers in half; attention wants one type.
        queries = self.norm_q(self.to_q(tokens)).to(values.dtype)
        by_head = (x.unflatten(-1, (self.heads, -1)).transpose(1, 2) for x in (queries, keys.to(values.dtype), values))
        allowed = None if mask is None else mask[:, None, None, :]
        drawn = nn.functional.scaled_dot_product_attention(*by_head, attn_mask=allowed)
        return self.to_out(drawn.transpose(1, 2).flatten(2))


class WindowedAttention(nn.Module):
    """Target tokens of a frame look at the memory of that frame and its neighbours; says nothing until trained."""

    def __init__(self, dim: int, heads: int, window: int) -> None:
        super().__init__()
        self.window = window
        self.attention = CrossAttention(dim, heads)
        self.attention.to_out = zero_linear(dim, dim)
        # What a key says of how many frames it is away.
        self.offsets = nn.Parameter(torch.zeros(2 * window + 1, dim))

    def forward(self, tokens: Tensor, memory: Tensor, filled: Tensor | None) -> Tensor:
        """What tokens (b, t, p, d), normalised, draw from memory (b, s, t, m, d) of which slots (b, s) are filled."""
        keys, values = self.attention.read(memory)
        drawn = []
        for frame in range(tokens.shape[1]):
            first, end = max(0, frame - self.window), min(tokens.shape[1], frame + self.window + 1)
            offsets = self.offsets[first - frame + self.window : end - frame + self.window, None].to(keys)
            seen, told = keys[:, :, first:end] + offsets, values[:, :, first:end]
            mask = None
            if filled is not None:
                mask = filled[:, :, None, None].expand(seen.shape[:-1]).flatten(1)
            drawn.append(self.attention(tokens[:, frame], seen.flatten(1, 3), told.flatten(1, 3), mask))
        return torch.stack(drawn, dim=1)


class SigmaGates(nn.Module):
    """Gates of dense and semantic memory that depend on the noise level: sigmoid(Linear(SiLU(Linear(sigma)))).

    Computed in single precision whatever autocast says: near a sigmoid of -1.4 a step of bfloat16 is larger than
    what a training step changes, and gates would never learn.
    """

    def __init__(self, hidden: int, bias: float) -> None:
        super().__init__()
        last = zero_linear(hidden, 2)
        nn.init.constant_(last.bias, bias)
        self.mlp = nn.Sequential(nn.Linear(1, hidden), nn.SiLU(), last)

    def forward(self, sigma: Tensor) -> tuple[Tensor, Tensor]:
        """Gates (b,) float32 of dense and semantic memory at noise levels (b,) from 0 to 1."""
        with torch.autocast(sigma.device.type, enabled=False):
            dense, semantic = torch.sigmoid(self.mlp(sigma.float()[:, None])).unbind(1)
        return dense, semantic


class MemoryAttention(nn.Module):
    """What one block adds to its target tokens from the memory."""

    def __init__(self, dim: int, heads: int, config: ConditioningConfig) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(dim)
        self.dense = WindowedAttention(dim, heads, config.window)
        self.semantic = WindowedAttention(dim, heads, config.window)
        self.gates = SigmaGates(config.gate_hidden, config.gate_bias)

    def forward(self, hidden: Tensor, memory: Memory, sigma: Tensor) -> Tensor:
        """What to add to hidden states (b, t p, d) at noise levels (b,)."""
        frames = memory.dense.shape[2]
        tokens = self.norm(hidden.to(self.norm.weight.dtype)).unflatten(1, (frames, -1))
        dense_gate, semantic_gate = (gate.to(hidden.dtype)[:, None, None] for gate in self.gates(sigma))
        dense = self.dense(tokens, memory.dense, memory.filled).flatten(1, 2)
        semantic = self.semantic(tokens, memory.semantic, memory.filled).flatten(1, 2)
        return dense_gate * dense.to(hidden.dtype) + semantic_gate * semantic.to(hidden.dtype)


class _ResidualMlp(nn.Module):
    def __init__(self, dim: int, hidden: int) -> None:
        super().__init__()
        self.mlp = nn.Sequential(nn.LayerNorm(dim), nn.Linear(dim, hidden), nn.SiLU(), zero_linear(hidden, dim))

    def forward(self, tokens: Tensor) -> Tensor:
        return tokens + self.mlp(tokens)
