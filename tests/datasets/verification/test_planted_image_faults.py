"""The table of faults that only images show, on a store of two small clips."""

import json

import pytest
from typer.testing import CliRunner

from olt_datasets.benchmarks import rendered_rates
from olt_datasets.benchmarks.image_verification import app
from olt_datasets.benchmarks.verification import print_result
from olt_generator.errors import InputError
from olt_toolkit.clips.store import ClipStore

from ...toolkit.clips.verification.blob_world import bend_motion, blob_clip


def write_small_store(root, _, seed):
    clips = [
        blob_clip("first", seed, frames=30),
        blob_clip("second", seed + 1, frames=30, motion=lambda times_us: bend_motion(times_us, -1.0, 0.6)),
    ]
    store = ClipStore(root)
    for clip in clips:
        store.prepare(clip)
    store.commit([clip.clip_id for clip in clips])
    return store


@pytest.fixture
def small_store(monkeypatch):
    monkeypatch.setattr(rendered_rates, "write_rendered_store", write_small_store)


def run(*arguments):
    return CliRunner().invoke(app, ["--stores", "1", "--seed", "0", "--workers", "1", *arguments])


def test_faults_are_counted_in_each_clip(small_store, capsys):
    result = run("--faults", "video exchanged", "--json")
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    rows = {row["fault"]: row for row in told["faults"]}
    assert list(rows) == [
        f"{cameras} video exchanged" for cameras in ("left and right", "front and left", "front and tele")
    ]
    for row in rows.values():
        assert (row["n"], row["found"], row["missed"]) == (2, 2, 0)
        assert row["interval"] == [pytest.approx(0.158, abs=0.001), 1.0]
    clean = told["clean"]
    assert (clean["clips"], clean["failed"], clean["false_alarms"]) == (2, 0, [])
    assert clean["compared"] > 20 and told["cost"][0]["kinds_found"] == 3
    print_result(told)
    printed = capsys.readouterr().out
    assert "left and right video exchanged" in printed and "0 of" in printed


def test_an_unknown_fault_is_refused(small_store):
    with pytest.raises(InputError, match="no fault is called so"):
        CliRunner().invoke(app, ["--faults", "no such fault"], catch_exceptions=False)
