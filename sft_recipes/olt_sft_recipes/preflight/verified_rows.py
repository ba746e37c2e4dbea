"""What `olt data verify` says of a sample of the clips: all of them would take longer than a preflight may."""

import time
from pathlib import Path

from olt_datasets import read_mixture
from olt_generator.errors import InputError
from olt_sft_recipes.preflight.data_rows import spread
from olt_sft_recipes.preflight.plan import PreflightPlan
from olt_sft_recipes.preflight.rows import Row, RowMaker, name_first
from olt_toolkit.clips.pai_layout import CLIP_INDEX
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.table import CLIP_TABLE
from olt_toolkit.clips.verification.findings import Finding, Verdict
from olt_toolkit.clips.verification.public_folder import PublicFolder
from olt_toolkit.clips.verification.report import Report
from olt_toolkit.clips.verification.verify import verify_clip

ROWS = RowMaker("data")
GROUPS = ("files", "times", "motion", "calibration")
"""The checks of a clip that decode no video."""
_OF_THE_TABLE = frozenset({"duration", "sample times", "shares of pixels", "checksums"})
"""Checks against a clip table, which a folder as it is published does not have."""


def verified_row(plan: PreflightPlan) -> Row:
    """One row for a sample of the clips of the training data: of a folder, or of the stores of a mixture."""
    if plan.data is None:
        return ROWS.not_checked("verified", "--data", "no folder was given")
    try:
        return _verify_sample(plan, plan.data, _clips_of(plan.data))
    except InputError as error:
        return ROWS.failed("verified", plan.data, str(error), "run `olt data verify` on it")


def _clips_of(data: Path) -> list[tuple[ClipStore, str]]:
    if data.is_file():
        rows = read_mixture(data).samples.select("store", "clip_id").unique().sort("store", "clip_id").rows()
        stores = {store: ClipStore(Path(store)) for store, _ in rows}
        return [(stores[store], clip_id) for store, clip_id in rows]
    if (data / CLIP_TABLE).is_file():
        store = ClipStore(data)
    elif (data / CLIP_INDEX).is_file():
        store = PublicFolder(data)
    elif not data.exists():
        raise InputError(f"{data}: no such file or folder")
    else:
        raise InputError(f"{data}: neither {CLIP_TABLE} nor {CLIP_INDEX} is here; give a clip store or an export")
    return [(store, info.clip_id) for info in store.clips()]


def _verify_sample(plan: PreflightPlan, data: Path, clips: list[tuple[ClipStore, str]]) -> Row:
    deadline, report = time.monotonic() + plan.seconds, Report()
    for number, (store, clip_id) in enumerate(spread(clips, plan.clips)):
        if number and time.monotonic() > deadline:
            break
        if clip_id not in [info.clip_id for info in store.clips()]:
            raise InputError(f"{store.root}: no clip {clip_id}, which the mixture draws from; compose it again")
        passed_over = _OF_THE_TABLE if isinstance(store, PublicFolder) else frozenset()
        report.add(found for found in verify_clip(store, clip_id, GROUPS) if found.check not in passed_over)
        report.clips += 1
    return _word(data, report, f"{report.clips} of {len(clips)} clips")


def _word(where: Path, report: Report, what: str) -> Row:
    counts = {verdict: report.count(verdict) for verdict in Verdict}
    looked = f"{what} ({', '.join(GROUPS)}): {counts[Verdict.PASSED]} passed, {counts[Verdict.FAILED]} failed, "
    looked += f"{counts[Verdict.NOT_COMPARED]} not compared"
    if report.failures:
        told = name_first([_told(finding) for finding in report.failures])
        return ROWS.failed("verified", where, f"{looked}: {told}", f"`olt data verify {where}` looks at all of it")
    if not counts[Verdict.PASSED]:
        return ROWS.not_checked("verified", where, f"nothing could be compared: {looked}")
    return ROWS.passed("verified", where, f"{looked}; `olt data verify` looks at all clips, and at images")


def _told(finding: Finding) -> str:
    number = "" if finding.measured is None else f"{finding.measured:.4g} "
    return f"{finding.check}: {finding.where}: {number}{finding.detail}"
