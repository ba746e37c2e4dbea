"""Verifies a folder or file by what it is: a clip store or PhysicalAI-AV tree, a LeRobot data set, or a mixture."""

from collections.abc import Collection
from functools import partial
from pathlib import Path

import polars as pl

from olt_datasets.mixtures.mixture_file import MIXTURE_SUFFIXES, read_mixture
from olt_datasets.verification.lerobot import INFO_FILE, verify_lerobot
from olt_generator.errors import InputError
from olt_generator.progress import Progress, silent
from olt_toolkit.clips.pai_layout import CLIP_INDEX
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.table import CLIP_TABLE
from olt_toolkit.clips.verification.findings import Finding, judge, state
from olt_toolkit.clips.verification.public_folder import verify_public_folder
from olt_toolkit.clips.verification.report import Report
from olt_toolkit.clips.verification.verify import GROUPS, verify_store
from olt_toolkit.runtime.workers import Engine


def verify(
    target: Path,
    groups: Collection[str] = GROUPS,
    workers: int = 1,
    on_progress: Progress = silent,
    engine: Engine = Engine.LOCAL,
) -> Report:
    """Look at all that a target holds.

    Args:
        target: a clip store, an export, a PhysicalAI-AV folder as it is published, or the file of a mixture.
        groups: which checks are made, of `olt_toolkit.clips.verification.verify.GROUPS`.
        workers, engine: number of processes and where they run.
        on_progress: told the share of the clips that are done.

    Raises:
        InputError: it is none of these, or the tables that list its clips cannot be read.
    """
    if (target / CLIP_TABLE).is_file():
        return verify_store(target, groups, workers, on_progress, engine)
    if (target / INFO_FILE).is_file():
        return verify_lerobot(target, groups, workers, on_progress, engine)
    if target.is_file() and target.suffix in MIXTURE_SUFFIXES:
        return _verify_mixture(target, groups, workers, on_progress, engine)
    if (target / CLIP_INDEX).is_file():
        return verify_public_folder(target, groups, workers, on_progress, engine)
    tables = f"{CLIP_TABLE}, {CLIP_INDEX} or {INFO_FILE}"
    missing = f"a folder with {tables}, or a mixture ({' or '.join(MIXTURE_SUFFIXES)})"
    raise InputError(f"{target}: nothing that can be verified; give {missing}")


def _verify_mixture(path: Path, groups: Collection[str], workers: int, on_progress: Progress, engine: Engine) -> Report:
    """The clips that a mixture draws from, in whatever stores, and each of its samples."""
    samples = read_mixture(path).samples.select("store", "clip_id", "t0_us").unique()
    report = Report()
    parts = samples.sort("store", "clip_id", "t0_us").partition_by("store", maintain_order=True)
    for done, of_store in enumerate(parts):
        store = ClipStore(Path(of_store["store"][0]))
        if store.root.is_file():
            raise InputError(f"{store.root}: its clips are indexed and not built; build them with `olt data build`")
        clip_ids = of_store["clip_id"].unique(maintain_order=True).to_list()
        missing = [clip_id for clip_id in clip_ids if clip_id not in store]
        detail = "clips of the mixture that the store lacks" + "".join(f", as {each}" for each in missing[:1])
        report.add([judge("clips of the mixture", f"{path}: {store.root}", float(len(missing)), 0.0, detail)])
        present = [clip_id for clip_id in clip_ids if clip_id in store]
        report.add(_check_samples(path, store, of_store.filter(pl.col("clip_id").is_in(present))))
        on_part = partial(_tell_part, on_progress, done, len(parts))
        report.merge(verify_store(store.root, groups, workers, on_part, engine, present))
    return report


def _tell_part(on_progress: Progress, done: int, parts: int, share: float) -> None:
    on_progress((done + share) / parts)


def _check_samples(path: Path, store: ClipStore, samples: pl.DataFrame) -> list[Finding]:
    """Whether each sample is one that its clip gives; that clips cover those is looked at clip by clip."""
    check, where = "samples of the mixture", f"{path}: {store.root}"
    wrong = [
        f"t0 {t0_us} us of clip {clip_id}"
        for clip_id, t0_us in samples.select("clip_id", "t0_us").iter_rows()
        if t0_us not in store.info(clip_id).sample_t0_us
    ]
    detail = f"{len(wrong)} are no sample times of their clips, as {wrong[0]}" if wrong else "all are their clips' own"
    return [state(check, where, not wrong, detail)]
