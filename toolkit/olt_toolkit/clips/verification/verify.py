"""Runs the checks: on one clip, on a clip that waits to be committed, on a whole store."""

import tempfile
import uuid
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path

from olt_generator.errors import InputError
from olt_generator.progress import Progress, silent
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.verification.calibration_checks import check_calibration
from olt_toolkit.clips.verification.decoded_videos import ClipVideos
from olt_toolkit.clips.verification.file_checks import check_files
from olt_toolkit.clips.verification.findings import Finding, Verdict, state
from olt_toolkit.clips.verification.image_checks import check_images
from olt_toolkit.clips.verification.motion_table import check_motion
from olt_toolkit.clips.verification.report import Report
from olt_toolkit.clips.verification.store_checks import check_store
from olt_toolkit.clips.verification.time_checks import check_times
from olt_toolkit.clips.verification.video_checks import check_videos
from olt_toolkit.runtime.threads import use_one_thread
from olt_toolkit.runtime.workers import Engine, map_parallel

ClipCheck = Callable[[ClipStore, str, ClipVideos], Iterable[Finding]]

CLIP_CHECKS: dict[str, ClipCheck] = {
    "files": lambda store, clip_id, _: check_files(store, clip_id),
    "times": lambda store, clip_id, _: check_times(store, clip_id),
    "motion": lambda store, clip_id, _: check_motion(store, clip_id),
    "calibration": lambda store, clip_id, _: check_calibration(store, clip_id),
    "videos": check_videos,
    "images": check_images,
}
"""The checks of one clip, by the name of their group, the cheap ones first."""
STORE_GROUP = "tables"
"""The group of the checks that look at a whole store."""
GROUPS = (STORE_GROUP, *CLIP_CHECKS)


def check_groups(names: Sequence[str]) -> tuple[str, ...]:
    """The groups of those names; an `InputError` where there is no such group."""
    unknown = [name for name in names if name not in GROUPS]
    if unknown or not names:
        raise InputError(f"no checks {', '.join(unknown) or 'given'}; choose from {', '.join(GROUPS)}")
    return tuple(dict.fromkeys(names))


def verify_clip(store: ClipStore, clip_id: str, groups: Collection[str] = GROUPS) -> list[Finding]:
    """All findings about one clip; what cannot be read is a failure and no error."""
    findings: list[Finding] = []
    videos = ClipVideos(store, clip_id)
    for group in (name for name in CLIP_CHECKS if name in groups):
        try:
            findings += CLIP_CHECKS[group](store, clip_id, videos)
        except InputError as error:
            findings.append(state(f"readable for {group}", f"{store.root}: clip {clip_id}", False, str(error)))
    return findings


def verify_prepared(store: ClipStore, clip_id: str, groups: Collection[str] = GROUPS) -> Report:
    """Look at a clip that waits to be committed, as a store that holds it alone."""
    with tempfile.TemporaryDirectory(prefix=".verify.", dir=store.root) as folder:
        alone = store.copy_prepared(clip_id, Path(folder))
        return _at(store.root, verify_store(alone.root, groups), Path(folder))


def verify_before_commit(store: ClipStore, clip_id: str) -> dict[str, int]:
    """Look at a prepared clip, and discard it where a check fails.

    Returns:
        How many checks passed, and how many could not be made.

    Raises:
        InputError: a check failed; the clip is no longer prepared.
    """
    report = verify_prepared(store, clip_id)
    if report.failures:
        store.discard(clip_id)
    refuse_failed(report, f"clip {clip_id}", "it is not kept; mend its recording, or build with --no-verify")
    return {verdict.name.lower(): report.count(verdict) for verdict in (Verdict.PASSED, Verdict.NOT_COMPARED)}


def verify_store(
    root: Path,
    groups: Collection[str] = GROUPS,
    workers: int = 1,
    on_progress: Progress = silent,
    engine: Engine = Engine.LOCAL,
    clip_ids: Sequence[str] | None = None,
) -> Report:
    """Look at a store and all of its clips, or those that are given.

    Raises:
        InputError: the folder is no clip store, or its clip table or clip index cannot be read.
    """
    store = ClipStore(root)
    clips = [info.clip_id for info in store.clips()] if clip_ids is None else list(clip_ids)
    report = Report().add(check_store(store)) if STORE_GROUP in groups else Report()
    look = partial(_verify_one, root, tuple(groups), uuid.uuid4().hex)
    for each in map_parallel(look, clips, workers, on_progress, engine):
        report.merge(each)
    return report


def refuse_failed(report: Report, what: str, advice: str) -> None:
    """An `InputError` with the first failures of a report where it has any."""
    if report.failures:
        shown = "; ".join(f"{each.check}: {each.where}: {each.detail}" for each in report.failures[:3])
        raise InputError(f"{what} failed {report.count(Verdict.FAILED)} checks: {shown}; {advice}")


def _verify_one(root: Path, groups: tuple[str, ...], run: str, clip_id: str) -> Report:
    use_one_thread()
    report = Report().add(verify_clip(_open(root, run), clip_id, groups))
    report.clips = 1
    return report


@lru_cache(maxsize=8)
def _open(root: Path, run: str) -> ClipStore:
    """The store as this process opened it in this run: tables are read once, and not for every clip."""
    return ClipStore(root)


def _at(root: Path, report: Report, folder: Path) -> Report:
    """The report with failures said of the store and not of the folder in which the clip was looked at."""
    report.failures = [
        replace(
            each, where=each.where.replace(str(folder), str(root)), detail=each.detail.replace(str(folder), str(root))
        )
        for each in report.failures
    ]
    return report
