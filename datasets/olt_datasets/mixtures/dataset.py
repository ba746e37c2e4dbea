"""A mixture as a torch data set and batch sampler: a DataLoader yields the dict of the public Alpamayo loader.

batches = MixtureBatchSampler(mixture, batch_size=8)
for batch in DataLoader(MixtureDataset(mixture, (320, 576)), batch_sampler=batches, num_workers=2): ...
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import torch
from torch.utils.data import Dataset, Sampler

from olt_datasets.mixtures.mixture import Mixture
from olt_datasets.mixtures.sample_cache import CacheOptions, SampleCache
from olt_generator.errors import InputError
from olt_generator.progress import Progress, silent
from olt_toolkit import ClipStore, PolicySample, SampleKey
from olt_toolkit.rigs.contracts import DEFAULT_CONTRACT, CameraContract


class MixtureDataset(Dataset[dict[str, Any]]):
    """The samples of a mixture by row of `Mixture.samples`; each clip store is opened once, at its first sample.

    As a torch data set it gives the fields of a sample by name: arrays as tensors that share their memory, `t0_us` and
    `clip_id` as they are (shapes: `PolicySample`). `MixtureBatchSampler` gives the rows.

    It keeps a table of the keys, 60 bytes a sample. Workers that are forked share it, to others it is sent.

    Args:
        image_size: height and width of the images that the policy takes; None for those of the clips.
        contract: the cameras that it takes.
        with_origin: whether samples tell where the pixels of their images come from (`PolicySample.image_origin`).
        with_truth: whether samples tell what is known of obstacles and holds.
        cache: folder in which all samples are kept decoded (`mixtures.sample_cache`), made here where it is not there;
            None to decode them each time.
        on_progress: told the share of the samples that are in a cache which is made.
        open_store: opens the clip store in a folder.
    """

    def __init__(
        self,
        mixture: Mixture,
        image_size: tuple[int, int] | None,
        open_store: Callable[[Path], ClipStore] = ClipStore,
        contract: CameraContract = DEFAULT_CONTRACT,
        with_origin: bool = False,
        with_truth: bool = False,
        cache: Path | None = None,
        on_progress: Progress = silent,
    ) -> None:
        if cache is not None and with_origin:
            raise InputError(f"{cache}: a sample cache does not keep where pixels come from; leave one of both out")
        self.image_size = image_size
        self._contract, self._with_origin, self._with_truth = contract, with_origin, with_truth
        # Arrow, not polars, whose threads do not live in forked workers; and no objects, whose counts would unshare it.
        samples = mixture.samples
        self._store_names = samples["store"].unique().sort().to_list()
        stores = samples["store"].cast(pl.Enum(self._store_names)).to_physical()
        self._columns = stores.to_numpy(), samples["clip_id"].to_arrow(), samples["t0_us"].to_numpy()
        self._open_store = open_store
        self._stores: dict[str, ClipStore] = {}
        self._cache = None if cache is None else self._make_cache(cache, on_progress)

    def __len__(self) -> int:
        """Distinct samples. An epoch may use one more than once, and some not at all."""
        return len(self._columns[0])

    def __getitem__(self, row: int) -> dict[str, Any]:
        return self.__getitems__([row])[0]

    def __getitems__(self, rows: Sequence[int]) -> list[dict[str, Any]]:
        """A whole batch, as a DataLoader asks for it: every clip is decoded once."""
        return [
            {
                name: torch.from_numpy(value) if isinstance(value, np.ndarray) else value
                for name, value in vars(sample).items()
                if value is not None
            }
            for sample in self.load_batch(self._keys(rows))
        ]

    def load_batch(self, keys: Sequence[SampleKey]) -> list[PolicySample]:
        """Samples in the order of `keys`; every clip is decoded once. InputError where one is missing or damaged."""
        if self._cache is not None:
            return self._cache.load(keys)
        loaded: dict[SampleKey, PolicySample] = {}
        for store in sorted({key.store for key in keys}):
            wanted = [key for key in keys if key.store == store]
            samples = self._store(store).load_samples(
                wanted, self.image_size, self._contract, self._with_origin, self._with_truth
            )
            loaded |= zip(wanted, samples, strict=True)
        return [loaded[key] for key in keys]

    def name_sample(self, key: SampleKey) -> str:
        """What tells a sample from any other, wherever its store is: what its clip holds, and the time."""
        return f"{self._store(key.store).info(key.clip_id).checksum} {key.clip_id} {key.t0_us}"

    def _store(self, name: str) -> ClipStore:
        if name not in self._stores:
            self._stores[name] = self._open_store(Path(name))
        return self._stores[name]

    def _make_cache(self, folder: Path, on_progress: Progress) -> SampleCache:
        options = CacheOptions(self.image_size, self._contract, self._with_truth)
        stores = {name: self._store(name) for name in self._store_names}
        return SampleCache(folder, self._keys(range(len(self))), stores, options, on_progress)

    def _keys(self, rows: Iterable[int]) -> list[SampleKey]:
        stores, clip_ids, times = self._columns
        return [SampleKey(self._store_names[stores[row]], clip_ids[int(row)].as_py(), int(times[row])) for row in rows]


class MixtureBatchSampler(Sampler[list[int]]):
    """The rows of one rank's batches (rows of `Mixture.samples`, as `MixtureDataset` takes them), epoch by epoch.

    The global batches of an epoch are the same at every world size and accumulation: training may go on with other
    numbers of ranks between epochs, and within one from any global batch on.

    In a partial last batch that does not divide by the world size, the ranks that are one item short take their first
    item of the epoch again, so that all ranks step alike.

    Args:
        batch_size: items in a global batch, that is of one optimizer step over all ranks.
        rank, world_size: this process and the number of processes.
        accumulation: forward passes per optimizer step; a rank's part of a global batch comes in so many batches.

    Raises:
        InputError: the mixture holds no item or fewer than there are ranks, or the sizes do not fit together.
    """

    def __init__(
        self, mixture: Mixture, batch_size: int, rank: int = 0, world_size: int = 1, accumulation: int = 1
    ) -> None:
        if 0 < len(mixture) < world_size:
            raise InputError(f"a mixture of {len(mixture)} samples cannot feed {world_size} ranks; use fewer")
        self._mixture = mixture
        self._batch_size, self._rank, self._world_size = batch_size, rank, world_size
        self._part_size, rest = divmod(batch_size, world_size * accumulation)
        if rest:
            raise InputError(
                f"global batch size {batch_size} must be a multiple of {world_size} ranks x {accumulation} passes"
            )
        self.set_epoch(0)

    def set_epoch(self, epoch: int, start_batch: int = 0) -> None:
        """Choose the epoch, and the global batch to start from when training resumes; what is before is not built."""
        self._epoch = self._mixture.epoch(epoch, self._batch_size, self._rank, self._world_size, start_batch)
        full, rest = divmod(len(self._mixture), self._batch_size)
        self._last = -(-rest // self._world_size)
        passes = self._batch_size // (self._world_size * self._part_size)
        passes_of_last = -(-self._last // self._part_size) if start_batch <= full else 0
        self._length = max(0, full - start_batch) * passes + passes_of_last

    def __len__(self) -> int:
        return self._length

    def __iter__(self) -> Iterator[list[int]]:
        for batches in self._epoch.rows():
            if batches.shape[1] * self._world_size == self._batch_size:
                yield from batches.reshape(-1, self._part_size).tolist()
            else:
                yield from self._divide_last(batches[0].tolist())

    def _divide_last(self, rows: list[int]) -> Iterator[list[int]]:
        if len(rows) < self._last:
            rows.append(int(self._epoch.rows_of(0)[0]))
        yield from (rows[start : start + self._part_size] for start in range(0, len(rows), self._part_size))
