import pytest

from olt_datasets.benchmarks import mixture
from olt_datasets.benchmarks.table_steps import InventedPlace, measure_steps
from olt_datasets.tables.clip_frame import read_clip_tables
from olt_datasets.tables.cutting import Cutting
from olt_datasets.tables.indexing import index_dataset


@pytest.mark.slow
def test_steps_of_tables_are_measured_each_in_a_process_of_its_own():
    steps = measure_steps(rows=5_000, index_rows=0)
    assert [step["step"] for step in steps] == ["split seen", "split unseen", "mix check", "mix compose"]
    assert all(step["rows"] == 5_000 and step["processor_seconds"] > 0.0 for step in steps)


def test_invented_drives_give_four_clips_each(tmp_path):
    place = InventedPlace(tmp_path / "3", source="invented")
    found = index_dataset(place, tmp_path / "clips.parquet", Cutting(), workers=1, with_fingerprints=False)
    assert (found.drives, found.clips) == (3, 12) and found.clips_with_samples > 0
    assert read_clip_tables([tmp_path / "clips.parquet"])["scene_id"].n_unique() == 3


def test_the_benchmark_of_mixtures_counts_synthesized_items(monkeypatch):
    monkeypatch.setattr(mixture, "SAMPLES", 3200)
    default = next(setting for setting in mixture.BENCHMARK.settings() if setting.default)
    counts = default.prepare()()
    assert set(counts.tolist()) == {9, 10}
