"""Drives into one store of clips: in parallel, and again after an interruption without doing work twice.

Each clip is prepared as soon as it is built, with its pictures; all are committed together at the end, in the order of
their jobs. So an interrupted run that is taken up again leaves the same bytes as one that was not.
"""

import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any, Literal

from olt_generator.errors import InputError
from olt_generator.progress import Progress, silent
from olt_toolkit.clips.backends import Backends
from olt_toolkit.clips.build_options import describe_build, find_differences
from olt_toolkit.clips.builder import build_clip, clip_kind
from olt_toolkit.clips.clip import Clip, ClipInfo, ClipOrigin
from olt_toolkit.clips.estimators import Estimators, PoseEstimator
from olt_toolkit.clips.identity import clip_id_of
from olt_toolkit.clips.pictures import animation_path, picture_name, write_clip_pictures
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.summary import summarize_build
from olt_toolkit.clips.verification.verify import verify_before_commit
from olt_toolkit.clips.views import BuildOptions
from olt_toolkit.policy.window import Span
from olt_toolkit.recordings.drives import WHOLE, Dataset, DatasetPlace, Drive, open_start, start_window
from olt_toolkit.recordings.labels import DEFAULT_SPLIT, Split
from olt_toolkit.recordings.recording import OpenOptions, Recording
from olt_toolkit.runtime.steps import OnStep, unnoticed
from olt_toolkit.runtime.threads import use_one_thread
from olt_toolkit.runtime.workers import Engine, map_parallel

PREVIEWS = "previews"
# Where views wait that a learned backend sampled for clips that are not prepared yet.
_GENERATED = ".generated"


@dataclass(frozen=True)
class BuildResult:
    """What became of one job, which is listed under `path`.

    `clip_id` is None where it failed, and `message` says why. A clip is "found" in the store, or prepared by an earlier
    run, or of a recording that a job before is of too, as `message` then says; `summary` holds the numbers of one that
    is built now.
    """

    path: Path
    state: Literal["built", "found", "failed"]
    clip_id: str | None = None
    summary: dict[str, Any] | None = None
    message: str | None = None


@dataclass(frozen=True)
class Subject:
    """What the clip of a job shows, as the data set tells before anything is decoded.

    Attributes:
        scene_id, take: those of the `Drive`.
        window_us: drive times of the first and the last front image.
        has_motion: whether the data set measured motion.
        split: the data set's own split.
    """

    scene_id: str
    take: str
    window_us: Span
    has_motion: bool
    split: Split | None


@dataclass(frozen=True)
class BuildJob:
    """One drive, or a window of one, and how its clip is built; picklable, because workers build.

    Attributes:
        place, key: the data set, and the drive in it.
        window_us: drive times of the first and the last image; None for the whole drive, up to the duration of
            `opening`.
        options: how to build the clip, but for its estimators; without a name the clip takes that of the drive. A drive
            of another scene than its `scene_id` is refused.
        backends: what makes the views that no camera recorded.
        measured_motion: whether motion that the data set measured goes before what `estimators` say.
        source: the reader that the data set must have; None for any.
        keep_going: whether input that cannot be used is a result instead of an error.
        subject: what the clip shows; None where the data set is asked each time (`identify` keeps its answer).
        verify: whether the clip is looked at before it may be committed; one that fails is not kept.
        pictures: whether previews are drawn.
    """

    place: DatasetPlace
    key: str
    store: Path
    window_us: Span | None = None
    opening: OpenOptions = field(default_factory=OpenOptions)
    options: BuildOptions = field(default_factory=BuildOptions)
    estimators: Estimators = field(default_factory=Estimators)
    backends: Backends = field(default_factory=Backends)
    measured_motion: bool = False
    source: str | None = None
    keep_going: bool = False
    verify: bool = True
    pictures: bool = True
    subject: Subject | None = None

    @property
    def path(self) -> Path:
        """What the job is listed under: the name of the clip where it has one of its own, or the path of the drive."""
        return Path(self.options.name or self.place.path / self.key)

    @property
    def name(self) -> str:
        """Name of the clip that will be built."""
        return self.options.name or self.place.drive_name(self.key)

    @property
    def clip_id(self) -> str:
        """Id of the clip that will be built; errors are those of `identify`."""
        subject, options = self._told, self.options
        kind = clip_kind(options)
        return clip_id_of(
            subject.scene_id,
            subject.take,
            subject.window_us,
            kind,
            options.seed,
            options.front,
            self.backends.backend.value,
        )

    @property
    def build_options(self) -> str:
        """How the clip will be built, as the clip table keeps it; errors are those of `identify`."""
        asked = self.measured_motion or self.estimators.poses is PoseEstimator.REFERENCE
        return describe_build(
            self.options, self.estimators, self.opening, asked and self._told.has_motion, self.backends
        )

    def identify(self, drive: Drive | None = None) -> "BuildJob":
        """The job with its subject, told by the drive, which is described where it is not given.

        Raises:
            InputError: the drive cannot be described, has no images, or is not the one that was indexed.
        """
        drive = drive or self.describe_drive()
        if self.options.scene_id not in (None, drive.scene_id):
            raise InputError(
                f"{self.place.path}: {self.key} is {drive.scene_id}, but the clip {self.name!r} is of "
                f"{self.options.scene_id}; give the data set that was indexed, or index this one"
            )
        first, last = self.window_us or start_window(self.opening)
        inside = drive.front_us[(drive.front_us >= first) & (drive.front_us <= last)]
        if not len(inside):
            raise InputError(f"{self.place.path}: {self.key} has no front image to build a clip of")
        window_us = self.window_us or (int(inside[0]), int(inside[-1]))
        has_motion = drive.ego_span_us is not None
        return replace(self, subject=Subject(drive.scene_id, drive.take, window_us, has_motion, drive.split))

    def describe_drive(self) -> Drive:
        """What the data set tells of the drive; an `InputError` where it cannot, or is not of the `source`."""
        return self._dataset().drive(self.key)

    def open(self) -> Recording:
        """Open what the clip is built of; an `InputError` where it cannot be used, or is not of the `source`."""
        dataset = self._dataset()
        if self.window_us is None:
            return open_start(dataset, self.key, self.opening)
        return dataset.open(self.key, self.window_us, self.opening)

    def prepare(
        self, recording: Recording, on_progress: Progress = silent, on_step: OnStep = unnoticed
    ) -> dict[str, Any]:
        """Build the clip of the opened recording and prepare it in the store; returns its numbers."""
        options = self._complete_options()
        if self.measured_motion and recording.reference is not None:
            options = replace(options, use_reference_motion=True)
        kept = self.store / _GENERATED / self.clip_id
        options = replace(self.estimators.apply(options), backend=self.backends.open(kept))
        built = build_clip(recording, options, on_progress, on_step)
        start = time.perf_counter()
        info = ClipStore(self.store).prepare(built.clip)
        shutil.rmtree(kept, ignore_errors=True)
        prepared = time.perf_counter()
        pictures = {"pictures": self._draw(built.clip)} if self.pictures else {}
        drawn = time.perf_counter()
        verified = verify_before_commit(ClipStore(self.store), info.clip_id) if self.verify else None
        seconds = {"prepare": prepared - start, "pictures": drawn - prepared, "verify": time.perf_counter() - drawn}
        sources = {"poses": str(self.estimators.poses), "depth": str(self.estimators.depth)}
        sources["views"] = self.backends.backend.value
        told = {"sources": sources, **pictures, "verification": verified, "store_seconds": seconds}
        return summarize_build(built, info) | told

    def _draw(self, clip: Clip) -> dict[str, str]:
        times_us = next(iter(clip.streams.values())).timestamps_us
        called = picture_name(self.name, self.clip_id)
        return write_clip_pictures(self.store / PREVIEWS, called, clip.images, clip.origins, times_us)

    def run(self) -> BuildResult:
        """Build and prepare the clip on one thread, unless an earlier run did; an error unless the job keeps going."""
        use_one_thread()
        store = ClipStore(self.store)
        try:
            found = self._find(store)
            if found is not None:
                if self.verify and found.clip_id not in store:
                    verify_before_commit(store, found.clip_id)
                return BuildResult(self.path, "found", self.clip_id)
            return BuildResult(self.path, "built", self.clip_id, self.prepare(self.open()))
        except InputError as error:
            return self.fail(error)

    def fail(self, error: InputError) -> BuildResult:
        """The result of a job that keeps going after an error; raises the error where it does not."""
        if not self.keep_going:
            raise error
        return BuildResult(self.path, "failed", message=str(error))

    def check_options(self, found: ClipInfo) -> None:
        """Refuse (`InputError`) a clip that the store holds and that was built otherwise than the job would."""
        different = find_differences(found, self._options, self.build_options)
        if different:
            raise InputError(
                f"{self.store}: already holds the clip {found.name!r} ({self.clip_id}), built with "
                f"{'; '.join(different)}; give another folder, or the options as they were"
            )

    @property
    def _told(self) -> Subject:
        subject = self.subject or self.identify().subject
        assert subject is not None  # identify gives one
        return subject

    def _dataset(self) -> Dataset:
        dataset = self.place.open()
        if self.source not in (None, dataset.source):
            raise InputError(
                f"{self.place.path}: holds data of {dataset.source}, but the clip {self.name!r} is of {self.source}"
            )
        return dataset

    @property
    def _options(self) -> BuildOptions:
        """The options with the split that the clip gets."""
        return replace(self.options, split=self.options.split or self._told.split or DEFAULT_SPLIT)

    def _complete_options(self) -> BuildOptions:
        recording = self.place.drive_name(self.key) if self.key == WHOLE else self.key
        return replace(
            self._options,
            name=self.name,
            scene_id=self._told.scene_id,
            clip_id=self.clip_id,
            build_options=self.build_options,
            origin=self.options.origin or ClipOrigin(recording, *self._told.window_us),
        )

    def _find(self, store: ClipStore) -> ClipInfo | None:
        """The clip in the store, or as an earlier run prepared it and its pictures in the same way."""
        if self.clip_id in store:
            found = store.info(self.clip_id)
            self.check_options(found)
            return found
        # Of the pictures of a prepared clip the animation is written last.
        drawn = animation_path(self.store / PREVIEWS, picture_name(self.name, self.clip_id)).is_file()
        if self.pictures and not drawn:
            return None
        prepared = store.prepared(self.clip_id)
        differs = prepared is None or find_differences(prepared, self._options, self.build_options)
        return None if differs else prepared


def build_clips(
    jobs: Sequence[BuildJob], workers: int, on_progress: Progress = silent, engine: Engine = Engine.LOCAL
) -> list[BuildResult]:
    """Build the clips of several jobs and commit them to their one store; gives a result for each, in their order.

    Raises:
        InputError: something cannot be used and its job does not keep going. Clips prepared by then are found by the
            next run.
    """
    identified = _identify_jobs(jobs, workers, engine)
    first: dict[str, BuildJob] = {}
    for job in identified:
        if isinstance(job, BuildJob):
            first.setdefault(job.clip_id, job)
    # Drives of one scene follow each other, so that a reader which invents it need not do so again.
    ordered = sorted(first, key=lambda clip_id: first[clip_id].key)
    built = map_parallel(BuildJob.run, [first[clip_id] for clip_id in ordered], workers, on_progress, engine)
    ran = dict(zip(ordered, built, strict=True))
    results = [job if isinstance(job, BuildResult) else _result_of(job, first, ran) for job in identified]
    _remove_empty(jobs[0].store / _GENERATED)
    ClipStore(jobs[0].store).commit([result.clip_id for result in results if result.clip_id is not None])
    return results


def _remove_empty(folder: Path) -> None:
    """Remove a folder in which nothing waits any more."""
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


def _result_of(job: BuildJob, first: dict[str, BuildJob], ran: dict[str, BuildResult]) -> BuildResult:
    """The result of the first job of the clip, which its other jobs share."""
    result, ran_job = ran[job.clip_id], first[job.clip_id]
    if job is ran_job:
        return result
    same = f"the same recording as {ran_job.path}"
    if result.state == "failed":
        return replace(result, path=job.path, message=f"{same}: {result.message}")
    return BuildResult(job.path, "found", job.clip_id, message=same)


def _identify_jobs(jobs: Sequence[BuildJob], workers: int, engine: Engine) -> list[BuildJob | BuildResult]:
    """The jobs in their order, identified; of those whose drive cannot be described, why. Drives are described once."""
    numbers: dict[tuple[DatasetPlace, str], list[int]] = {}
    for number, job in enumerate(jobs):
        numbers.setdefault((job.place, job.key), []).append(number)
    drives = [[jobs[number] for number in of_drive] for of_drive in numbers.values()]
    found = chain.from_iterable(map_parallel(_identify_drive, drives, workers, engine=engine))
    by_number = dict(zip(chain.from_iterable(numbers.values()), found, strict=True))
    return [by_number[number] for number in range(len(jobs))]


def _identify_drive(jobs: Sequence[BuildJob]) -> list[BuildJob | BuildResult]:
    """The jobs of one drive, identified, or why not."""
    found: list[BuildJob | BuildResult] = []
    drive = None
    for job in jobs:
        try:
            drive = drive or job.describe_drive()
            found.append(job.identify(drive))
        except InputError as error:
            found.append(job.fail(error))
    return found
