"""What an export holds: clips with their sample times, in groups of one component, kind and source each.

The public readers give one sample a clip and epoch. A clip that a mixture uses at several times is therefore listed
several times, each time under an id of its own; uses beyond that (a sample drawn twice in an epoch) cannot be told.
"""

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from operator import attrgetter, itemgetter
from pathlib import Path

from olt_datasets.mixtures.mixture import Mixture
from olt_generator.errors import InputError
from olt_generator.omissions import Omission, word_omission
from olt_toolkit.clips.clip import Split, make_clip_id
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.policy.sample import KEYFRAME_US
from olt_toolkit.rigs.contracts import DEFAULT_CONTRACT, CameraContract


@dataclass(frozen=True)
class ExportItem:
    """One row of the public index: a clip of a store, and its sample times, the first for the public readers.

    `listed_as` is its id in the export: that of the store, except for further uses of a clip.
    """

    store: Path
    clip_id: str
    listed_as: str
    t0s_us: tuple[int, ...]


@dataclass(frozen=True)
class ExportGroup:
    """Items that chunk numbers can select together, by store, then in the order of its clips.

    `component` is that of the mixture, or the folder name of the store.
    """

    component: str
    kind: str
    source: str
    items: tuple[ExportItem, ...]


@dataclass(frozen=True)
class Contents:
    """Everything that is to be exported, all of one split; groups of one component follow each other.

    All clips have the cameras of the contract. Clips that the stores hold and the export does not are left out. Notes
    tell what the public readers cannot do as the mixture asks, a sentence each.
    """

    groups: tuple[ExportGroup, ...]
    split: Split
    contract: CameraContract = DEFAULT_CONTRACT
    left_out: tuple[Omission, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def items(self) -> list[ExportItem]:
        """All items in the order of their groups."""
        return [item for group in self.groups for item in group.items]

    def without(self, clip_ids: Collection[str]) -> "Contents":
        """The same without some clips; groups of which nothing is left are left out."""
        groups = [
            replace(group, items=tuple(item for item in group.items if item.clip_id not in clip_ids))
            for group in self.groups
        ]
        return replace(self, groups=tuple(group for group in groups if group.items))

    def with_one_item_per_clip(self) -> "Contents":
        """The same, with all sample times of a clip in one item: for layouts that hold many samples of a clip."""
        groups = []
        for group in self.groups:
            times: dict[tuple[Path, str], list[int]] = {}
            for item in group.items:
                times.setdefault((item.store, item.clip_id), []).extend(item.t0s_us)
            items = [ExportItem(store, clip, clip, tuple(sorted(t0s_us))) for (store, clip), t0s_us in times.items()]
            groups.append(replace(group, items=tuple(items)))
        return replace(self, groups=tuple(groups))


def contents_of_mixture(mixture: Mixture, contract: CameraContract = DEFAULT_CONTRACT) -> Contents:
    """One item for every sample that the mixture draws from.

    Raises:
        InputError: two stores hold the same clip, clips are indexed but not built, or lack cameras of the contract.
    """
    stores = {store for part in mixture.components for store in part.samples["store"].unique()}
    table = next((store for store in sorted(stores) if Path(store).is_file()), None)
    if table is not None:
        raise InputError(f"{table}: its clips are indexed and not built; build them with `olt data build`")
    groups = []
    for part in mixture.components:
        rows = sorted(part.samples.select("kind", "source", "store", "clip_id", "t0_us").unique().rows())
        for (kind, source), group in groupby(rows, itemgetter(0, 1)):
            items = [
                ExportItem(Path(store), clip, make_clip_id("further use", clip, t0_us) if use else clip, (t0_us,))
                for (store, clip), uses in groupby(group, itemgetter(2, 3))
                for use, (*_, t0_us) in enumerate(uses)
            ]
            groups.append(ExportGroup(part.component.name, kind, source, tuple(items)))
    _check_cameras(groups, contract)
    return Contents(_check(groups), mixture.recipe.split, contract, notes=tuple(_notes(mixture)))


def contents_of_stores(stores: Sequence[Path], split: Split, contract: CameraContract = DEFAULT_CONTRACT) -> Contents:
    """One item for every clip of the split that gives a policy sample of the contract, with all its sample times.

    The time that the public recipes take by default stands first where the clip has it.

    Raises:
        InputError: a folder is no clip store, two stores are called or hold the same, or no clip is left.
    """
    names = Counter(store.resolve().name for store in stores)
    if max(names.values()) > 1:
        raise InputError(f"two stores are called {names.most_common(1)[0][0]}; chunks are named by them, rename one")
    groups: list[ExportGroup] = []
    left_out: Counter[tuple[str, str]] = Counter()
    total = 0
    kind_and_source = attrgetter("kind", "source")
    for store in map(Path.resolve, stores):
        clips = ClipStore(store).clips()
        total += len(clips)
        left_out.update(("clips", f"of split {info.split}") for info in clips if info.split != split)
        of_split = [info for info in clips if info.split == split]
        left_out.update((f"{info.kind} clips", "no policy sample") for info in of_split if not info.sample_t0_us)
        for info in of_split:
            if info.sample_t0_us and contract.lacking(info.views):
                left_out[f"{info.kind} clips", f"not all cameras of {contract.name}"] += 1
        usable = [info for info in of_split if info.sample_t0_us and not contract.lacking(info.views)]
        taken = sorted(usable, key=kind_and_source)
        for (kind, source), infos in groupby(taken, kind_and_source):
            items = []
            for info in infos:
                times = sorted(info.sample_t0_us, key=lambda t0_us: (t0_us != KEYFRAME_US, t0_us))
                items.append(ExportItem(store, info.clip_id, info.clip_id, tuple(times)))
            groups.append(ExportGroup(store.name, kind, source, tuple(items)))
    omissions = [Omission(what, why, count, total) for (what, why), count in left_out.items()]
    return Contents(_check(groups, omissions), split, contract, tuple(omissions))


def _notes(mixture: Mixture) -> Iterator[str]:
    distinct, recipe = sum(len(part.samples) for part in mixture.components), mixture.recipe
    counts = mixture.counts(epoch=0)
    shares = recipe.shares(0) if recipe.named_epochs else [items / len(mixture) for items in counts]
    for part, items, share in zip(mixture.components, counts, shares, strict=True):
        name, samples = part.component.name, len(part.samples)
        if part.component.share_by_epoch is not None:
            yield f"{name}: its share changes from epoch to epoch; train each stretch with its own ranges of chunks"
        if items != samples:
            yield (
                f"{name}: {items} items of {samples} samples per epoch; the public readers take each once, so its "
                f"share is {samples / distinct:.4g} and not {float(share):.4g}; `MixtureDataset` keeps the share"
            )


def _check_cameras(groups: Sequence[ExportGroup], contract: CameraContract) -> None:
    """A mixture has its shares, so no clip of it is left out without a word."""
    stores = {item.store: ClipStore(item.store) for group in groups for item in group.items}
    for group in groups:
        for item in group.items:
            lacking = contract.lacking(stores[item.store].info(item.clip_id).views)
            if lacking:
                raise InputError(
                    f"{item.store}: clip {item.clip_id} has no {', '.join(lacking)}, which {contract.name} needs; "
                    f"build the clips with --rig {contract.name}, or export for another --rig"
                )


def _check(groups: Sequence[ExportGroup], left_out: Sequence[Omission] = ()) -> tuple[ExportGroup, ...]:
    if not groups:
        why = "".join(f"; {word_omission(omission)}" for omission in left_out)
        raise InputError(
            f"no clip is left to export{why}; choose another split or --rig, or build clips that give its samples"
        )
    ids = Counter(item.listed_as for group in groups for item in group.items)
    clip_id, uses = ids.most_common(1)[0]
    if uses > 1:
        stores = sorted({str(item.store) for group in groups for item in group.items if item.listed_as == clip_id})
        raise InputError(f"clip {clip_id} would be listed {uses} times (from {', '.join(stores)}); give it once")
    return tuple(groups)
