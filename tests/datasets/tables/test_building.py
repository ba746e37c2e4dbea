"""Rows of an indexed table become clips of a store."""

from dataclasses import replace

import numpy as np
import pytest

from olt_datasets.tables.building import build_row, find_buildable
from olt_datasets.tables.choices import BuiltKind
from olt_datasets.tables.cutting import Cutting, cut_drive
from olt_datasets.tables.indexing import index_dataset
from olt_datasets.tables.splits import SplitRule, Splitting, split_table
from olt_generator.errors import InputError
from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.build_job import BuildJob, build_clips
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.table import read_clip_table
from olt_toolkit.clips.views import BuildOptions
from olt_toolkit.policy.sample import SampleKey
from olt_toolkit.recordings.drives import DatasetPlace
from olt_toolkit.rigs.rig import CROSS_LEFT, FRONT_WIDE, POLICY_CAMERAS

from ..toy_drives import LICENCE, ToyDataset, make_drive

SURROUND = make_drive("a", 100, true_views=POLICY_CAMERAS, split="train", category="cyclists", factors=("rain",))
CUTTING = Cutting(frames=30, stride=42)
SIZE = BuildOptions(width=64, height=36)


def rows_of(*drives):
    return [row for drive in drives for row in cut_drive(drive, CUTTING, LICENCE.name)]


def jobs_for(rows, place, store, kind=BuiltKind.GT, **changes):
    job = BuildJob(place, "", store, options=SIZE)
    return [build_row(row, kind, replace(job, **changes)) for row in rows]


def test_a_built_clip_is_what_its_row_says(open_toy, tmp_path):
    place, dataset = open_toy(ToyDataset({"a": SURROUND}))
    rows = rows_of(SURROUND)
    outcomes = build_clips(jobs_for(rows, place, tmp_path / "clips"), workers=1)
    assert [outcome.state for outcome in outcomes] == ["built", "built"]
    store = ClipStore(tmp_path / "clips")
    assert [clip.clip_id for clip in store.clips()] == [row.clip_id for row in rows]
    for clip, row in zip(store.clips(), rows, strict=True):
        assert (clip.kind, clip.origin, clip.split, clip.scene_id) == ("GT", row.origin, row.split, row.scene_id)
        assert (clip.category, clip.factors, clip.name) == (row.category, row.factors, row.name)
        assert clip.sample_t0_us == row.sample_t0_us
    assert [window for _, window, _ in dataset.opened] == [(0, 2_900_000), (4_200_000, 7_100_000)]
    t0_us = store.clips()[0].sample_t0_us[-1]
    sample = store.load_sample(SampleKey(str(store.root), rows[0].clip_id, t0_us))
    np.testing.assert_allclose(sample.ego_future_xyz[0, -1], [32.0, 0.0, 0.0], atol=1e-3)


def test_what_is_built_is_not_built_again(open_toy, tmp_path):
    place, dataset = open_toy(ToyDataset({"a": SURROUND}))
    jobs = jobs_for(rows_of(SURROUND), place, tmp_path / "clips")
    build_clips(jobs[:1], workers=1)
    assert [outcome.state for outcome in build_clips(jobs, workers=1)] == ["found", "built"]
    assert len(dataset.opened) == 2


def test_windows_that_fail_are_told_or_stop_everything(open_toy, tmp_path):
    front = replace(SURROUND, key="b", scene_id="toy/b", true_views=(FRONT_WIDE,))
    place, _ = open_toy(ToyDataset({"a": SURROUND, "b": front}))
    rows = [*rows_of(SURROUND)[:1], replace(rows_of(front)[0], kind="GT")]
    jobs = jobs_for(rows, place, tmp_path / "clips", keep_going=True)
    outcomes = build_clips(jobs, workers=1)
    assert [outcome.state for outcome in outcomes] == ["built", "failed"]
    assert "no true images of" in outcomes[1].message
    assert len(ClipStore(tmp_path / "clips").clips()) == 1
    with pytest.raises(InputError, match="no true images of"):
        build_clips([replace(job, keep_going=False) for job in jobs], workers=1)


def test_another_data_set_is_refused(open_toy, tmp_path):
    place, _ = open_toy(ToyDataset({"a": SURROUND}))
    (job, *_) = jobs_for(rows_of(replace(SURROUND, source="other")), place, tmp_path / "clips")
    with pytest.raises(InputError, match=r"holds data of toy, but the clip 'a_000000_002900' is of other"):
        build_clips([job], workers=1)


def test_rows_of_which_a_clip_can_be_made():
    surround, front = rows_of(SURROUND), rows_of(make_drive("b", split="val"))
    assert find_buildable([*surround, *front], BuiltKind.GT) == surround
    assert find_buildable([*surround, *front], BuiltKind.SYN) == [*surround, *front]
    with pytest.raises(InputError, match="none of which has true views"):
        find_buildable(front, BuiltKind.GT)
    with pytest.raises(InputError, match="2 clips are in no split, as 'c_000000_002900'"):
        find_buildable([*surround, *rows_of(make_drive("c"))], BuiltKind.SYN)


@pytest.mark.slow
def test_a_real_drive_becomes_syn_clips(shared_real, tmp_path):
    place = DatasetPlace(shared_real, tmp_path / "cache", "kitti_raw")
    table = tmp_path / "kitti.parquet"
    index_dataset(place, table, Cutting(frames=30, stride=60), workers=1)
    split_table(table, Splitting(SplitRule.SEEN, test=0.4), table)
    rows = find_buildable(read_clip_table(table), BuiltKind.SYN)
    jobs = jobs_for(rows, place, tmp_path / "clips", BuiltKind.SYN, options=BuildOptions(width=128, height=72))
    build_clips(jobs, workers=2)
    clips = sorted(ClipStore(tmp_path / "clips").clips(), key=lambda clip: clip.origin.start_us)
    assert [(clip.kind, clip.split) for clip in clips] == [("Syn", "train"), ("Syn", "test")]
    assert {clip.origin.licence for clip in clips} == {rows[0].origin.licence}
    assert clips[0].sample_t0_us == min(rows, key=lambda row: row.origin.start_us).sample_t0_us
    assert clips[0].views[CROSS_LEFT].kind == "warped"


class JumpingDataset(ToyDataset):
    """Its vehicle jumps to the side by 3 m in the middle of the window."""

    def open(self, key, window_us, options):
        recording = super().open(key, window_us, options)
        poses = recording.reference.T_world_rig.copy()
        poses[(recording.reference.timestamps_us > 1_500_000), 1, 3] += 3.0
        return replace(recording, reference=Trajectory(recording.reference.timestamps_us, poses))


def test_a_clip_that_fails_a_check_is_not_kept_unless_nobody_looks(open_toy, tmp_path):
    place, _ = open_toy(JumpingDataset({"a": SURROUND}))
    jobs = jobs_for(rows_of(SURROUND)[:1], place, tmp_path / "clips")
    with pytest.raises(InputError, match=r"failed .* checks: .*jerk.*egomotion.*--no-verify"):
        build_clips(jobs, workers=1)
    assert not ClipStore(tmp_path / "clips").is_prepared(jobs[0].clip_id)
    (outcome,) = build_clips([replace(jobs[0], keep_going=True)], workers=1)
    assert outcome.state == "failed" and "jerk" in outcome.message
    (outcome,) = build_clips([replace(jobs[0], verify=False)], workers=1)
    assert outcome.state == "built" and outcome.summary["verification"] is None


def test_what_an_earlier_run_prepared_without_looking_is_looked_at(open_toy, tmp_path):
    place, _ = open_toy(JumpingDataset({"a": SURROUND}))
    (job,) = jobs_for(rows_of(SURROUND)[:1], place, tmp_path / "clips")
    assert replace(job, verify=False).run().state == "built"
    with pytest.raises(InputError, match="--no-verify"):
        build_clips([job], workers=1)
