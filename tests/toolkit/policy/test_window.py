import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from olt_generator.errors import InputError
from olt_toolkit.policy.window import (
    FUTURE_OFFSETS_US,
    HISTORY_OFFSETS_US,
    IMAGE_OFFSETS_US,
    Coverage,
    check_sample_window,
    frames_per_step,
    grid_frame_indices,
    sample_times,
    sampled_frame_indices,
)
from olt_toolkit.rigs.rig import POLICY_CAMERAS

SECOND = 1_000_000


def covered(ego, camera):
    return Coverage(ego, dict.fromkeys(POLICY_CAMERAS, camera))


def accepts(t0_us, coverage):
    try:
        check_sample_window(t0_us, coverage, "clip")
    except InputError:
        return False
    return True


spans = st.tuples(st.integers(-SECOND, 4 * SECOND), st.integers(5 * SECOND, 14 * SECOND))


@given(spans, spans, st.integers(0, 140))
def test_sample_times_are_exactly_the_grid_times_that_pass_the_check(ego, camera, step):
    coverage = covered(ego, camera)
    times, reason = sample_times(coverage)
    t0_us = step * 100_000
    assert accepts(t0_us, coverage) == (t0_us in times)
    assert (reason is None) == bool(times)


@given(spans, spans, st.integers(0, 14 * SECOND))
def test_window_is_the_one_of_the_public_loader(ego, camera, t0_us):
    expected = (
        t0_us > 1_600_000
        and ego[0] <= t0_us - 1_500_000
        and t0_us + 6_400_000 <= ego[1]
        and camera[0] <= t0_us - 300_000
        and t0_us <= camera[1]
    )
    assert accepts(t0_us, covered(ego, camera)) == expected


# Ends of spans on the grid of 0.1 s and a microsecond beside it, where one step more or less shows.
edges = st.tuples(st.integers(-10, 40), st.integers(50, 140), st.integers(-1, 1), st.integers(-1, 1)).map(
    lambda edge: (100_000 * edge[0] + edge[2], 100_000 * edge[1] + edge[3])
)


@given(edges, st.tuples(*[edges] * 4))
@example((1_000_000, 20_000_000), ((2_000_000, 14_000_000),) * 4)  # images come last
@example((1_000_000, 9_000_000), ((0, 14_000_000),) * 4)  # the history begins last, the future ends first
@example((0, 20_000_000), ((0, 14_000_000), (0, 5_000_000), (0, 14_000_000), (0, 14_000_000)))
def test_a_sample_time_is_one_at_which_everything_is_there(ego, cameras):
    coverage = Coverage(ego, dict(zip(POLICY_CAMERAS, cameras, strict=True)))
    expected = [
        t0_us
        for t0_us in range(0, 14_100_000, 100_000)
        if t0_us > 1_600_000
        and ego[0] <= t0_us - 1_500_000
        and t0_us + 6_400_000 <= ego[1]
        and all(first <= t0_us - 300_000 and t0_us <= last for first, last in cameras)
    ]
    assert list(sample_times(coverage)[0]) == expected
    assert [t0_us for t0_us in range(0, 14_100_000, 100_000) if accepts(t0_us, coverage)] == expected


def test_offsets_of_poses_and_images():
    assert HISTORY_OFFSETS_US.tolist() == list(range(-1_500_000, 1, 100_000))
    assert FUTURE_OFFSETS_US.tolist() == list(range(100_000, 6_400_001, 100_000))
    assert IMAGE_OFFSETS_US.tolist() == [-300_000, -200_000, -100_000, 0]


@pytest.mark.parametrize(
    ("frame_rate", "expected"),
    [(30.0, 3), (60.0, 6), (20.0, 2), (10.0, 1), (5.0, 1), (25.0, 1), (29.97, 1), (30.000005, 3), (30.000012, 1)],
)
def test_frames_of_a_step_are_a_whole_number_or_one(frame_rate, expected):
    assert frames_per_step(frame_rate) == expected


def test_exactly_the_refused_second_is_refused():
    coverage = covered((0, 20 * SECOND), (0, 20 * SECOND))
    assert not accepts(1_600_000, coverage)
    assert accepts(1_600_001, coverage)
    assert sample_times(coverage)[0][0] == 1_700_000


def test_errors_name_field_camera_and_times():
    with pytest.raises(InputError, match=r"clip 7: ego motion covers 0 s to 9 s, but t0 = 3 s needs 1.5 s to 9.4 s"):
        check_sample_window(3 * SECOND, covered((0, 9 * SECOND), (0, 9 * SECOND)), "clip 7")
    with pytest.raises(InputError, match=r"camera_cross_left_120fov covers 0 s to 2 s, but t0 = 2.1 s"):
        check_sample_window(2_100_000, covered((0, 9 * SECOND), (0, 2 * SECOND)), "clip 7")


def test_missing_camera_is_the_reason():
    times, reason = sample_times(Coverage((0, 20 * SECOND), {"camera_front_wide_120fov": (0, 20 * SECOND)}))
    assert times == ()
    assert "camera_cross_left_120fov" in reason


def test_short_motion_is_the_reason():
    times, reason = sample_times(covered((0, 8 * SECOND), (0, 8 * SECOND)))
    assert times == ()
    assert "6.4 s of future" in reason


@given(st.lists(st.integers(5_000, 250_000), min_size=20, max_size=200), st.integers(-50_000, 50_000))
def test_leaving_frames_out_changes_no_sample_on_the_grid(steps, start):
    every = start + np.cumsum(steps)
    kept = every[grid_frame_indices(every)]
    assert (kept[0], kept[-1]) == (every[0], every[-1])
    for t0_us in range(100_000 * -(-int(every[0] + 300_000) // 100_000), int(every[-1]) + 1, 100_000):
        times = t0_us + IMAGE_OFFSETS_US
        newest = [frames[np.searchsorted(frames, times, side="right") - 1].tolist() for frames in (every, kept)]
        assert newest[0] == newest[1]


def test_two_of_three_frames_at_30_hertz_are_left_out():
    assert len(grid_frame_indices(np.arange(300) * 1_000_000 // 30)) == 101


@given(st.lists(st.integers(5_000, 250_000), min_size=60, max_size=200))
def test_the_samples_of_a_clip_need_no_other_frames_than_those_sampled(steps):
    every = np.cumsum([0, *steps])
    kept = every[sampled_frame_indices(every)]
    ego = (int(every[0]), int(every[-1]))
    times, _ = sample_times(covered(ego, ego))
    assert sample_times(covered(ego, (int(kept[0]), int(kept[-1]))))[0] == times
    for t0_us in times:
        shown = t0_us + IMAGE_OFFSETS_US
        newest = [frames[np.searchsorted(frames, shown, side="right") - 1].tolist() for frames in (every, kept)]
        assert newest[0] == newest[1]


def test_what_is_too_early_or_lacks_a_future_is_not_sampled():
    assert sampled_frame_indices(np.arange(141) * 100_000).tolist() == list(range(14, 77))
    assert len(sampled_frame_indices(np.arange(50) * 100_000)) == 50
