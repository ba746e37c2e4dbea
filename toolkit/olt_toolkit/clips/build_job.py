"""Many recordings into one store of clips: in parallel, and again after an interruption without doing work twice.

Each clip is prepared as soon as it is built, with its pictures; all are committed together at the end, in the order of
their paths. So an interrupted run that is taken up again leaves the same bytes as one that was not.
"""

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, Protocol

from olt_generator.errors import InputError
from olt_generator.progress import Progress, silent
from olt_toolkit.clips.builder import build_clip, clip_id_of
from olt_toolkit.clips.estimators import SourceChoice
from olt_toolkit.clips.pictures import animation_path, write_clip_pictures
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.summary import summarize_build
from olt_toolkit.clips.views import BuildOptions
from olt_toolkit.recordings.recording import OpenOptions, Recording, is_recording, open_recording
from olt_toolkit.runtime.steps import OnStep, unnoticed
from olt_toolkit.runtime.threads import use_one_thread
from olt_toolkit.runtime.workers import Engine, map_parallel

PREVIEWS = "previews"
# Decoding this much of a recording tells its name and source, which its clip's id is made from.
_GLANCE_SECONDS = 0.3


class ClipJob(Protocol):
    """What one clip is built of; picklable, because workers build."""

    @property
    def path(self) -> Path:
        """What the outcome is listed under."""
        ...

    @property
    def store(self) -> Path:
        """Folder of the clip store."""
        ...

    @property
    def keep_going(self) -> bool:
        """Whether input that cannot be used is an outcome instead of an error."""
        ...

    def build(self) -> "Outcome":
        """Build the clip and prepare it, unless an earlier run did.

        Raises:
            InputError: the input cannot be used.
        """
        ...


@dataclass(frozen=True)
class BuildJob:
    """One recording and how its clip is built.

    Attributes:
        path: the recording.
        store: folder of the clip store.
        opening: how to open the recording.
        options: how to build the clip, but for its sources.
        sources: where its motion and distances come from.
        keep_going: whether a recording that cannot be used is an outcome instead of an error.
    """

    path: Path
    store: Path
    opening: OpenOptions
    options: BuildOptions
    sources: SourceChoice
    keep_going: bool = False

    def build(self) -> "Outcome":
        """See `ClipJob.build`."""
        glance = open_recording(self.path, replace(self.opening, duration=min(_GLANCE_SECONDS, self.opening.duration)))
        clip_id = clip_id_of(glance, self.options)
        if is_finished(self.store, clip_id, glance.name):
            return Outcome(self.path, "found", clip_id)
        return Outcome(self.path, "built", clip_id, prepare_clip(self, open_recording(self.path, self.opening)))


@dataclass(frozen=True)
class Outcome:
    """What became of one recording.

    Attributes:
        path: the recording.
        state: built now, found in the store or prepared by an earlier run, or failed.
        clip_id: id of the clip; None where it failed.
        summary: numbers of a clip that was built now.
        message: why it failed.
    """

    path: Path
    state: Literal["built", "found", "failed"]
    clip_id: str | None = None
    summary: dict[str, Any] | None = None
    message: str | None = None


def find_recordings(folder: Path) -> list[Path]:
    """The recordings that lie directly in a folder, by name.

    Raises:
        InputError: there is none, or two would give clips of one name.
    """
    found = sorted(path for path in folder.iterdir() if not path.name.startswith(".") and is_recording(path))
    if not found:
        raise InputError(
            f"{folder}: holds no recording that any reader knows; give a video, a drive or a folder of them"
        )
    for name, count in Counter(path.stem for path in found).items():
        if count > 1:
            raise InputError(f"{folder}: {count} recordings are called {name!r}; rename them, clips are told by name")
    return found


def build_clips(
    jobs: Sequence[ClipJob], workers: int, on_progress: Progress = silent, engine: Engine = Engine.LOCAL
) -> list[Outcome]:
    """Build the clips of several jobs and commit them to their store.

    Args:
        jobs: what to build, all for one store.
        workers: number of processes.
        on_progress: told the share of jobs that are done.
        engine: where the processes run.

    Returns:
        An outcome for each job, in their order.

    Raises:
        InputError: something cannot be used and its job does not keep going. Clips prepared by then are found by the
            next run.
    """
    outcomes = map_parallel(_build_or_report, jobs, workers, on_progress, engine)
    store = ClipStore(jobs[0].store)
    store.commit([outcome.clip_id for outcome in outcomes if outcome.clip_id is not None])
    return outcomes


def prepare_clip(
    job: BuildJob, recording: Recording, on_progress: Progress = silent, on_step: OnStep = unnoticed
) -> dict[str, Any]:
    """Build one clip and prepare it with its pictures; returns its numbers.

    Raises:
        InputError: see `build_clip`.
    """
    built = build_clip(recording, job.sources.apply(job.options), on_progress, on_step)
    streams = built.clip.streams
    times_us = next(iter(streams.values())).timestamps_us
    images = {name: stream.frames for name, stream in streams.items()}
    start = time.perf_counter()
    info = ClipStore(job.store).prepare(built.clip)
    prepared = time.perf_counter()
    pictures = write_clip_pictures(job.store / PREVIEWS, built.clip.name, images, built.observed, times_us)
    seconds = {"prepare": prepared - start, "pictures": time.perf_counter() - prepared}
    sources = {"poses": str(job.sources.poses), "depth": str(job.sources.depth)}
    return summarize_build(built, info) | {"sources": sources, "pictures": pictures, "store_seconds": seconds}


def _build_or_report(job: ClipJob) -> Outcome:
    use_one_thread()
    try:
        return job.build()
    except InputError as error:
        if not job.keep_going:
            raise
        return Outcome(job.path, "failed", message=str(error))


def is_finished(root: Path, clip_id: str, name: str) -> bool:
    """Whether the clip is in the store, or prepared with its pictures, of which the animation is written last."""
    store = ClipStore(root)
    return clip_id in store or (store.is_prepared(clip_id) and animation_path(root / PREVIEWS, name).is_file())
