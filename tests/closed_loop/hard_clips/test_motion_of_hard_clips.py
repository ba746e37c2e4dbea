"""The motion estimator on hard clips: right within what it states, or marked with a doubt that holds the reason."""

from dataclasses import replace
from functools import lru_cache

import pytest

from olt_closed_loop.benchmarks.motion_errors import ClipErrors, measure_motion
from olt_closed_loop.hard_clips.filming import make_clip
from olt_closed_loop.hard_clips.kinds import specify_clip
from olt_closed_loop.hard_clips.specification import ClipSpecification
from olt_generator.motion.odometry import Odometry, estimate_odometry
from olt_toolkit.recordings.recording import Recording

# Errors beyond so many stated standard deviations are wrong.
LIMIT = 4.0
FIRST_IS_FAST = [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)]


def follow(recording: Recording) -> Odometry:
    return estimate_odometry(recording.frames, recording.timestamps_us, recording.camera, recording.T_rig_camera)


def small(kind: str, number: int = 0, frames: int = 16, rate: float = 10.0) -> ClipSpecification:
    """A clip of a kind with few and small frames, filmed by the camera as it is stated."""
    clip = specify_clip(kind, number, 0)
    camera = replace(clip.camera, width=416, height=234, height_off=0.0, focal_off=0.0)
    return replace(clip, frames=frames, frame_rate=rate, camera=camera)


def measure(clip: ClipSpecification) -> ClipErrors:
    """The errors of a clip as it is filmed."""
    return measure_motion(make_clip(clip), clip.kind, follow)


def measure_followed(clip: ClipSpecification) -> tuple[ClipErrors, Odometry]:
    """The errors of a clip that is not refused, and its odometry."""
    recording = make_clip(clip)
    odometry = follow(recording)
    return measure_motion(recording, clip.kind, lambda _: odometry), odometry


def is_right(errors: ClipErrors) -> bool:
    """Whether all is within the limit."""
    return errors.refused is None and (errors.worst_z is None or errors.worst_z < LIMIT)


@pytest.mark.parametrize("number", FIRST_IS_FAST)
def test_between_traffic_on_both_sides_it_drives_forward(number: int) -> None:
    errors, odometry = measure_followed(small("traffic", number))
    assert is_right(errors) or errors.marked
    assert errors.reach_m is not None and odometry.trajectory.positions[-1, 0] > 0.7 * errors.reach_m


@pytest.mark.parametrize("number", FIRST_IS_FAST)
def test_it_stands_while_others_pass(number: int) -> None:
    errors, odometry = measure_followed(small("standstill", number))
    assert errors.ate_m is not None and errors.ate_m < 0.05
    assert odometry.standstill.mean() > 0.9
    assert odometry.doubts == ()


def test_it_reverses_at_the_speed_of_parking() -> None:
    errors, odometry = measure_followed(small("reverse"))
    assert odometry.trajectory.positions[-1, 0] < -0.5
    assert is_right(errors)
    assert odometry.doubts == ()


@pytest.mark.slow
@pytest.mark.parametrize("number", range(3))
def test_stop_and_go(number: int) -> None:
    errors, odometry = measure_followed(small("stop_and_go", number, frames=80, rate=15.0))
    assert is_right(errors)
    assert errors.ate_m is not None and errors.ate_m < 1.0
    assert odometry.standstill.any() and not odometry.standstill.all()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["night", "hills", "turn", "bonnet", "rain", "narrow_lens", "wide_lens"])
@pytest.mark.parametrize("number", range(2))
def test_it_is_right_or_says_that_it_may_not_be(kind: str, number: int) -> None:
    errors = measure(replace(specify_clip(kind, number, 0), frames=41))
    assert is_right(errors) or errors.marked or errors.refused


@lru_cache(maxsize=1)
def drive_by_day(frames: int = 16) -> Recording:
    clip = small("low_sun", frames=frames)
    ordinary = small("hills", frames=frames)
    course = replace(clip.course, times=(0.0, 10.0), speeds=(12.0, 12.0), bends=())
    return make_clip(replace(clip, course=course, conditions=ordinary.conditions, effects=ordinary.effects))


def test_an_ordinary_drive_is_right_and_not_doubted() -> None:
    recording = drive_by_day()
    odometry = follow(recording)
    assert odometry.doubts == ()
    assert is_right(measure_motion(recording, "ordinary", lambda _: odometry))


def test_a_camera_that_looks_back_is_doubted() -> None:
    """What it shows is what a front camera shows of the drive backwards in time."""
    recording = drive_by_day()
    odometry = follow(replace(recording, frames=recording.frames[::-1]))
    assert odometry.trajectory.positions[-1, 0] < 0.0
    assert [doubt.what for doubt in odometry.doubts] == ["view direction"]
    assert "looks back" in odometry.doubts[0].why
