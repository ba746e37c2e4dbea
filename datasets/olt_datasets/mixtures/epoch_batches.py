"""The batches of one rank in one epoch."""

from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from typing import overload

from olt_datasets.mixtures.epoch_order import EpochOrder, Rows
from olt_toolkit.policy.sample import SampleKey


class EpochBatches(Sequence[list[SampleKey]]):
    """The keys of one rank's batches, made when they are asked for; see `Mixture.epoch`.

    Args:
        order: the rows of all ranks.
        keys: gives the keys of rows.
        items: which items of a global batch are this rank's.
        start: the global batch that is the first here.
    """

    def __init__(self, order: EpochOrder, keys: Callable[[Rows], list[SampleKey]], items: slice, start: int) -> None:
        self._order, self._keys, self._items, self._start = order, keys, items, start

    def __len__(self) -> int:
        return max(0, len(self._order) - self._start)

    @overload
    def __getitem__(self, index: int) -> list[SampleKey]: ...
    @overload
    def __getitem__(self, index: slice) -> list[list[SampleKey]]: ...
    def __getitem__(self, index: int | slice) -> list[SampleKey] | list[list[SampleKey]]:
        batches = range(self._start, self._start + len(self))[index]
        if isinstance(batches, int):
            return self._keys(self.rows_of(batches))
        return [self._keys(self.rows_of(batch)) for batch in batches]

    def __iter__(self) -> Iterator[list[SampleKey]]:
        for rows in self.rows():
            keys = iter(self._keys(rows.ravel()))
            yield from (list(islice(keys, rows.shape[1])) for _ in rows)

    def rows(self) -> Iterator[Rows]:
        """The same as rows of `Mixture.samples`, many batches at a time: (batches, items); a partial one alone."""
        return (rows[:, self._items] for rows in self._order.batches(self._start))

    def rows_of(self, batch: int) -> Rows:
        """Rows of `Mixture.samples` of this rank's part of one batch, counted from the start of the epoch."""
        return self._order.batch(batch)[self._items]
