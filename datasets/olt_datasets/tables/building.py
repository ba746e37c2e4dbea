"""From the rows of a table of indexed clips to a store of built ones.

Each row's window is opened by the reader of its data set and built as `olt clip build` builds a recording: prepared
with its pictures as soon as it is done, and all are committed together at the end. So an interrupted run that is taken
up again leaves the same bytes as one that was not.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from olt_datasets.tables.choices import BuiltKind
from olt_datasets.tables.indexing import DatasetPlace
from olt_generator.errors import InputError
from olt_toolkit.clips.build_job import BuildJob, Outcome, is_finished, prepare_clip
from olt_toolkit.clips.clip import ClipInfo, make_clip_id
from olt_toolkit.clips.estimators import SourceChoice
from olt_toolkit.clips.views import BuildOptions
from olt_toolkit.recordings.recording import OpenOptions
from olt_toolkit.rigs.rig import POLICY_CAMERAS

# Data sets whose images a renderer made and no camera took.
_RENDERED_SOURCES = frozenset({"synthetic"})
# Images of cameras whose views are all true are at most so many times as wide as high.
_WIDEST_SHAPE = 2
# Pixels stay square: heights are whole numbers for images of 16 x 9, and little changed by rounding for others.
_WIDTH_STEP, _SMALLEST_WIDTH = 16, 512


@dataclass(frozen=True)
class RowJob:
    """One row of a table and how its clip is built.

    Attributes:
        row: the row.
        place: the data set that its window is in.
        store: folder of the clip store.
        kind: GT: the true images of all policy cameras. Syn: those of the front camera, from which the other views are
            synthesized.
        opening: what to assume of a camera that the data set does not tell.
        options: sizes and seed of the clip; everything else is the row's.
        sources: where distances come from, and motion where the data set has not measured it.
        keep_going: whether a window that cannot be used is an outcome instead of an error.
    """

    row: ClipInfo
    place: DatasetPlace
    store: Path
    kind: BuiltKind
    opening: OpenOptions
    options: BuildOptions
    sources: SourceChoice
    keep_going: bool = False

    @property
    def clip_id(self) -> str:
        """The id of the clip that will be built."""
        return make_clip_id(self.row.source, self.row.name, self.kind.value, self.options.seed)

    @property
    def path(self) -> Path:
        """The name of the row, under which its outcome is listed."""
        return Path(self.row.name)

    def build(self) -> Outcome:
        """See `olt_toolkit.clips.build_job.ClipJob.build`."""
        if is_finished(self.store, self.clip_id, self.row.name):
            return Outcome(self.path, "found", self.clip_id)
        return Outcome(self.path, "built", self.clip_id, _build(self))


def find_buildable(rows: Sequence[ClipInfo], kind: BuiltKind) -> list[ClipInfo]:
    """The rows of which a clip of this kind can be made: GT only of rows of that kind, Syn of all.

    Raises:
        InputError: there are none, or one of them is in no split.
    """
    found = [row for row in rows if kind is BuiltKind.SYN or row.kind == "GT"]
    if not found:
        raise InputError(f"the table has {len(rows)} clips, none of which has true views of all policy cameras (GT)")
    unsplit = [row.name for row in found if row.split is None]
    if unsplit:
        raise InputError(f"{len(unsplit)} clips are in no split, as {unsplit[0]!r}; run `olt data split` before")
    return found


def _true_images(job: RowJob) -> OpenOptions:
    """True views are only fitted to the clip's size: they are opened as large as that needs, and little larger."""
    needed = max(job.options.width, _WIDEST_SHAPE * job.options.height, _SMALLEST_WIDTH)
    return replace(job.opening, width=-(-needed // _WIDTH_STEP) * _WIDTH_STEP, views=POLICY_CAMERAS)


def _build(job: RowJob) -> dict[str, Any]:
    assert job.row.split is not None  # find_buildable refuses other rows
    row, real_views = job.row, job.kind is BuiltKind.GT
    dataset = job.place.open()
    if dataset.source != row.source:
        raise InputError(
            f"{job.place.root}: holds data of {dataset.source}, but the clip {row.name!r} is of {row.source}"
        )
    opening = _true_images(job) if real_views else job.opening
    recording = dataset.open(row.origin.recording, (row.origin.start_us, row.origin.end_us), opening)
    recording = replace(recording, source=row.source)
    options = replace(
        job.options,
        name=row.name,
        scene_id=row.scene_id,
        category=row.category,
        factors=row.factors,
        split=row.split,
        origin=row.origin,
        sample_t0_us=row.sample_t0_us,
        image_kind="rendered" if row.source in _RENDERED_SOURCES else "observed",
        use_reference_views=real_views,
        use_reference_motion=recording.reference is not None,
    )
    return prepare_clip(BuildJob(job.place.root, job.store, opening, options, job.sources), recording)
