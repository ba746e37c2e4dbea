"""An export is looked at before it appears."""

import shutil
from collections.abc import Callable
from pathlib import Path

from olt_generator.progress import Progress
from olt_toolkit.clips.verification.findings import Verdict
from olt_toolkit.clips.verification.report import Report
from olt_toolkit.clips.verification.verify import GROUPS, refuse_failed
from olt_toolkit.runtime.workers import Engine

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


def halves(on_progress: Progress, verify: bool) -> tuple[Progress, Progress]:
    """Progress of writing and of looking: half of the whole each, or all is writing."""
    part = 0.5 if verify else 1.0
    return lambda share: on_progress(part * share), lambda share: on_progress(part + (1.0 - part) * share)
