import cv2
import numpy as np

from olt_toolkit.pictures import INVENTED_TINT, contact_sheet, tint_invented, write_picture

GREY = np.full((6, 20, 40, 3), 100, np.uint8)
TIMES_US = 100_000 * np.arange(6)


def test_only_invented_pixels_are_tinted():
    observed = np.ones((20, 40), bool)
    observed[:, :10] = False
    tinted = tint_invented(GREY[0], observed)
    np.testing.assert_array_equal(tinted[:, 10:], 100)
    assert (np.sign(tinted[0, 0].astype(int) - 100) == np.sign(np.array(INVENTED_TINT) - 100)).all()
    np.testing.assert_array_equal(tint_invented(GREY[0], None), GREY[0])


def test_sheet_has_a_row_for_each_view_and_a_column_for_each_time():
    observed = {"b": np.zeros((6, 20, 40), bool)}
    sheet = contact_sheet({"a": GREY, "b": GREY}, observed, TIMES_US, columns=3, tile_width=80)
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
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "previews" / "red.png"))[0, 0], [0, 0, 255])
