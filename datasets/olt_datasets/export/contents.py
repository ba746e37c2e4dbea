"""What an export holds: clips with their sample times, in groups of one component, kind and source each.

The public readers give one sample a clip and epoch. A clip that a mixture uses at several times is therefore listed
several times, each time under an id of its own; uses beyond that (a sample drawn twice in an epoch) cannot be told.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from operator import attrgetter, itemgetter
from pathlib import Path

from olt_datasets.mixtures.mixture import Mixture, MixtureComponent
from olt_generator.errors import InputError
from olt_toolkit.clips.clip import Split, make_clip_id
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.policy.sample import KEYFRAME_US


@dataclass(frozen=True)
class ExportItem:
    """One row of the public index.

    Attributes:
        store: folder of the clip store.
        clip_id: id in the store.
        listed_as: id in the export: that of the store, except for further uses of a clip.
        t0s_us: sample times; the first is the one that the public readers take.
    """

    store: Path
    clip_id: str
    listed_as: str
    t0s_us: tuple[int, ...]


@dataclass(frozen=True)
class ExportGroup:
    """Items that chunk numbers can select together.

    Attributes:
        component: component of the mixture, or folder name of the store.
        kind, source: as in the clip table.
        items: ordered by store, then by the order of its clips.
    """

    component: str
    kind: str
    source: str
    items: tuple[ExportItem, ...]


@dataclass(frozen=True)
class Contents:
    """Everything that is to be exported.

    Attributes:
        groups: groups of one component follow each other.
        split: the split that all clips are of.
        left_out: clips that the stores hold and the export does not, by reason.
        notes: what the public readers cannot do as the mixture asks, a sentence each.
    """

    groups: tuple[ExportGroup, ...]
    split: Split
    left_out: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def items(self) -> list[ExportItem]:
        """All items in the order of their groups."""
        return [item for group in self.groups for item in group.items]

    def with_one_item_per_clip(self) -> "Contents":
        """The same, with all sample times of a clip in one item: for layouts that hold many samples of a clip."""
        return replace(self, groups=tuple(replace(group, items=_join_uses(group.items)) for group in self.groups))


def contents_of_mixture(mixture: Mixture) -> Contents:
    """One item for every sample that the mixture draws from.

    Raises:
        InputError: two stores hold the same clip, or clips are indexed but not built.
    """
    stores = {store for part in mixture.components for store in part.samples["store"].unique()}
    table = next((store for store in sorted(stores) if Path(store).is_file()), None)
    if table is not None:
        raise InputError(f"{table}: its clips are indexed and not built; build them with `olt data build`")
    groups = [group for part in mixture.components for group in _component_groups(part)]
    return Contents(_check(groups), mixture.recipe.split, notes=tuple(_notes(mixture)))


def contents_of_stores(stores: Sequence[Path], split: Split) -> Contents:
    """One item for every clip of the split that gives a policy sample, with all its sample times.

    The time that the public recipes take by default stands first where the clip has it.

    Raises:
        InputError: a folder is no clip store, two stores are called or hold the same, or no clip is left.
    """
    names = Counter(store.resolve().name for store in stores)
    if max(names.values()) > 1:
        raise InputError(f"two stores are called {names.most_common(1)[0][0]}; chunks are named by them, rename one")
    left_out: Counter[str] = Counter()
    groups = [group for store in stores for group in _store_groups(store.resolve(), split, left_out)]
    return Contents(_check(groups), split, dict(left_out))


def _component_groups(part: MixtureComponent) -> Iterator[ExportGroup]:
    columns = ("kind", "source", "store", "clip_id", "t0_us")
    rows = sorted(part.samples.select(*columns).unique().rows())
    for (kind, source), group in groupby(rows, itemgetter(0, 1)):
        items = [
            ExportItem(Path(store), clip_id, _listed_as(clip_id, t0_us, further=use > 0), (t0_us,))
            for (store, clip_id), uses in groupby(group, itemgetter(2, 3))
            for use, (*_, t0_us) in enumerate(uses)
        ]
        yield ExportGroup(part.component.name, kind, source, tuple(items))


def _join_uses(items: Sequence[ExportItem]) -> tuple[ExportItem, ...]:
    times: dict[tuple[Path, str], list[int]] = {}
    for item in items:
        times.setdefault((item.store, item.clip_id), []).extend(item.t0s_us)
    return tuple(
        ExportItem(store, clip_id, clip_id, tuple(sorted(t0s_us))) for (store, clip_id), t0s_us in times.items()
    )


def _listed_as(clip_id: str, t0_us: int, further: bool) -> str:
    return make_clip_id("further use", clip_id, t0_us) if further else clip_id


def _store_groups(store: Path, split: Split, left_out: Counter[str]) -> Iterator[ExportGroup]:
    clips = ClipStore(store).clips()
    taken = [info for info in clips if info.split == split and info.sample_t0_us]
    for info in clips:
        if info.split != split:
            left_out[f"of split {info.split}"] += 1
        elif not info.sample_t0_us:
            left_out[f"{info.kind}, no policy sample"] += 1
    kind_and_source = attrgetter("kind", "source")
    for (kind, source), group in groupby(sorted(taken, key=kind_and_source), kind_and_source):
        items = [ExportItem(store, info.clip_id, info.clip_id, _default_first(info.sample_t0_us)) for info in group]
        yield ExportGroup(store.name, kind, source, tuple(items))


def _default_first(t0s_us: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(sorted(t0s_us, key=lambda t0_us: (t0_us != KEYFRAME_US, t0_us)))


def _notes(mixture: Mixture) -> Iterator[str]:
    distinct = sum(len(part.samples) for part in mixture.components)
    for part, items in zip(mixture.components, mixture.counts(epoch=0), strict=True):
        name, samples = part.component.name, len(part.samples)
        if part.component.share_by_epoch is not None:
            yield f"{name}: its share changes from epoch to epoch; train each stretch with its own ranges of chunks"
        if items != samples:
            yield (
                f"{name}: {items} items of {samples} samples per epoch; the public readers take each once, so its "
                f"share is {samples / distinct:.4g} and not {items / len(mixture):.4g}; `mixtures.torch_dataset` "
                "keeps the share"
            )


def _check(groups: Iterable[ExportGroup]) -> tuple[ExportGroup, ...]:
    groups = tuple(group for group in groups if group.items)
    if not groups:
        raise InputError("no clip is left to export; choose another split, or build clips that give policy samples")
    ids = Counter(item.listed_as for group in groups for item in group.items)
    clip_id, uses = ids.most_common(1)[0]
    if uses > 1:
        stores = sorted({str(item.store) for group in groups for item in group.items if item.listed_as == clip_id})
        raise InputError(f"clip {clip_id} would be listed {uses} times (from {', '.join(stores)}); give it once")
    return groups
