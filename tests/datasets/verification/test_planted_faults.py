"""Every kind of fault is found in a clip that shows it, and nothing is said of a good clip."""

import shutil

import pytest

from olt_datasets.benchmarks.fault_rates import measure_store, summarize
from olt_datasets.benchmarks.planted_faults import FAULTS as KINDS
from olt_datasets.benchmarks.verified_clips import write_clean_store
from olt_generator.seeds import make_generator
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.verification.findings import Verdict
from olt_toolkit.clips.verification.verify import CLIP_CHECKS, GROUPS, verify_store

SEED = 7
FAULTS = {fault.name: fault for fault in KINDS}


@pytest.fixture(scope="session")
def good(tmp_path_factory):
    """Two clips that turn."""
    return write_clean_store(tmp_path_factory.mktemp("good") / "store", 0, SEED)


def test_a_good_store_passes_every_check(good):
    report = verify_store(good.root)
    assert report.failures == [] and report.clips == 2
    assert report.count(Verdict.PASSED) > 100
    assert "turns with its way" in report.tallies and "no image repeated" in report.tallies


@pytest.mark.parametrize("name", FAULTS)
def test_a_planted_fault_is_found_by_the_check_that_is_for_it(name, good, tmp_path):
    fault, bad = FAULTS[name], tmp_path / "bad"
    shutil.copytree(good.root, bad)
    first, second = (info.clip_id for info in ClipStore(bad).clips())
    fault.plant(bad, first, second, make_generator("planted faults", 0, SEED, name))
    report = verify_store(bad, fault.groups, clip_ids=[first])
    assert {each.check for each in report.failures} & set(fault.expected_checks)
    assert all(each.detail and each.where.startswith(str(bad)) for each in report.failures)


def test_names_of_faults_and_groups_are_sound():
    assert len(FAULTS) == len(KINDS)
    assert all(set(fault.groups) <= set(GROUPS) for fault in FAULTS.values())


def test_a_swapped_video_is_told_with_the_clip_that_it_belongs_to(good, tmp_path):
    shutil.copytree(good.root, tmp_path / "bad")
    first, second = (info.clip_id for info in ClipStore(tmp_path / "bad").clips())
    FAULTS["videos of two clips swapped"].plant(tmp_path / "bad", first, second, make_generator("unused"))
    details = [each.detail for each in verify_store(tmp_path / "bad", ("files",)).failures]
    assert any(second in detail and "swapped" in detail for detail in details)
    assert any(first in detail for detail in details)


def test_workers_change_nothing(good):
    assert verify_store(good.root, workers=2).to_dict() == verify_store(good.root).to_dict()


def test_checks_are_listed_with_the_cheap_ones_first():
    assert list(CLIP_CHECKS)[-2:] == ["videos", "images"]


def test_rates_come_with_intervals():
    names = ["positions in cm", "curvature positive to the right"]
    summary = summarize([*measure_store(0, SEED, names), *measure_store(5, SEED, names)], KINDS, GROUPS)
    rows = {row["fault"]: row for row in summary["faults"]}
    assert rows["positions in cm"]["n"] == 2
    for row in rows.values():
        assert row["found"] + row["not_compared"] + row["missed"] == 2
    assert summary["clean"]["failed"] == 0 and summary["clean"]["interval"][0] == 0.0
    assert [cost["ms_per_clip"] for cost in summary["cost"]] == sorted(cost["ms_per_clip"] for cost in summary["cost"])
