"""An export is looked at before it appears, and its clips before that where failing ones are to be left out."""

import shutil
from collections.abc import Callable
from pathlib import Path

from olt_datasets.export.contents import Contents
from olt_generator.errors import InputError
from olt_generator.progress import Progress
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.verification.findings import Verdict
from olt_toolkit.clips.verification.report import Report
from olt_toolkit.clips.verification.verify import GROUPS, refuse_failed, verify_clip
from olt_toolkit.runtime.threads import use_one_thread
from olt_toolkit.runtime.workers import Engine, map_parallel

Verify = Callable[..., Report]


def look_at_export(
    verify: Verify, root: Path, out: Path, workers: int, on_progress: Progress, engine: Engine
) -> dict[str, int]:
    """Verify what was written to `root`, which is to become `out`, and remove it where a check fails.

    Returns:
        How many checks passed, and how many could not be made.

    Raises:
        InputError: a check failed; names the file and the check.
    """
    report = verify(root, GROUPS, workers, on_progress, engine)
    if report.failures:
        shutil.rmtree(root)
    advice = "nothing was exported; run `olt data verify` on the clips, mend them, or export with --no-verify"
    refuse_failed(report, str(out), advice)
    return {verdict.name.lower(): report.count(verdict) for verdict in (Verdict.PASSED, Verdict.NOT_COMPARED)}


def leave_out_failing(
    contents: Contents, out: Path, workers: int, on_progress: Progress, engine: Engine
) -> tuple[Contents, dict[str, str]]:
    """Look at each clip in its store; returns the contents without those that fail, and why each does.

    Raises:
        InputError: no clip is left.
    """
    clips = list(dict.fromkeys((item.store, item.clip_id) for item in contents.items))
    reasons = map_parallel(_why_failing, clips, workers, on_progress, engine)
    failures = {clip_id: why for (_, clip_id), why in zip(clips, reasons, strict=True) if why is not None}
    kept = contents.without(failures)
    if not kept.groups:
        raise InputError(f"{out}: every clip failed verification, as {next(iter(failures.values()))}")
    return kept, failures


def _why_failing(clip: tuple[Path, str]) -> str | None:
    use_one_thread()
    store, clip_id = clip
    try:
        report = Report().add(verify_clip(ClipStore(store), clip_id))
        refuse_failed(report, f"clip {clip_id}", "mend it, or export with --no-verify")
    except InputError as error:
        return str(error)
    return None


def halves(on_progress: Progress, verify: bool) -> tuple[Progress, Progress]:
    """Progress of writing and of looking: half of the whole each, or all is writing."""
    part = 0.5 if verify else 1.0
    return lambda share: on_progress(part * share), lambda share: on_progress(part + (1.0 - part) * share)
