"""What the toy policy needs: a mixture or clips, and the memory of this machine."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from olt_datasets import read_mixture
from olt_generator.errors import InputError
from olt_sft_recipes.preflight.machine_rows import existing_parent
from olt_sft_recipes.preflight.plan import PreflightPlan
from olt_sft_recipes.preflight.rows import Row, RowMaker
from olt_toolkit.clips.store import ClipStore

DATA, DISK = RowMaker("data"), RowMaker("disk")
_KEPT_BYTES = 200 << 20
"""Of checkpoints and logs of a toy of the largest size that its configuration allows: far more than the usual one."""


class ToyData(NamedTuple):
    """The rows of the data, items of an epoch, and the distinct samples; None where they cannot be told."""

    rows: list[Row]
    items: int | None = None
    samples: int | None = None


def toy_data(plan: PreflightPlan) -> ToyData:
    """Whether there are samples, each of which its clip has, and how many."""
    if plan.data is None:
        return ToyData([DATA.not_checked("samples", "--data", "no mixture was given")])
    if not plan.data.exists():
        return ToyData([DATA.failed("samples", plan.data, "no such file or folder", "compose it by `olt mix compose`")])
    try:
        if plan.data.is_file():
            return _look_at_mixture(plan.data)
        infos = ClipStore(plan.data).clips()
    except InputError as error:
        return ToyData([DATA.failed("samples", plan.data, str(error), "give a mixture of `olt mix compose`")])
    samples = sum(len(info.sample_t0_us) for info in infos if not plan.contract.lacking(info.views))
    wrong = [] if samples else [f"none of {len(infos)} clips gives a sample with {plan.contract.name}'s cameras"]
    good = f"{samples} samples of {len(infos)} clips"
    return ToyData(
        [DATA.judge("samples", plan.data, wrong, good, "build longer clips with these cameras")], samples, samples
    )


def _look_at_mixture(path: Path) -> ToyData:
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
    return ToyData(
        [DATA.judge("samples", path, sorted(wrong), good, "compose the mixture again")],
        len(mixture),
        mixture.samples.height,
    )


def toy_disk_row(plan: PreflightPlan, samples: int | None) -> Row:
    """Free space against the decoded samples, which lie on the disk while it trains, and what its checkpoints take."""
    check = "space for checkpoints and samples"
    if plan.out is None:
        return DISK.not_checked(check, "--out", "no output folder was given")
    there = existing_parent(plan.out)
    free = shutil.disk_usage(there).free
    if samples is None:
        return DISK.not_checked(check, plan.out, "the number of samples is not known")
    from olt_sft_recipes.toy.config import ToyPolicyConfig
    from olt_sft_recipes.training.sample_arrays import bytes_of_sample

    decoded = samples * bytes_of_sample(ToyPolicyConfig())
    said = (
        f"{decoded / 1e9:.1f} GB of decoded samples while it trains, {_KEPT_BYTES / 1e9:.1f} GB at most of "
        f"checkpoints; {free / 1e9:.1f} GB are free"
    )
    wrong = [said] if free < decoded + _KEPT_BYTES else []
    return DISK.judge(check, there, wrong, said, "choose another --out, or fewer samples")


def toy_memory_rows() -> Iterator[Row]:
    """The toy trains on processors, and its samples are mapped from the disk; nothing is estimated."""
    yield RowMaker("memory").not_checked("memory", "this machine", "the toy needs no card and little memory")
