"""Plants faults into good clips, and counts what verification says of both."""

import shutil
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal

from scipy.stats import binomtest

from olt_datasets.benchmarks.image_faults import ImageFault
from olt_datasets.benchmarks.planted_faults import FAULTS, Fault
from olt_datasets.benchmarks.verified_clips import write_clean_store
from olt_generator.errors import InputError
from olt_generator.seeds import make_generator
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.verification.findings import Finding, Verdict
from olt_toolkit.clips.verification.store_checks import check_store
from olt_toolkit.clips.verification.verify import CLIP_CHECKS, STORE_GROUP, verify_clip
from olt_toolkit.runtime.console import show_progress
from olt_toolkit.runtime.environment import describe_machine
from olt_toolkit.runtime.threads import use_one_thread
from olt_toolkit.runtime.workers import default_workers, map_parallel

Outcome = Literal["found", "not compared", "missed"]
_AIM = 0.95


@dataclass(frozen=True)
class StoreMeasure:
    """What verification said of one store and of the faults in it.

    Attributes:
        outcomes: of each fault, by its name.
        clean: verdicts on the good clips.
        false_alarms: what failed of them, in words.
        seconds: processor time of each group of checks for the good clips, and how many clips there are.
    """

    outcomes: dict[str, Outcome]
    clean: list[Verdict]
    false_alarms: list[str]
    seconds: dict[str, float] = field(default_factory=dict)
    clips: int = 2


Measure = Callable[..., list[StoreMeasure]]
"""Measures the store of a number, with a seed and the names of faults."""


def count_faults(
    benchmark: str,
    measure: Measure,
    faults: Sequence[Fault | ImageFault],
    groups: Sequence[str],
    stores: int,
    seed: int,
    asked: str | None,
    workers: int | None,
) -> dict[str, Any]:
    """Measure so many stores, with the faults whose name holds the text that is asked for, and sum up.

    Raises:
        InputError: no fault is called so.
    """
    names = tuple(fault.name for fault in faults if asked is None or asked in fault.name)
    if not names:
        raise InputError(f"--faults {asked!r}: no fault is called so")
    with show_progress(f"bench {benchmark}", stores) as (on_progress, _):
        measured = map_parallel(
            partial(measure, seed=seed, faults=names), list(range(stores)), workers or default_workers(), on_progress
        )
    summary = summarize([each for of_store in measured for each in of_store], faults, groups)
    return {"benchmark": benchmark, "stores": stores, "seed": seed, **summary, "machine": describe_machine()}


def measure_store(number: int, seed: int, faults: Sequence[str]) -> list[StoreMeasure]:
    """Make a store of two good clips, look at it, and plant each of the faults into a copy of its own."""
    use_one_thread()
    with tempfile.TemporaryDirectory(prefix="verify.") as folder:
        good = Path(folder) / "good"
        store = write_clean_store(good, number, seed)
        findings, seconds = _look_at_good(store)
        outcomes: dict[str, Outcome] = {
            fault.name: _plant(good, Path(folder) / "bad", fault, (number, seed))
            for fault in FAULTS
            if fault.name in faults
        }
    return [StoreMeasure(outcomes, [each.verdict for each in findings], word_alarms(findings), seconds)]


def tell_outcome(findings: Sequence[Finding]) -> Outcome:
    """What the findings of the checks that should find a fault say of it: one that fails is enough."""
    verdicts = {each.verdict for each in findings}
    if Verdict.FAILED in verdicts:
        return "found"
    return "not compared" if Verdict.NOT_COMPARED in verdicts else "missed"


def word_alarms(findings: Sequence[Finding]) -> list[str]:
    """What failed of a good clip, in words."""
    alarms = [each for each in findings if each.verdict is Verdict.FAILED]
    return [f"{each.check}: {each.where.partition('clip ')[2]}: {each.measured} {each.detail}" for each in alarms]


def summarize(
    measured: Sequence[StoreMeasure],
    faults: Sequence[Fault | ImageFault],
    groups: Sequence[str],
) -> dict[str, Any]:
    """Shares of faults and false alarms with exact (Clopper-Pearson) intervals of 95 %; time by what is looked at."""
    rows = [_summarize_fault(fault, measured) for fault in faults if fault.name in measured[0].outcomes]
    verdicts = [verdict for each in measured for verdict in each.clean]
    failed = sum(verdict is Verdict.FAILED for verdict in verdicts)
    compared = sum(verdict is not Verdict.NOT_COMPARED for verdict in verdicts)
    return {
        "faults": rows,
        "clean": {
            "clips": sum(each.clips for each in measured),
            "compared": compared,
            "failed": failed,
            "not_compared": len(verdicts) - compared,
            "interval": _interval(failed, compared),
            "false_alarms": [alarm for each in measured for alarm in each.false_alarms],
        },
        "cost": _summarize_cost(rows, measured, groups),
    }


def _look_at_good(store: ClipStore) -> tuple[list[Finding], dict[str, float]]:
    start = time.process_time()
    findings = list(check_store(store))
    seconds = {STORE_GROUP: time.process_time() - start}
    for group in CLIP_CHECKS:
        start = time.process_time()
        for info in store.clips():
            findings += verify_clip(store, info.clip_id, (group,))
        seconds[group] = time.process_time() - start
    return findings, seconds


def _plant(good: Path, bad: Path, fault: Fault, seeds: tuple[int, int]) -> Outcome:
    shutil.copytree(good, bad)
    try:
        first, second = (info.clip_id for info in ClipStore(bad).clips())
        fault.plant(bad, first, second, make_generator("planted faults", *seeds, fault.name))
        store = ClipStore(bad)
        findings = list(check_store(store)) if STORE_GROUP in fault.groups else []
        findings += verify_clip(store, first, fault.groups)
    finally:
        shutil.rmtree(bad)
    return tell_outcome([each for each in findings if each.check in fault.expected_checks])


def _summarize_fault(fault: Fault | ImageFault, measured: Sequence[StoreMeasure]) -> dict[str, Any]:
    outcomes = [each.outcomes[fault.name] for each in measured]
    found, missed = outcomes.count("found"), outcomes.count("missed")
    return {
        "fault": fault.name,
        "groups": list(fault.groups),
        "n": len(outcomes),
        "found": found,
        "not_compared": outcomes.count("not compared"),
        "missed": missed,
        "interval": _interval(found, found + missed),
    }


def _summarize_cost(
    rows: Sequence[dict[str, Any]], measured: Sequence[StoreMeasure], groups: Sequence[str]
) -> list[dict[str, Any]]:
    """Time and kinds of faults found when the groups are added one after the other."""
    clips = sum(each.clips for each in measured)
    costs, looked, seconds = [], [], 0.0
    for group in groups:
        looked.append(group)
        seconds += sum(each.seconds[group] for each in measured)
        inside = [row for row in rows if set(row["groups"]) <= set(looked)]
        good = sum(row["found"] >= _AIM * (row["found"] + row["missed"]) and row["found"] > 0 for row in inside)
        costs.append(
            {
                "looks_at": " + ".join(looked),
                "ms_per_clip": 1e3 * seconds / clips,
                "kinds_found": good,
                "kinds": len(rows),
            }
        )
    return costs


def _interval(count: int, total: int) -> list[float] | None:
    if total == 0:
        return None
    bounds = binomtest(count, total).proportion_ci(0.95, "exact")
    return [float(bounds.low), float(bounds.high)]
