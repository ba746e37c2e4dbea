"""Data that a recipe is given: a folder in PhysicalAI-AV layout, and the range of chunks that selects it."""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from olt_datasets.export.chunks import divide_into_chunks
from olt_datasets.export.contents import Contents
from olt_generator.errors import InputError
from olt_generator.progress import Progress, silent
from olt_sft_recipes.toy.tokens import FUTURE_TOKENS, encode_actions
from olt_toolkit import ClipStore
from olt_toolkit.clips.pai_layout import CLIP_INDEX, FEATURE_TABLE
from olt_toolkit.clips.pai_tables import read_indexed
from olt_toolkit.clips.table import CLIP_TABLE
from olt_toolkit.policy.action_space import trajectory_to_actions

_RANGE = re.compile(r"(\d+)-(\d+)")
Samples = Callable[[], Iterator[tuple[ClipStore, str, int]]]


@dataclass(frozen=True)
class PaiData:
    """One `local_dir` of a recipe.

    Attributes:
        folder: it; not there yet where the mixture is still to be exported.
        chunk_ids: "a-b", which selects a to b - 1.
        clips: clips in these chunks, one sample each.
        own_times: samples stand at the first time of `event_t0s`, not at 5.1 s.
        notes: what the recipe cannot do as the mixture asks.
        samples: gives store, clip and time of every sample; None where the folder does not tell.
    """

    folder: Path
    chunk_ids: str
    clips: int
    own_times: bool
    notes: tuple[str, ...] = ()
    samples: Samples | None = None

    @property
    def chunks(self) -> range:
        """The chunk numbers of the range."""
        return range(*map(int, self.chunk_ids.split("-")))


def planned_data(contents: Contents, folder: Path) -> PaiData:
    """What an export of these contents to `folder` will be."""
    chunks = len(divide_into_chunks(contents.groups))
    items = contents.items

    def samples() -> Iterator[tuple[ClipStore, str, int]]:
        stores = {store: ClipStore(store) for store in {item.store for item in items}}
        return ((stores[item.store], item.clip_id, item.t0s_us[0]) for item in items)

    return PaiData(folder, f"0-{chunks}", len(items), True, contents.notes, samples)


def existing_data(folder: Path, chunk_ids: str | None = None) -> PaiData:
    """A folder that is there, all of it or a range of its chunks.

    Raises:
        InputError: the folder is not in PhysicalAI-AV layout, the range is none, or no clip lies in it.
    """
    for name in (FEATURE_TABLE, CLIP_INDEX):
        if not (folder / name).is_file():
            raise InputError(
                f"{folder}: has no {name}, so it is no PhysicalAI-AV folder; write one with olt data export"
            )
    index = read_indexed(folder / CLIP_INDEX, ["chunk"], ["clip_id"])
    if not pd.api.types.is_integer_dtype(index["chunk"]):
        raise InputError(f"{folder / CLIP_INDEX}: column chunk is {index['chunk'].dtype}; it holds whole numbers")
    if chunk_ids is None and len(index):
        chunk_ids = f"{index['chunk'].min()}-{index['chunk'].max() + 1}"
    first, end = _parse_range(chunk_ids or "0-1")
    chosen = index[index["chunk"].between(first, end - 1)]
    if chosen.empty:
        raise InputError(
            f"{folder}: chunks {first} to {end - 1} hold no clip, so nothing would be trained on; it has chunks "
            f"{sorted(map(int, index['chunk'].unique()))[:8]}"
        )
    own_times = "event_t0s" in chosen.columns
    times = dict(zip(chosen.index, chosen["event_t0s"], strict=True)) if own_times else {}
    without = next((clip for clip, of_clip in times.items() if np.size(of_clip) == 0), None)
    if without is not None:
        raise InputError(f"{folder / CLIP_INDEX}: clip {without} has no sample time (event_t0s), and the recipe stops")

    def samples() -> Iterator[tuple[ClipStore, str, int]]:
        store = ClipStore(folder)
        return ((store, str(clip), int(np.ravel(of_clip)[0])) for clip, of_clip in times.items())

    told = samples if own_times and (folder / CLIP_TABLE).is_file() else None
    return PaiData(folder, f"{first}-{end}", len(chosen), own_times, samples=told)


def _parse_range(text: str) -> tuple[int, int]:
    match = _RANGE.fullmatch(text)
    if match is None or int(match[1]) >= int(match[2]):
        raise InputError(
            f"chunks {text!r}: write FIRST-END with FIRST below END, such as 0-3 for chunks 0, 1 and 2; the recipe "
            "selects nothing for a text without a dash"
        )
    return int(match[1]), int(match[2])


@dataclass(frozen=True)
class Saturation:
    """Future tokens that stand for the end of the range in place of a value beyond it.

    The recipe cuts them off in silence: braking beyond 6.78 m/s², turns beyond 0.26 1/m (docs/formats/alpamayo.md).
    """

    samples: int
    samples_touched: int
    tokens: int
    first_clip: str | None

    @property
    def share(self) -> float:
        """Saturated tokens of all future tokens."""
        return self.tokens / (self.samples * FUTURE_TOKENS)


def count_saturation(data: PaiData, on_progress: Progress = silent) -> Saturation | None:
    """Count the saturated tokens of all samples, as the recipe would make them; None where samples are not told."""
    if data.samples is None:
        return None
    tokens = touched = samples = 0
    first: str | None = None
    for store, clip_id, t0_us in data.samples():
        history, future = store.read_ego_motion(clip_id).around(np.array([t0_us], np.int64))
        actions = trajectory_to_actions(
            history[..., :3, 3], history[..., :3, :3], future[..., :3, 3], future[..., :3, :3]
        )
        saturated = encode_actions(actions)[1]
        samples, tokens, touched = samples + 1, tokens + saturated, touched + bool(saturated)
        first = clip_id if saturated and first is None else first
        on_progress(samples / data.clips)
    return Saturation(samples, touched, tokens, first)
