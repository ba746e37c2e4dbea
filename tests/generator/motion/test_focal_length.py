"""Field of view from video: found where the vehicle turns, refused with a reason where it does not."""

import numpy as np
import pytest

from olt_datasets.sources.video import assume_camera, describe_lens, find_field_of_view
from olt_generator.motion.focal_length import estimate_field_of_view
from olt_generator.poses import camera_pose_in_rig, planar_pose
from olt_generator.seeds import make_generator
from olt_toolkit import OpenOptions, open_recording
from olt_toolkit.benchmarks.street import render_street

FRAME_US = 100_000


def film(field_of_view, frames, swerve, size=(320, 180)):
    """A drive through the made-up street at 7 m/s; the heading swings by `swerve` degrees and the body sways."""
    camera = assume_camera(*size, float(np.radians(field_of_view)))
    random = make_generator("film", field_of_view)
    yaw = np.radians(swerve) * np.sin(2.0 * np.pi * np.arange(frames) * 0.1 / 3.0)
    x, y = np.cumsum(0.7 * np.cos(yaw)) - 25.0, np.cumsum(0.7 * np.sin(yaw))
    pitch = np.radians(1.0) + np.radians(0.3) * np.convolve(random.normal(size=frames + 4), np.full(5, 0.2), "valid")
    images = []
    for index in range(frames):
        mounting = camera_pose_in_rig([1.7, 0.0, 1.5], 0.0, pitch[index], 0.0)
        image, _ = render_street(camera, planar_pose(x[index], y[index], yaw[index]) @ mounting)
        images.append(np.clip(image + random.normal(0.0, 2.0, image.shape), 0, 255).astype(np.uint8))
    return np.stack(images), np.arange(frames, dtype=np.int64) * FRAME_US


def test_a_straight_drive_tells_nothing_and_says_so():
    frames, timestamps_us = film(70.0, 9, 0.0, (160, 90))
    estimate = estimate_field_of_view(frames, timestamps_us, assume_camera)
    assert estimate.field_of_view is None and estimate.interval is None
    assert "only 0 windows" in estimate.reason


@pytest.mark.parametrize("value", [0, 255])
def test_video_without_anything_to_see_tells_nothing(value):
    frames = np.full((12, 48, 64, 3), value, np.uint8)
    estimate = estimate_field_of_view(frames, np.arange(12) * FRAME_US, assume_camera)
    assert estimate.field_of_view is None and estimate.windows == 0


def test_what_is_given_is_taken_and_what_is_not_known_is_assumed_in_words():
    frames = np.zeros((3, 48, 64, 3), np.uint8)
    given = describe_lens(float(np.radians(93.0)), "as given")
    assert given.field_of_view == float(np.radians(93.0)) and "93 degrees (as given)" in given.sentence
    assumed = find_field_of_view(frames, np.arange(3) * FRAME_US)
    assert np.degrees(assumed.field_of_view) == pytest.approx(70.0)
    assert "the default for dashcams; the video does not tell: only 0 windows" in assumed.sentence


def test_a_turning_drive_tells_the_field_of_view():
    frames, timestamps_us = film(70.0, 25, 12.0)
    lens = find_field_of_view(frames, timestamps_us)
    print(lens.sentence)
    assert np.degrees(lens.field_of_view) == pytest.approx(70.0, rel=0.1)
    assert "estimated from the turns in the video" in lens.sentence


@pytest.mark.slow
@pytest.mark.parametrize("field_of_view", [50.0, 70.0, 90.0, 120.0])
def test_longer_drives_of_every_lens(field_of_view):
    frames, timestamps_us = film(field_of_view, 60, 12.0, (480, 270))
    estimate = estimate_field_of_view(frames, timestamps_us, assume_camera)
    print(field_of_view, estimate)
    assert estimate.field_of_view is not None and estimate.interval is not None
    assert np.degrees(estimate.field_of_view) == pytest.approx(field_of_view, rel=0.07)
    assert estimate.interval[0] < np.radians(field_of_view) < estimate.interval[1]


@pytest.mark.slow
def test_the_kitti_drive_is_too_straight(shared_real):
    """It bends by at most 1.3 degrees in half a second: nothing is made up from that."""
    recording = open_recording(shared_real / "kitti_raw_2011_09_26_drive_0013", OpenOptions())
    estimate = estimate_field_of_view(recording.frames, recording.timestamps_us, assume_camera)
    print(estimate)
    assert estimate.field_of_view is None and estimate.reason
