"""Each case of `cases/videos` against its `expected.txt`."""

import numpy as np
import pytest

from olt_generator.errors import InputError
from olt_generator.video import read_frame_times, read_video
from olt_toolkit import OpenOptions, open_recording
from olt_toolkit.clips.trajectory_errors import measure_clips
from olt_toolkit.recordings.drives import find_drives, list_left_out, open_dataset

ORIGINAL = "highway_solid_white_right_960x540_25fps.mp4"


@pytest.fixture
def cases(shared_real):
    folder = shared_real.parent / "cases" / "videos"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    return folder


@pytest.fixture
def original(shared_real):
    return read_video(shared_real / "dashcam_videos" / ORIGINAL, 960, 5.0).frames


def recover(path, **options):
    recording = open_recording(path, OpenOptions(**options))
    (motion,) = measure_clips(recording, None, None)
    return motion


def is_held(motion, metres):
    """Whether the length of the path is within what is stated of it, or the motion is marked."""
    error = np.log(motion.smoothed.trajectory.path_length / metres)
    print(f"{error:+.3f} of {motion.scale.total:.3f}: {motion.doubts}")
    return bool(motion.doubts) or abs(error) < 2.0 * motion.scale.total


def rms(first, second):
    return float(np.sqrt(np.mean((first.astype(float) - second.astype(float)) ** 2)))


def test_files_of_macos_beside_a_video(cases):
    folder = cases / "apple_double"
    assert open_dataset(folder).keys() == ["DSC0001.MP4"]
    assert [place.path.name for place, _ in find_drives(folder)] == ["DSC0001.MP4"]
    assert [(omission.why, omission.count) for omission in list_left_out(folder)] == [("hidden files", 1)]


def test_hlg_is_tone_mapped(cases, original):
    video = read_video(cases / "hlg_hdr" / "hlg.mov", 960)
    assert rms(video.frames, original[: len(video.frames)]) < 4.0
    # Means over 8 x 8 pixels, in which what coding lost hardly counts.
    blocks = [
        frames[:, :536].reshape(len(video.frames), 67, 8, 120, 8, 3).mean((2, 4))
        for frames in (video.frames, original[: len(video.frames)])
    ]
    assert rms(*blocks) < 3.0
    assert "tone-mapped to BT.709" in video.notes[0]


def test_one_frame_a_second(cases):
    path = cases / "low_rate_last_frame" / "one_fps.mp4"
    assert open_dataset(path).drive(".").front_us.tolist() == [1_000_000 * number for number in range(9)]
    with pytest.raises(InputError, match=r"1\.00 s apart"):
        open_recording(path)


def test_a_mirrored_display_matrix(cases, original):
    video = read_video(cases / "mirrored_display_matrix" / "hflip.mp4", 960)
    assert rms(video.frames[:20, :, ::-1], original[:20]) < 3.0


def test_pixels_that_are_not_square(cases, original):
    video = read_video(cases / "non_square_pixels" / "sar43.mp4", 960)
    assert video.frames.shape[1:] == (540, 960, 3)
    assert rms(video.frames[:20], original[:20]) < 6.0


def test_a_portrait(cases):
    path = cases / "portrait" / "portrait.mp4"
    with pytest.raises(InputError, match=r"portraits \(608 x 1080 pixels\)"):
        open_recording(path)
    given = open_recording(path, OpenOptions(horizontal_fov=np.radians(25.0)))
    assert given.spread.focal_length.origin == "given"


def test_a_rear_camera(cases):
    with pytest.raises(InputError, match="the camera looks back"):
        open_recording(cases / "rear_camera" / "rear.mp4")


@pytest.mark.parametrize(("name", "shown", "kept"), [("dup.mp4", 125, 63), ("dup6.mp4", 150, 125)])
def test_repeated_frames(cases, name, shown, kept):
    path = cases / "repeated_frames" / name
    assert len(read_frame_times(path)) == shown
    recording = open_recording(path, OpenOptions(duration=5.0))
    assert len(recording.frames) == kept
    assert set(recording.timestamps_us.tolist()) <= set(read_frame_times(path).tolist())
    assert any(f"{shown - kept} of {shown} frames repeat" in sentence for sentence in recording.assumptions)


def test_a_trim_without_coding_anew(cases):
    path = cases / "trimmed_edit_list" / "trimmed.mp4"
    # 94 frames by `ffprobe -count_frames`.
    assert len(read_frame_times(path)) == len(read_video(path, 160).frames) == 94


def test_upside_down(cases):
    path = cases / "upside_down" / "upside.mp4"
    (doubt,) = open_recording(path).doubts
    assert "the sky seems to be at the bottom" in doubt.why
    assert open_recording(path, OpenOptions(rotate=180)).doubts == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("path", "seconds", "metres"),
    [
        ("mirrored_display_matrix/hflip.mp4", 3.0, 70.0),
        ("non_square_pixels/sar43.mp4", 3.0, 70.0),
        ("repeated_frames/dup.mp4", 5.0, 114.0),
        ("repeated_frames/dup6.mp4", 5.0, 114.0),
    ],
)
def test_the_path_is_that_of_the_original(cases, path, seconds, metres):
    motion = recover(cases / path, duration=seconds)
    # The lengths are "about": no reference was recorded.
    assert motion.doubts or motion.smoothed.trajectory.path_length == pytest.approx(metres, rel=0.1)


@pytest.mark.slow
def test_a_camera_that_looks_back_under_another_name_is_doubted(cases, tmp_path):
    path = tmp_path / "drive.mp4"
    path.write_bytes((cases / "rear_camera" / "rear.mp4").read_bytes())
    try:
        motion = recover(path)
    except InputError as refusal:
        assert "looks back" in str(refusal)
        return
    assert "view direction" in {doubt.what for doubt in motion.doubts}
    assert motion.smoothed.trajectory.positions[-1, 0] < 0.0


@pytest.mark.slow
def test_motion_upside_down_is_doubted_by_reader_and_motion(cases):
    path = cases / "upside_down" / "upside.mp4"
    assert {"view direction", "upright"} <= {doubt.what for doubt in recover(path).doubts}
    turned = recover(path, rotate=180, duration=3.0)
    assert turned.doubts == ()
    assert turned.smoothed.trajectory.path_length == pytest.approx(70.0, rel=0.1)


@pytest.mark.slow
def test_a_portrait_goes_as_far_as_the_original(cases):
    assert is_held(recover(cases / "portrait" / "portrait.mp4", horizontal_fov=np.radians(25.0)), 70.0)


@pytest.mark.slow
def test_hlg_goes_as_far_as_the_original(cases):
    motion = recover(cases / "hlg_hdr" / "hlg.mov")
    assert motion.smoothed.trajectory.path_length == pytest.approx(25.0, rel=0.1)
