"""Drives into one store of clips: in parallel, and again after an interruption without doing work twice.

Each clip is prepared as soon as it is built, with its pictures; all are committed together at the end, in the order of
their jobs. So an interrupted run that is taken up again leaves the same bytes as one that was not.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from olt_generator.errors import InputError
from olt_generator.progress import Progress, silent
from olt_toolkit.clips.builder import build_clip, clip_id_of
from olt_toolkit.clips.clip import ClipInfo
from olt_toolkit.clips.estimators import Estimators
from olt_toolkit.clips.pictures import animation_path, write_clip_pictures
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.summary import summarize_build
from olt_toolkit.clips.verification.verify import verify_before_commit
from olt_toolkit.clips.views import BuildOptions
from olt_toolkit.policy.window import Span
from olt_toolkit.recordings.drives import DatasetPlace, open_start
from olt_toolkit.recordings.recording import OpenOptions, Recording
from olt_toolkit.rigs.rig import short_name
from olt_toolkit.runtime.steps import OnStep, unnoticed
from olt_toolkit.runtime.threads import use_one_thread
from olt_toolkit.runtime.workers import Engine, map_parallel

PREVIEWS = "previews"


@dataclass(frozen=True)
class BuildResult:
    """What became of one job, which is listed under `path`.

    `clip_id` is None where it failed, and `message` says why. A clip is "found" in the store, or prepared by an earlier
    run; `summary` holds the numbers of one that is built now.
    """

    path: Path
    state: Literal["built", "found", "failed"]
    clip_id: str | None = None
    summary: dict[str, Any] | None = None
    message: str | None = None


@dataclass(frozen=True)
class BuildJob:
    """One drive, or a window of one, and how its clip is built; picklable, because workers build.

    Attributes:
        place, key: the data set, and the drive in it.
        window_us: drive times of the first and the last image; None for the whole drive, up to the duration of
            `opening`.
        options: how to build the clip, but for its estimators; without a name the clip takes that of the drive.
        measured_motion: whether motion that the data set measured goes before what `estimators` say.
        source: the reader that the data set must have; None for any.
        keep_going: whether input that cannot be used is a result instead of an error.
        verify: whether the clip is looked at before it may be committed; one that fails is not kept.
    """

    place: DatasetPlace
    key: str
    store: Path
    window_us: Span | None = None
    opening: OpenOptions = field(default_factory=OpenOptions)
    options: BuildOptions = field(default_factory=BuildOptions)
    estimators: Estimators = field(default_factory=Estimators)
    measured_motion: bool = False
    source: str | None = None
    keep_going: bool = False
    verify: bool = True

    @property
    def name(self) -> str:
        """Name of the clip that will be built."""
        return self.options.name or self.place.drive_name(self.key)

    @property
    def clip_id(self) -> str:
        """Id of the clip that will be built; an `InputError` where no reader knows the data set."""
        return clip_id_of(self.source or self.place.open().source, self.name, self.options)

    def open(self) -> Recording:
        """Open what the clip is built of; an `InputError` where it cannot be used, or is not of the `source`."""
        dataset = self.place.open()
        if self.source not in (None, dataset.source):
            raise InputError(
                f"{self.place.path}: holds data of {dataset.source}, but the clip {self.name!r} is of {self.source}"
            )
        if self.window_us is None:
            return open_start(dataset, self.key, self.opening)
        return dataset.open(self.key, self.window_us, self.opening)

    def prepare(
        self, recording: Recording, on_progress: Progress = silent, on_step: OnStep = unnoticed
    ) -> dict[str, Any]:
        """Build the clip of the opened recording and prepare it in the store; returns its numbers."""
        options = replace(self.options, name=self.name)
        if self.measured_motion and recording.reference is not None:
            options = replace(options, use_reference_motion=True)
        built = build_clip(recording, self.estimators.apply(options), on_progress, on_step)
        start = time.perf_counter()
        info = ClipStore(self.store).prepare(built.clip)
        prepared = time.perf_counter()
        images, origins = built.clip.images, built.clip.origins
        times_us = next(iter(built.clip.streams.values())).timestamps_us
        pictures = write_clip_pictures(self.store / PREVIEWS, self.name, images, origins, times_us)
        drawn = time.perf_counter()
        verified = verify_before_commit(ClipStore(self.store), info.clip_id) if self.verify else None
        seconds = {"prepare": prepared - start, "pictures": drawn - prepared, "verify": time.perf_counter() - drawn}
        sources = {"poses": str(self.estimators.poses), "depth": str(self.estimators.depth)}
        return summarize_build(built, info) | {
            "sources": sources,
            "pictures": pictures,
            "verification": verified,
            "store_seconds": seconds,
        }

    def run(self) -> BuildResult:
        """Build and prepare the clip on one thread, unless an earlier run did; an error unless the job keeps going."""
        use_one_thread()
        path, store = Path(self.options.name or self.place.path / self.key), ClipStore(self.store)
        try:
            found = self._find(store)
            if found is not None:
                self._check_cameras(found)
                if self.verify and found.clip_id not in store:
                    verify_before_commit(store, found.clip_id)
                return BuildResult(path, "found", self.clip_id)
            return BuildResult(path, "built", self.clip_id, self.prepare(self.open()))
        except InputError as error:
            if not self.keep_going:
                raise
            return BuildResult(path, "failed", message=str(error))

    def _find(self, store: ClipStore) -> ClipInfo | None:
        """The clip in the store, or as an earlier run prepared it."""
        if self.clip_id in store:
            return store.info(self.clip_id)
        # Of the pictures of a prepared clip the animation is written last.
        drawn = animation_path(self.store / PREVIEWS, self.name).is_file()
        return store.prepared(self.clip_id) if drawn else None

    def _check_cameras(self, found: ClipInfo) -> None:
        if found.views.keys() != set(self.options.cameras):
            have, wanted = (", ".join(map(short_name, names)) for names in (found.views, self.options.cameras))
            raise InputError(
                f"{self.store}: already holds the clip {self.name!r} with {have}; for {wanted} give another folder"
            )


def build_clips(
    jobs: Sequence[BuildJob], workers: int, on_progress: Progress = silent, engine: Engine = Engine.LOCAL
) -> list[BuildResult]:
    """Build the clips of several jobs and commit them to their one store; gives a result for each, in their order.

    Raises:
        InputError: something cannot be used and its job does not keep going. Clips prepared by then are found by the
            next run.
    """
    results = map_parallel(BuildJob.run, jobs, workers, on_progress, engine)
    ClipStore(jobs[0].store).commit([result.clip_id for result in results if result.clip_id is not None])
    return results
