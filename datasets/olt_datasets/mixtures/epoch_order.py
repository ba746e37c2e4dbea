"""The order of one epoch, of which any stretch of batches is computed alone, in arrays.

A batch is shuffled by numbers that a generator gives to its items, and a generator can be moved on to any item. A
component gives its samples pass after pass, each a new permutation of all, and a batch begins in its passes where those
before it end. So what lies before a batch is counted and never built.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from olt_datasets.mixtures.batches import batch_counts

Rows = NDArray[np.int64]

ITEMS_AT_ONCE = 65_536
"""Batches are computed so many items at a time: few enough for the processor's cache."""


@dataclass(frozen=True)
class Draw:
    """What a component gives to an epoch: so many `items`, pass after pass from the permutations of its `rows` rows."""

    items: int
    rows: int
    permute: Callable[[int], Rows]


class EpochOrder:
    """The rows of all batches of one epoch.

    Rows are counted through all components; `seed` is that of the shuffle.
    """

    def __init__(self, draws: Sequence[Draw], batch_size: int, seed: int) -> None:
        self._batch_size, self._seed = batch_size, seed
        self._counts = batch_counts([draw.items for draw in draws], batch_size)
        self._starts = np.zeros((len(self._counts) + 1, len(draws)), np.int64)
        np.cumsum(self._counts, axis=0, out=self._starts[1:])
        self._firsts = list(accumulate((draw.rows for draw in draws), initial=0))
        self._lengths = [draw.rows for draw in draws]
        # Passes follow each other: one that was left is not asked for again.
        self._passes = [lru_cache(maxsize=1)(draw.permute) for draw in draws]

    def __len__(self) -> int:
        """Batches of the epoch; the last may be partial."""
        return len(self._counts)

    def batches(self, start: int = 0) -> Iterator[Rows]:
        """The rows of the batches from one on, some at a time: (batches, batch size), then (1, rest) if any."""
        full = len(self) - int(self._counts[-1].sum() < self._batch_size)
        at_once = max(1, ITEMS_AT_ONCE // self._batch_size)
        for first in range(start, full, at_once):
            yield self._order(first, min(first + at_once, full))
        if start <= full < len(self):
            yield self._order(full, len(self))

    def batch(self, index: int) -> Rows:
        """The rows of one batch."""
        return self._order(index, index + 1)[0]

    def _order(self, first: int, stop: int) -> Rows:
        """The rows of full batches, or of a partial one: (batches, items)."""
        counts = self._counts[first:stop]
        owners = np.repeat(np.tile(np.arange(counts.shape[1]), len(counts)), counts.ravel()).reshape(len(counts), -1)
        bits = np.random.PCG64(self._seed).advance(first * self._batch_size)
        shuffle = np.argsort(np.random.Generator(bits).random(owners.shape), axis=1)
        owners = np.take_along_axis(owners, shuffle, axis=1)
        rows = np.empty(owners.shape, np.int64)
        for place in np.flatnonzero(counts.any(axis=0)):
            rows[owners == place] = self._take(int(place), *self._starts[[first, stop], place].tolist())
        return rows

    def _take(self, place: int, start: int, stop: int) -> Rows:
        """Rows of a component in the order of their use, from one use to another."""
        length = self._lengths[place]
        parts = [
            self._passes[place](index)[max(start - index * length, 0) : stop - index * length]
            for index in range(start // length, -(-stop // length))
        ]
        return self._firsts[place] + np.concatenate(parts)
