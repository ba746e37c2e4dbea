"""From the rows of a table of indexed clips to the jobs that build them.

Each row's window is opened by the reader of its data set and built as `olt clip build` builds a recording.
"""

from collections.abc import Sequence
from dataclasses import replace

from olt_datasets.tables.choices import BuiltKind
from olt_generator.errors import InputError
from olt_toolkit.clips.build_job import BuildJob
from olt_toolkit.clips.clip import ClipInfo

# Data sets whose images a renderer made and no camera took.
_RENDERED_SOURCES = frozenset({"synthetic"})
# Images of cameras whose views are all true are at most so many times as wide as high.
_WIDEST_SHAPE = 2
# Pixels stay square: heights are whole numbers for images of 16 x 9, and little changed by rounding for others.
_WIDTH_STEP, _SMALLEST_WIDTH = 16, 512


def find_buildable(rows: Sequence[ClipInfo], kind: BuiltKind) -> list[ClipInfo]:
    """The rows to make clips of: for GT those of that kind, for Syn all; InputError if none, or one is in no split."""
    found = [row for row in rows if kind is BuiltKind.SYN or row.kind == "GT"]
    if not found:
        raise InputError(f"the table has {len(rows)} clips, none of which has true views of all policy cameras (GT)")
    unsplit = [row.name for row in found if row.split is None]
    if unsplit:
        raise InputError(f"{len(unsplit)} clips are in no split, as {unsplit[0]!r}; run `olt data split` before")
    return found


def build_row(row: ClipInfo, kind: BuiltKind, job: BuildJob) -> BuildJob:
    """The job that builds the clip of a row that is in a split, from the job that has what all rows share.

    GT takes the true images of all policy cameras, Syn those of the front camera, from which the other views are
    synthesized. Motion that the data set measured is taken in any case.
    """
    assert row.split is not None  # find_buildable refuses other rows
    opening, real_views = job.opening, kind is BuiltKind.GT
    if real_views and row.source in _RENDERED_SOURCES:
        # As they are rendered for a policy that drives there.
        opening = replace(opening, width=job.options.width, height=job.options.height)
    elif real_views:
        # True views are only fitted to the clip's size: they are opened as large as that needs, and little larger.
        needed = max(job.options.width, _WIDEST_SHAPE * job.options.height, _SMALLEST_WIDTH)
        opening = replace(opening, width=-(-needed // _WIDTH_STEP) * _WIDTH_STEP)
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
    )
    return replace(
        job,
        key=row.origin.recording,
        window_us=(row.origin.start_us, row.origin.end_us),
        opening=opening,
        options=options,
        source=row.source,
        measured_motion=True,
    )
