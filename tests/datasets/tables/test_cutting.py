"""Windows of drives, their sample times, and ids that are theirs everywhere."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_datasets.tables.choices import SampleChoice
from olt_datasets.tables.cutting import Cutting, cut_drive, find_samples, find_windows
from olt_generator.errors import InputError
from olt_toolkit.recordings.labels import UNLABELLED
from olt_toolkit.rigs.contracts import find_contract
from olt_toolkit.rigs.rig import CAMERA_INDEX, POLICY_CAMERAS

from ..toy_drives import make_drive


def spans(drive, **cutting):
    return [(start / 1e6, end / 1e6) for start, end in find_windows(drive, Cutting(**cutting))]


def test_windows_of_the_paper_are_41_images_that_do_not_touch():
    drive = make_drive(images=125)
    assert spans(drive) == [(0.0, 4.0), (4.2, 8.2), (8.4, 12.4)]
    assert spans(make_drive(images=124)) == [(0.0, 4.0), (4.2, 8.2)]
    assert spans(make_drive(images=40)) == spans(make_drive(images=0)) == []
    assert spans(drive, frames=100, stride=10) == [(0.0, 9.9), (1.0, 10.9), (2.0, 11.9)]


def test_windows_of_a_duration_follow_one_another():
    assert spans(make_drive(images=200), seconds=10.0) == [(0.0, 9.9), (10.0, 19.9)]
    assert spans(make_drive(images=199), seconds=10.0) == [(0.0, 9.9)]
    assert spans(make_drive(images=0), seconds=1.0) == []


@given(
    steps=st.lists(st.integers(10_000, 400_000), min_size=1, max_size=80),
    frames=st.integers(2, 12),
    stride=st.integers(1, 15),
    seconds=st.floats(0.5, 4.0),
)
def test_windows_hold_what_they_say(steps, frames, stride, seconds):
    drive = replace(make_drive(), front_us=np.concatenate([[0], np.cumsum(steps)]))
    by_frames = list(find_windows(drive, Cutting(frames, stride)))
    assert all(np.sum((drive.front_us >= start) & (drive.front_us <= end)) == frames for start, end in by_frames)
    by_time = list(find_windows(drive, Cutting(seconds=seconds)))
    assert all(end - start < 1e6 * seconds for start, end in by_time)
    assert all(before[1] < after[0] for before, after in pairwise(by_time))


@pytest.mark.parametrize("cutting", [{"frames": 1}, {"stride": 0}, {"seconds": 0.0}])
def test_windows_that_are_none_are_refused(cutting):
    with pytest.raises(InputError, match="windows of"):
        Cutting(**cutting)


def test_motion_that_was_measured_counts_beyond_the_window_and_other_motion_does_not():
    drive, window = make_drive(images=200), (2_000_000, 6_000_000)
    times, reason = find_samples(drive, window, SampleChoice.EVERY)
    assert (times[0], times[-1], reason) == (1_700_000, 4_000_000, None)
    times, reason = find_samples(replace(drive, ego_span_us=None), window, SampleChoice.EVERY)
    assert times == ()
    assert "ego motion covers 0 s to 4 s" in reason
    times, _ = find_samples(replace(drive, ego_span_us=None), (0, 19_900_000), SampleChoice.EVERY)
    assert (times[0], times[-1]) == (1_700_000, 13_500_000)


def test_41_images_at_30_a_second_give_no_sample_and_say_so():
    (clip, *_) = cut_drive(make_drive(images=600, rate=30.0), Cutting(), None)
    assert clip.sample_t0_us == ()
    assert "at most 1.33333 s" in clip.no_sample_reason


def test_only_what_may_be_imitated_is_sampled():
    drive, window = make_drive(images=200), (0, 19_900_000)
    times, _ = find_samples(replace(drive, usable_us=(0, 9_000_000)), window, SampleChoice.EVERY)
    assert (times[0], times[-1]) == (1_700_000, 2_600_000)
    times, _ = find_samples(replace(drive, usable_us=(5_000_000, 19_900_000)), window, SampleChoice.EVERY)
    assert (times[0], times[-1]) == (6_500_000, 13_500_000)
    times, reason = find_samples(replace(drive, usable_us=(0, 7_000_000)), window, SampleChoice.EVERY)
    assert times == ()
    assert "only 0 to 7 s of it may be imitated" in reason


def test_the_keyframe_is_the_moment_nearest_to_5_1_seconds():
    drive = make_drive(images=200)
    assert find_samples(drive, (0, 19_900_000), SampleChoice.KEYFRAME)[0] == (5_100_000,)
    assert find_samples(drive, (2_000_000, 6_000_000), SampleChoice.KEYFRAME)[0] == (4_000_000,)


def test_events_are_sampled_in_the_window_that_they_are_in():
    drive = make_drive(images=200, event_t0s_us=(3_012_000, 7_460_000, 7_470_000, 19_000_000))
    assert find_samples(drive, (0, 9_900_000), SampleChoice.EVENTS)[0] == (3_000_000, 7_500_000)
    assert find_samples(drive, (1_000_000, 9_900_000), SampleChoice.EVENTS)[0] == (2_000_000, 6_500_000)
    times, reason = find_samples(drive, (10_000_000, 19_900_000), SampleChoice.EVENTS)
    assert times == ()
    assert "marks 4 moments" in reason


def test_rows_say_what_the_data_set_says():
    drive = make_drive("day/one", images=200, category="cyclists", factors=("rain",), split="val")
    first, second, *_ = cut_drive(drive, Cutting(frames=80, stride=100), "CC0")
    assert (first.name, second.name) == ("day-one_000000_007900", "day-one_010000_017900")
    assert (first.kind, first.split, first.category, first.factors) == ("front_only", "val", "cyclists", ("rain",))
    assert vars(second.origin) == {
        "recording": "day/one",
        "start_us": 10_000_000,
        "end_us": 17_900_000,
        "country": "DE",
        "licence": "CC0",
    }
    plain = make_drive()
    (clip, *_) = cut_drive(plain, Cutting(), None)
    assert (clip.split, clip.category) == (None, UNLABELLED)
    surround = replace(plain, true_views=POLICY_CAMERAS)
    assert cut_drive(surround, Cutting(), None)[0].kind == "GT"
    six = Cutting(contract=find_contract("alpamayo-2"))
    assert cut_drive(surround, six, None)[0].kind == "front_only"
    assert cut_drive(replace(plain, true_views=tuple(CAMERA_INDEX)), six, None)[0].kind == "GT"


def test_ids_are_told_by_the_window_and_checksums_by_everything_told():
    drive = make_drive(images=200)
    clips = cut_drive(drive, Cutting(), "CC0")
    again = cut_drive(make_drive(images=200), Cutting(), "CC0")
    assert clips == again
    assert len({clip.clip_id for clip in clips}) == len({clip.checksum for clip in clips}) == len(clips)
    changes = (
        cut_drive(replace(drive, notes=("The camera was exchanged.",)), Cutting(), "CC0"),
        cut_drive(replace(drive, front_us=drive.front_us + (drive.front_us > 15_000_000)), Cutting(), "CC0"),
        cut_drive(drive, Cutting(samples=SampleChoice.KEYFRAME), "CC0"),
    )
    for changed in changes:
        assert changed[0].clip_id == clips[0].clip_id
        assert changed[0].checksum != clips[0].checksum


def test_clips_are_told_apart_by_scene_and_take_and_not_by_key_or_name():
    here = make_drive(".", images=100)
    others = [replace(here, scene_id="toy/elsewhere"), replace(here, take="night")]
    ids = [cut_drive(drive, Cutting(), None)[0].clip_id for drive in (here, *others)]
    assert len(set(ids)) == 3
    (moved, *_) = cut_drive(replace(here, key="day/1"), Cutting(), None)
    (named, *_) = cut_drive(here, Cutting(), None, name="town")
    assert moved.clip_id == named.clip_id == ids[0]
    assert moved.checksum == named.checksum
    assert (moved.name, named.name) == ("day-1_000000_004000", "town_000000_004000")
