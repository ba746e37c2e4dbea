"""Frames that repeat others, told from a vehicle that stands."""

import cv2
import numpy as np
import pytest

from olt_generator.decoding.repeated_frames import Freeze, find_repeated_frames
from olt_generator.video import read_video

from .mp4_boxes import write_frames

RATE = 25
HEIGHT, WIDTH = 120, 208


def road(position):
    """What a camera shows after so many steps: a textured picture that grows from its middle."""
    rng = np.random.default_rng(0)
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (2 * HEIGHT, 2 * WIDTH)).astype(np.float32), (0, 0), 2.0)
    texture = np.clip((texture - texture.mean()) * 4.0 + 128.0, 0, 255)
    zoom = 1.02**position
    warp = np.array([[zoom, 0.0, WIDTH / 2 - zoom * WIDTH], [0.0, zoom, HEIGHT / 2 - zoom * HEIGHT]])
    image = cv2.warpAffine(texture, warp, (WIDTH, HEIGHT), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    return np.repeat(image[..., None], 3, axis=2).astype(np.uint8)


def drive(steps, noise=0.0):
    """Pictures after each of so many steps forward."""
    rng = np.random.default_rng(1)
    frames = [road(position) for position in np.cumsum(steps)]
    return np.stack([np.clip(frame + rng.normal(0.0, noise, frame.shape), 0, 255).astype(np.uint8) for frame in frames])


def times(frames, rate=RATE):
    return np.rint(np.arange(len(frames)) * 1e6 / rate).astype(np.int64)


def recode(tmp_path, frames, crf):
    """The pictures after they were coded again, with B-frames."""
    options = {"crf": str(crf), "preset": "medium"}
    return read_video(write_frames(tmp_path / "video.mp4", frames, key_every=25, **options)).frames


PATTERNS = {"25 to 50": (2,), "24 to 60": (2, 3), "25 to 30": (1, 1, 1, 1, 2), "10 to 30": (3,), "15 to 60": (4,)}


@pytest.mark.parametrize("crf", [None, 18, 26])
@pytest.mark.parametrize("showings", PATTERNS.values(), ids=PATTERNS.keys())
def test_frames_that_pad_to_another_rate_are_found(tmp_path, showings, crf):
    pictures = drive(np.ones(40), noise=1.0)
    counts = np.resize(showings, len(pictures))
    frames = np.repeat(pictures, counts, axis=0)
    if crf is not None:
        frames = recode(tmp_path, frames, crf)
    found = find_repeated_frames(frames, times(frames, 50))
    expected = np.ones(len(frames), bool)
    expected[np.cumsum(counts) - counts] = False
    assert np.array_equal(found.repeats, expected)
    assert found.freezes == ()
    assert sorted(found.showings) == sorted(showings)


@pytest.mark.parametrize("noise", [0.0, 2.0, 8.0])
@pytest.mark.parametrize("crf", [None, 26])
def test_a_vehicle_that_brakes_stands_and_sets_off_repeats_nothing(tmp_path, noise, crf):
    braking = np.linspace(1.0, 0.0, 2 * RATE)
    frames = drive(np.concatenate([np.ones(10), braking, np.zeros(RATE), braking[::-1], np.ones(10)]), noise)
    if crf is not None:
        frames = recode(tmp_path, frames, crf)
    found = find_repeated_frames(frames, times(frames))
    assert found.freezes == ()
    assert found.repeats.mean() <= 0.02
    assert found.showings is None


@pytest.mark.parametrize("crf", [None, 26])
@pytest.mark.parametrize("lost", [True, False])
def test_a_picture_that_freezes_while_the_vehicle_drives_is_found(tmp_path, lost, crf):
    pictures = drive(np.ones(80), noise=1.0)
    after = 60 if lost else 40
    frames = np.concatenate([pictures[:40], np.repeat(pictures[39:40], 20, axis=0), pictures[after:]])
    if crf is not None:
        frames = recode(tmp_path, frames, crf)
    found = find_repeated_frames(frames, times(frames))
    assert found.freezes == (Freeze(39, 59),)
    assert np.flatnonzero(found.repeats).tolist() == list(range(40, 60))


def test_a_picture_that_is_held_at_an_end_is_found():
    pictures = drive(np.ones(40), noise=1.0)
    held = np.concatenate([np.repeat(pictures[:1], 20, axis=0), pictures, np.repeat(pictures[-1:], 20, axis=0)])
    assert find_repeated_frames(held, times(held)).freezes == (Freeze(0, 20), Freeze(59, 79))


def test_a_wiper_before_a_standing_vehicle_is_no_motion():
    frames = drive(np.zeros(60), noise=1.0)
    for number in range(0, 60, 4):
        frames[number : number + 2, :, 40 + 2 * number : 60 + 2 * number] = 10
    assert not find_repeated_frames(frames, times(frames)).repeats.any()


def test_two_frames_say_nothing():
    frames = drive([0.0, 0.0])
    assert not find_repeated_frames(frames, times(frames)).repeats.any()
