"""What is said of a video whose pictures, times or lens could be read in more than one way."""

import cv2
import numpy as np
import pytest

from olt_datasets.sources import video
from olt_generator.camera_spread import Spread
from olt_generator.errors import InputError
from olt_generator.motion.focal_length import FieldOfViewEstimate
from olt_generator.video import write_video
from olt_toolkit import OpenOptions, open_recording
from olt_toolkit.recordings.drives import open_dataset

RATE = 25


def drive(count, size=(72, 128)):
    """Pictures (count, H, W, 3) of a textured ground that moves down by a pixel each, under a bright sky."""
    height, width = size
    texture = np.random.default_rng(0).uniform(0, 200, (height, width)).astype(np.float32)
    texture = cv2.GaussianBlur(texture, (0, 0), 1.5)
    frames = np.stack([np.roll(texture, number, axis=0) for number in range(count)])
    frames[:, : height // 2] = 235
    return np.repeat(frames[..., None], 3, axis=3).astype(np.uint8)


def write(path, frames, rate=RATE):
    write_video(path, frames, rate)
    return path


def test_repeated_frames_are_left_out_and_the_others_keep_their_times(tmp_path):
    frames = drive(25)
    recording = open_recording(write(tmp_path / "dash.mp4", np.repeat(frames, 2, axis=0), 2 * RATE))
    assert len(recording.frames) == 25
    assert recording.timestamps_us.tolist() == [40_000 * number for number in range(25)]
    assert np.abs(recording.frames.astype(int) - frames).mean() < 6.0
    assert any(
        "25 of 50 frames repeat the one before them (each picture is shown 2 times)" in sentence
        for sentence in recording.assumptions
    )
    assert recording.doubts == ()


def test_a_picture_that_is_held_for_long_while_driving_is_refused(tmp_path):
    frames = drive(60)
    held = np.concatenate([frames[:30], np.repeat(frames[29:30], 20, axis=0), frames[30:]])
    with pytest.raises(InputError, match=r"freezes from 1\.16 to 1\.96 s while the vehicle drives"):
        open_recording(write(tmp_path / "dash.mp4", held))


def test_a_picture_that_is_held_briefly_or_at_the_end_is_left_out_with_a_doubt(tmp_path):
    frames = drive(60)
    held = np.concatenate([frames[:30], np.repeat(frames[29:30], 9, axis=0), frames[30:]])
    recording = open_recording(write(tmp_path / "dash.mp4", held))
    assert len(recording.frames) == 60
    assert [doubt.what for doubt in recording.doubts] == ["frames"]
    ending = open_recording(write(tmp_path / "end.mp4", np.concatenate([frames, np.repeat(frames[-1:], 30, axis=0)])))
    assert len(ending.frames) == 60
    assert "freezes from 2.36 to 3.56 s" in ending.doubts[0].why


@pytest.mark.parametrize("rate", [0.5, 1.0, 1.9])
def test_frames_too_far_apart_are_refused_before_any_is_decoded(tmp_path, rate, monkeypatch):
    path = write(tmp_path / "lapse.mp4", drive(9), rate)
    assert len(open_dataset(path).drive(".").front_us) == 9
    monkeypatch.setattr(video, "read_video", lambda *_: pytest.fail("decoded"))
    with pytest.raises(InputError, match=rf"{1 / rate:.2f} s apart, the usual step is {1 / rate:.2f} s"):
        open_recording(path)


def test_two_frames_a_second_are_enough(tmp_path):
    assert len(open_recording(write(tmp_path / "slow.mp4", drive(6), 2.0)).frames) == 6


@pytest.mark.parametrize(("turn", "side"), [(2, "at the bottom"), (1, "on the left"), (3, "on the right")])
def test_a_sky_that_is_not_above_is_a_doubt_that_names_the_turn(tmp_path, turn, side):
    frames = np.rot90(drive(12), turn, axes=(1, 2))
    path = write(tmp_path / "dash.mp4", np.ascontiguousarray(frames))
    recording = open_recording(path, OpenOptions(horizontal_fov=1.0))
    (doubt,) = recording.doubts
    assert doubt.what == "view direction"
    assert side in doubt.why
    degrees = int(doubt.why.split("--rotate ")[1])
    upright = open_recording(path, OpenOptions(horizontal_fov=1.0, rotate=degrees))
    assert upright.doubts == ()
    assert upright.frames.shape[1:3] == (72, 128)
    assert any(f"turned clockwise by {degrees} degrees as asked for" in each for each in upright.assumptions)


def test_a_video_is_mirrored_on_request(tmp_path):
    path = write(tmp_path / "dash.mp4", drive(5))
    plain, mirrored = open_recording(path), open_recording(path, OpenOptions(mirror=True))
    assert np.array_equal(mirrored.frames, plain.frames[:, :, ::-1])
    assert any("mirrored left to right as asked for" in sentence for sentence in mirrored.assumptions)


def test_a_portrait_needs_its_field_of_view(tmp_path):
    path = write(tmp_path / "phone.mp4", drive(5, (128, 72)))
    with pytest.raises(InputError, match=r"phone\.mp4: the pictures are portraits \(72 x 128 pixels\).*--fov"):
        open_recording(path)
    given = open_recording(path, OpenOptions(horizontal_fov=np.radians(25.0)))
    edge = given.camera.rays(np.array([[-0.5, 63.5]]))[0]
    assert np.degrees(np.arcsin(-edge[0])) == pytest.approx(12.5, abs=0.01)


def test_how_well_lens_and_height_are_known_goes_by_where_they_come_from(tmp_path, monkeypatch):
    path = write(tmp_path / "dash.mp4", drive(5))
    assumed = open_recording(path).spread
    assert (assumed.focal_length.origin, assumed.height.origin) == ("assumed", "assumed")
    assert assumed.focal_length.relative >= 0.2
    given = open_recording(path, OpenOptions(horizontal_fov=1.2, camera_height=1.3)).spread
    assert (given.focal_length, given.height) == (Spread(0.03, "given"), Spread(0.02, "given"))
    found = FieldOfViewEstimate(np.radians(60.0), (np.radians(55.0), np.radians(65.0)), 9)
    monkeypatch.setattr("olt_datasets.sources.video_lens.estimate_field_of_view", lambda *_: found)
    estimated = open_recording(path, cache=tmp_path / "cache").spread.focal_length
    assert estimated.origin == "estimated"
    # A focal length goes by one over the tangent of half the angle.
    ratio = np.log(np.tan(np.radians(32.5)) / np.tan(np.radians(27.5)))
    assert estimated.relative == pytest.approx(ratio / 3.29, rel=1e-3)


def test_a_lens_that_was_found_keeps_its_spread_in_the_cache(tmp_path):
    path = write(tmp_path / "dash.mp4", drive(5))
    first = open_recording(path, cache=tmp_path / "cache")
    again = open_recording(path, cache=tmp_path / "cache")
    assert list((tmp_path / "cache" / "video").glob("lens-*.json"))
    assert (first.spread, first.assumptions) == (again.spread, again.assumptions)


@pytest.mark.parametrize("content", ["", "[]", "{", '{"field_of_view": 1.0}', "[" * 5000])
def test_a_damaged_lens_in_the_cache_is_told_by_its_file(tmp_path, content):
    path = write(tmp_path / "dash.mp4", drive(5))
    open_recording(path, cache=tmp_path / "cache")
    (kept,) = (tmp_path / "cache" / "video").glob("lens-*.json")
    for wrong in (content, kept.read_text().replace('"assumed"', '"guessed"').replace('"estimated"', '"guessed"')):
        kept.write_text(wrong)
        with pytest.raises(InputError, match=r"lens-.*\.json: "):
            open_recording(path, cache=tmp_path / "cache")
