"""From keys of samples to the samples themselves. Needs no torch; `torch_dataset` wraps it for a DataLoader."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Protocol

from olt_datasets.mixtures.mixture import Mixture
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.policy.sample import PolicySample, SampleKey


class SampleStore(Protocol):
    """What a clip store is to a dataset."""

    def load_samples(self, keys: Sequence[SampleKey], image_size: tuple[int, int] | None = None) -> list[PolicySample]:
        """The samples at the keys' clips and times, with images scaled to (height, width)."""
        ...


class MixtureDataset:
    """The samples of a mixture; each clip store is opened once, when its first sample is asked for.

    Args:
        mixture: which samples there are.
        image_size: height and width of the images that the policy takes; None for those of the clips.
        open_store: opens the clip store in a folder.
    """

    def __init__(
        self,
        mixture: Mixture,
        image_size: tuple[int, int] | None,
        open_store: Callable[[Path], SampleStore] = ClipStore,
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
        return self.load_batch([key])[0]

    def load_batch(self, keys: Sequence[SampleKey]) -> list[PolicySample]:
        """Load samples in the order of `keys`; every clip is decoded once."""
        loaded = {
            key: sample
            for store in sorted({key.store for key in keys})
            for key, sample in self._load_from(store, [key for key in keys if key.store == store])
        }
        return [loaded[key] for key in keys]

    def _load_from(self, store: str, keys: Sequence[SampleKey]) -> Iterator[tuple[SampleKey, PolicySample]]:
        if store not in self._stores:
            self._stores[store] = self._open_store(Path(store))
        return zip(keys, self._stores[store].load_samples(keys, self.image_size), strict=True)
