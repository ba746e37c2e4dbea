import cv2
import numpy as np
import pytest
from PIL import Image, ImageSequence

from olt_generator.views.pixel_origin import PixelOrigin
from olt_toolkit.clips.pictures import (
    INVENTED_TINT,
    UNSEEN_LINES,
    contact_sheet,
    hatch,
    preview,
    tint_invented,
    write_animation,
    write_clip_pictures,
    write_picture,
)
from olt_toolkit.rigs.rig import CROSS_LEFT, CROSS_RIGHT, FRONT_TELE, FRONT_WIDE

GREY = np.full((6, 20, 40, 3), 100, np.uint8)
TIMES_US = 100_000 * np.arange(6)


def test_only_invented_pixels_are_tinted():
    origin = np.full((20, 40), PixelOrigin.SAME_FRAME, np.uint8)
    origin[:, :10], origin[:, 10:20] = PixelOrigin.INVENTED, PixelOrigin.OTHER_FRAME
    tinted = tint_invented(GREY[0], origin)
    np.testing.assert_array_equal(tinted[:, 10:], 100)
    assert (np.sign(tinted[:, :10].astype(int) - 100) == np.sign(np.array(INVENTED_TINT) - 100)).all()


def test_what_is_invented_or_not_seen_is_hatched_and_can_still_be_looked_at():
    origin = np.full((20, 40), PixelOrigin.SAME_FRAME, np.uint8)
    origin[:, :10], origin[:, 30:] = PixelOrigin.INVENTED, PixelOrigin.UNSEEN
    marked = hatch(GREY[0], origin)
    np.testing.assert_array_equal(marked[:, 10:30], 100)
    for part, colour in ((marked[:, :10], INVENTED_TINT), (marked[:, 30:], UNSEEN_LINES)):
        lines = (part == colour).all(axis=-1)
        assert 0.05 < lines.mean() < 0.3
        np.testing.assert_array_equal(part[~lines], 100)


def test_sheet_has_a_row_for_each_view_and_a_column_for_each_time():
    origins = {"b": np.full((6, 20, 40), PixelOrigin.INVENTED, np.uint8)}
    sheet = contact_sheet({"a": GREY, "b": GREY}, origins, TIMES_US, columns=3, tile_width=80)
    assert sheet.dtype == np.uint8
    assert sheet.shape[1:] == (240, 3)
    only_a = contact_sheet({"a": GREY}, {}, TIMES_US, columns=3, tile_width=80)
    assert sheet.shape[0] > only_a.shape[0]
    np.testing.assert_array_equal(sheet[: only_a.shape[0]], only_a)
    assert not (only_a[..., 0] != only_a[..., 1]).any()
    assert (sheet[only_a.shape[0] :, :, 0] != sheet[only_a.shape[0] :, :, 1]).any()


def test_first_and_last_time_are_shown():
    frames = GREY.copy()
    frames[0], frames[-1] = 10, 200
    sheet = contact_sheet({"a": frames}, {}, TIMES_US, columns=2, tile_width=40)
    assert (sheet[-10, 5] == 10).all()
    assert (sheet[-10, 45] == 200).all()


def test_a_picture_is_written_in_rgb(tmp_path):
    red = np.zeros((4, 4, 3), np.uint8)
    red[..., 0] = 255
    write_picture(tmp_path / "previews" / "red.png", red)
    written = np.asarray(cv2.imread(str(tmp_path / "previews" / "red.png")))
    np.testing.assert_array_equal(written[0, 0], [0, 0, 255])


def test_preview_puts_views_where_their_cameras_look_at_the_speed_of_the_clip():
    times_us = 100_000 * np.arange(21)
    images = {
        name: np.full((21, 20, 40, 3), level, np.uint8)
        for name, level in ((FRONT_WIDE, 100), (CROSS_LEFT, 50), (CROSS_RIGHT, 150), (FRONT_TELE, 200))
    }
    frames, rate = preview(images, {}, times_us, tile_width=40)
    assert rate == pytest.approx(5.0, rel=0.1)
    assert (len(frames) - 1) / rate == pytest.approx(2.0)
    height = frames.shape[1] // 2
    upper, lower = frames[0, height - 5], frames[0, -5]
    assert [int(upper[place, 0]) for place in (10, 50, 90)] == [50, 100, 150]
    assert [int(lower[place, 0]) for place in (10, 50, 110)] == [0, 200, 0]


def test_preview_shows_what_is_invented():
    origins = {FRONT_WIDE: np.full((6, 20, 40), PixelOrigin.INVENTED, np.uint8)}
    plain, marked = (preview({FRONT_WIDE: GREY}, each, TIMES_US)[0] for each in ({}, origins))
    assert plain.shape == marked.shape
    assert (plain != marked).any()


def test_preview_of_one_frame(tmp_path):
    frames, rate = preview({FRONT_WIDE: GREY[:1]}, {}, TIMES_US[:1])
    assert len(frames) == 1
    write_animation(tmp_path / "one.webp", frames, rate)
    assert Image.open(tmp_path / "one.webp").size == frames.shape[2:0:-1]


@pytest.mark.parametrize("suffix", ["webp", "gif"])
def test_an_animation_keeps_frames_order_and_duration(tmp_path, suffix):
    frames = np.stack([np.full((16, 24, 3), level, np.uint8) for level in (0, 120, 240)])
    path = tmp_path / f"moving.{suffix}"
    write_animation(path, frames, 5.0)
    with Image.open(path) as animation:
        shown = [
            (np.asarray(frame.convert("RGB")), frame.info["duration"]) for frame in ImageSequence.Iterator(animation)
        ]
    assert [duration for _, duration in shown] == [200, 200, 200]
    for (frame, _), level in zip(shown, (0, 120, 240), strict=True):
        np.testing.assert_allclose(frame, level, atol=3)
    first = path.read_bytes()
    write_animation(path, frames, 5.0)
    assert path.read_bytes() == first


def test_contact_sheet_and_preview_of_a_clip(tmp_path):
    pictures = write_clip_pictures(tmp_path, "drive", {FRONT_WIDE: GREY}, {}, TIMES_US)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["drive.png", "drive.webp"]
    assert pictures == {"contact_sheet": str(tmp_path / "drive.png"), "animation": str(tmp_path / "drive.webp")}
