"""From keys of samples to the samples themselves. Needs no torch; `torch_dataset` wraps it for a DataLoader."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

from olt_datasets.mixture import Mixture
from olt_toolkit.clip_store import ClipStore
from olt_toolkit.sample import PolicySample, SampleKey


class SampleStore(Protocol):
    """What a clip store is to a dataset."""

    def load_sample(self, key: SampleKey, image_size: tuple[int, int] | None = None) -> PolicySample:
        """The sample of a clip at t0, with images scaled to (height, width)."""
        ...


class MixtureDataset:
    """The samples of a mixture; each clip store is opened once, when its first sample is asked for.

    Args:
        mixture: which samples there are.
        image_size: height and width of the images that the policy takes.
        open_store: opens the clip store in a folder.
    """

    def __init__(
        self, mixture: Mixture, image_size: tuple[int, int], open_store: Callable[[Path], SampleStore] = ClipStore
    ) -> None:
        self.image_size = image_size
        self._items = len(mixture)
        self._open_store = open_store
        self._stores: dict[str, SampleStore] = {}

    def __len__(self) -> int:
        """Items per epoch."""
        return self._items

    def load(self, key: SampleKey) -> PolicySample:
        """Load one sample.

        Raises:
            InputError: its store, clip or time is missing or damaged.
        """
        if key.store not in self._stores:
            self._stores[key.store] = self._open_store(Path(key.store))
        return self._stores[key.store].load_sample(key, self.image_size)

    def load_batch(self, keys: Sequence[SampleKey]) -> list[PolicySample]:
        """Load the samples of one batch, in the order of `keys`."""
        return [self.load(key) for key in keys]
