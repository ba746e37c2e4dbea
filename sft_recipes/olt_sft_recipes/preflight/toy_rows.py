"""What the toy policy needs: a mixture or clips, and the memory of this machine."""

import shutil
from collections.abc import Iterator
from pathlib import Path

from olt_datasets import read_mixture
from olt_generator.errors import InputError
from olt_sft_recipes.preflight.machine_rows import existing_parent
from olt_sft_recipes.preflight.plan import PreflightPlan
from olt_sft_recipes.preflight.rows import Row, RowMaker
from olt_toolkit.clips.store import ClipStore

DATA, DISK = RowMaker("data"), RowMaker("disk")
_KEPT_BYTES = 200 << 20
"""Of checkpoints and logs of a toy of the largest size that its configuration allows: far more than the usual one."""


def toy_data_rows(plan: PreflightPlan) -> tuple[list[Row], int | None]:
    """Whether there are samples, each of which its clip has, and how many items an epoch takes."""
    if plan.data is None:
        return [DATA.not_checked("samples", "--data", "no mixture was given")], None
    try:
        if plan.data.is_file():
            return _mixture_rows(plan.data)
        infos = ClipStore(plan.data).clips()
    except InputError as error:
        return [DATA.failed("samples", plan.data, str(error), "give a mixture of `olt mix compose`")], None
    samples = sum(len(info.sample_t0_us) for info in infos if not plan.contract.lacking(info.views))
    wrong = [] if samples else [f"none of {len(infos)} clips gives a sample with {plan.contract.name}'s cameras"]
    good = f"{samples} samples of {len(infos)} clips"
    return [DATA.judge("samples", plan.data, wrong, good, "build longer clips with these cameras")], samples


def _mixture_rows(path: Path) -> tuple[list[Row], int | None]:
    mixture = read_mixture(path)
    wrong = []
    for (store,), rows in mixture.samples.select("store", "clip_id", "t0_us").unique().group_by("store"):
        folder = Path(str(store))
        if not folder.is_dir():
            wrong.append(f"{folder}: no such clip store")
            continue
        opened = ClipStore(folder)
        for clip_id, t0_us in rows.select("clip_id", "t0_us").iter_rows():
            if clip_id not in opened or t0_us not in opened.info(clip_id).sample_t0_us:
                wrong.append(f"{folder}: no sample of clip {clip_id} at {t0_us} us")
    good = f"{len(mixture)} items an epoch, of {mixture.samples.height} samples that their clips have"
    return [DATA.judge("samples", path, sorted(wrong), good, "compose the mixture again")], len(mixture)


def toy_disk_row(plan: PreflightPlan) -> Row:
    """Free space against what a toy's checkpoints can take."""
    check = "space for checkpoints"
    if plan.out is None:
        return DISK.not_checked(check, "--out", "no output folder was given")
    there = existing_parent(plan.out)
    free = shutil.disk_usage(there).free
    said = f"{_KEPT_BYTES / 1e9:.1f} GB at most; {free / 1e9:.1f} GB are free"
    return DISK.judge(check, there, [said] if free < _KEPT_BYTES else [], said, "choose another --out")


def toy_memory_rows() -> Iterator[Row]:
    """The toy trains on processors, in what memory a few hundred samples take; nothing is estimated."""
    yield RowMaker("memory").not_checked("memory", "this machine", "the toy needs no card and little memory")
