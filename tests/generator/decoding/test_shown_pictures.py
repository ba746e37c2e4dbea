"""Pictures as players show them: which way up, pixel aspect, colours, fields."""

from fractions import Fraction
from itertools import product

import av
import numpy as np
import pytest

from olt_generator.decoding.orientation import Orientation, turned
from olt_generator.errors import InputError
from olt_generator.video import read_frame_times, read_video, read_video_window

from .mp4_boxes import set_matrix, write_frames, write_greys

HLG, PQ, BT2020 = 18, 16, 9


def corner_frames(count=3, height=32, width=48):
    """A bright upper left corner, and a half-bright upper right one."""
    frame = np.full((height, width, 3), 30, np.uint8)
    frame[: height // 4, : width // 4] = 230
    frame[: height // 4, -width // 4 :] = 120
    return [frame] * count


MATRICES = [((a, 0), (0, d)) for a, d in product((1, -1), repeat=2)] + [
    ((0, b), (c, 0)) for b, c in product((1, -1), repeat=2)
]


@pytest.mark.parametrize("matrix", MATRICES, ids=str)
def test_each_of_the_eight_display_matrices_is_applied(tmp_path, matrix):
    path = write_frames(tmp_path / "video.mp4", corner_frames())
    stored = read_video(path).frames[0]
    shown = read_video(set_matrix(path, matrix)).frames[0]
    (a, b), (c, d) = matrix
    height, width = stored.shape[:2]
    rows, columns = np.mgrid[0:height, 0:width]
    x, y = a * columns + c * rows, b * columns + d * rows
    expected = np.empty_like(stored if a else stored.swapaxes(0, 1))
    expected[y - y.min(), x - x.min()] = stored
    assert np.array_equal(shown, expected)


def test_an_odd_angle_is_refused(tmp_path):
    path = write_greys(tmp_path / "video.mp4", 3)
    cos, sin = np.cos(np.radians(30.0)), np.sin(np.radians(30.0))
    set_matrix(path, ((cos, sin), (-sin, cos)))
    with pytest.raises(InputError, match=r"turned by 30\.0 degrees"):
        read_video(path)


@pytest.mark.parametrize(("clockwise", "mirror"), list(product((0, 90, 180, 270), (False, True))))
def test_what_the_user_asks_for_comes_after_what_the_file_says(tmp_path, clockwise, mirror):
    path = set_matrix(write_frames(tmp_path / "video.mp4", corner_frames()), ((-1, 0), (0, 1)))
    by_file = read_video(path).frames
    asked = read_video(path, turned=turned(clockwise, mirror)).frames
    expected = np.rot90(by_file, -clockwise // 90, axes=(1, 2))
    assert np.array_equal(asked, expected[:, :, ::-1] if mirror else expected)
    window = read_video_window(path, 0, 10**6, turned=turned(clockwise, mirror))
    assert np.array_equal(window.frames, asked)


def test_a_turn_by_45_degrees_is_refused():
    with pytest.raises(InputError, match="45 degrees"):
        turned(45, False)
    assert turned(0, False) == Orientation()


def write_squeezed(path, aspect):
    rows, columns = np.mgrid[0:48, 0:36]
    frame = np.repeat(np.where((columns // 9 + rows // 12) % 2, 200, 40)[..., None], 3, axis=2).astype(np.uint8)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = 36, 48, "yuv420p"
        stream.codec_context.sample_aspect_ratio = aspect
        for _ in range(30):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())
    return path


@pytest.mark.parametrize("suffix", ["mp4", "mkv", "ts"])
def test_pixels_that_are_not_square_are_stretched(tmp_path, suffix):
    path = write_squeezed(tmp_path / f"video.{suffix}", Fraction(4, 3))
    video = read_video(path)
    assert video.frames.shape == (30, 48, 48, 3)
    assert any("4 wide to 3 high" in note for note in video.notes)
    assert read_video(path, width=24).frames.shape == (30, 24, 24, 3)
    set_aside = write_squeezed(tmp_path / f"narrow.{suffix}", Fraction(3, 4))
    assert read_video(set_aside).frames.shape == (30, 48, 27, 3)


def test_the_containers_pixel_aspect_goes_before_that_of_the_codec(tmp_path):
    path = write_squeezed(tmp_path / "video.mp4", Fraction(4, 3))
    content = path.read_bytes()
    place = content.index(b"pasp") + 4
    path.write_bytes(content[:place] + (2).to_bytes(4, "big") + (1).to_bytes(4, "big") + content[place + 8 :])
    assert read_video(path).frames.shape == (30, 48, 72, 3)


def test_turned_pictures_are_stretched_before_they_are_turned(tmp_path):
    path = set_matrix(write_squeezed(tmp_path / "video.mp4", Fraction(4, 3)), ((0, 1), (-1, 0)))
    assert read_video(path, width=24).frames.shape == (30, 24, 24, 3)


PATCHES = np.array(
    [[40, 40, 40], [128, 128, 128], [235, 235, 235], [180, 60, 60], [60, 160, 70], [70, 90, 190], [127, 170, 209]],
    float,
)


def write_codes(path, codes, transfer, primaries, matrix, full_range=False):
    """Patches of (n, 3) YCbCr codes of 10 bits, each 8 x 8 pixels, without loss."""
    planes = np.repeat(np.repeat(np.rint(codes).astype(np.uint16).T[:, None, :], 8, axis=1), 8, axis=2)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=25)
        stream.width, stream.height, stream.pix_fmt = planes.shape[2], 8, "yuv444p10le"
        context = stream.codec_context
        context.color_trc, context.color_primaries, context.colorspace = transfer, primaries, matrix
        context.color_range = 2 if full_range else 1
        frame = av.VideoFrame(planes.shape[2], 8, "yuv444p10le")
        for plane, values in zip(frame.planes, planes, strict=True):
            padded = np.zeros((plane.height, plane.line_size // 2), np.uint16)
            padded[:, : plane.width] = values
            plane.update(padded)
        frame.colorspace, frame.color_range = matrix, 2 if full_range else 1
        frame.pts = 0
        container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def to_codes(rgb, weights, full_range=False):
    """YCbCr codes of 10 bits of nonlinear RGB (n, 3) within 0 and 1 (ITU-T H.273, 8.3)."""
    kr, kg, kb = weights
    luma = rgb @ np.array([kr, kg, kb])
    cb, cr = (rgb[:, 2] - luma) / (2.0 * (1.0 - kb)), (rgb[:, 0] - luma) / (2.0 * (1.0 - kr))
    scale, offset, half = (1023.0, 0.0, 1023.0) if full_range else (876.0, 64.0, 896.0)
    return np.stack([scale * luma + offset, half * cb + 512.0, half * cr + 512.0], axis=1)


BT601_WEIGHTS, BT709_WEIGHTS = (0.299, 0.587, 0.114), (0.2126, 0.7152, 0.0722)
BT2020_WEIGHTS = (0.2627, 0.6780, 0.0593)


def read_patches(path):
    video = read_video(path)
    return video.frames[0, 4, 4::8].astype(float), video.notes


@pytest.mark.parametrize("full_range", [False, True])
@pytest.mark.parametrize(("matrix", "weights"), [(1, BT709_WEIGHTS), (6, BT601_WEIGHTS), (5, BT601_WEIGHTS)])
def test_matrix_and_range_are_those_of_the_file(tmp_path, matrix, weights, full_range):
    codes = to_codes(PATCHES / 255.0, weights, full_range)
    shown, notes = read_patches(write_codes(tmp_path / "video.mkv", codes, 1, 1, matrix, full_range))
    assert shown == pytest.approx(PATCHES, abs=2.0)
    assert notes == ()


def test_small_pictures_without_a_matrix_are_bt601_and_that_is_said(tmp_path):
    codes = to_codes(PATCHES / 255.0, BT601_WEIGHTS)
    shown, notes = read_patches(write_codes(tmp_path / "video.mkv", codes, 2, 2, 2))
    assert shown == pytest.approx(PATCHES, abs=2.0)
    assert "BT.601 is taken" in notes[0]


def test_high_definition_without_a_matrix_is_bt709_and_that_is_said(tmp_path):
    patches = np.repeat(PATCHES, 24, axis=0)
    codes = to_codes(patches / 255.0, BT709_WEIGHTS)
    video = read_video(write_codes(tmp_path / "video.mkv", codes, 2, 2, 2), width=2000)
    assert video.frames[0, 4, 96::192].astype(float) == pytest.approx(PATCHES, abs=2.0)
    assert "BT.709 is taken" in video.notes[0]


def standard_light(rgb):
    """Light in cd/m2 of BT.2020 primaries that a standard screen with a white of 203 cd/m2 shows for codes (n, 3)."""
    to_2020 = np.array([[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]])
    return 203.0 * (rgb / 255.0) ** 2.4 @ to_2020.T


def hlg_codes(light):
    scene = (light / 1000.0) ** (1.0 / 1.2)
    a, b, c = 0.17883277, 0.28466892, 0.55991073
    return np.where(scene <= 1 / 12, np.sqrt(3.0 * scene), a * np.log(np.maximum(12.0 * scene - b, 1e-9)) + c)


def pq_codes(light):
    power = (light / 10_000.0) ** 0.1593017578125
    return ((0.8359375 + 18.8515625 * power) / (1.0 + 18.6875 * power)) ** 78.84375


@pytest.mark.parametrize(("transfer", "encode"), [(HLG, hlg_codes), (PQ, pq_codes)], ids=["HLG", "PQ"])
def test_high_dynamic_range_comes_back_as_the_standard_picture_that_it_was(tmp_path, transfer, encode):
    codes = to_codes(encode(standard_light(PATCHES)), BT2020_WEIGHTS)
    shown, notes = read_patches(write_codes(tmp_path / "video.mkv", codes, transfer, BT2020, BT2020))
    assert shown == pytest.approx(PATCHES, abs=3.0)
    assert "tone-mapped to BT.709" in notes[0]


@pytest.mark.parametrize(("transfer", "encode"), [(HLG, hlg_codes), (PQ, pq_codes)], ids=["HLG", "PQ"])
def test_what_is_brighter_than_white_stays_in_order_and_below_it(tmp_path, transfer, encode):
    light = np.array([100.0, 150.0, 190.0, 220.0, 260.0, 400.0, 1000.0])
    codes = to_codes(encode(np.repeat(light[:, None], 3, axis=1)), BT2020_WEIGHTS)
    shown, _ = read_patches(write_codes(tmp_path / "video.mkv", codes, transfer, BT2020, BT2020))
    assert np.all(np.diff(shown[:5, 1]) > 0)
    assert np.all(np.diff(shown[:, 1]) >= 0)
    assert shown[0] == pytest.approx(255.0 * (100.0 / 203.0) ** (1 / 2.4), abs=2.0)


def test_wide_gamut_of_standard_range_is_brought_to_bt709(tmp_path):
    codes = to_codes((standard_light(PATCHES) / 203.0) ** (1 / 2.4), BT2020_WEIGHTS)
    shown, _ = read_patches(write_codes(tmp_path / "video.mkv", codes, 14, BT2020, BT2020))
    assert shown == pytest.approx(PATCHES, abs=2.0)


@pytest.mark.parametrize(("transfer", "matrix", "message"), [(8, 1, "coded linear"), (1, 14, "matrix 14")])
def test_colours_that_are_not_known_are_refused(tmp_path, transfer, matrix, message):
    path = write_codes(tmp_path / "video.mkv", to_codes(PATCHES / 255.0, BT709_WEIGHTS), transfer, 1, matrix)
    with pytest.raises(InputError, match=message):
        read_video(path)


def moving_bars(count, height=64, width=96):
    """Pictures (count, H, W, 3) of vertical bars that move by 6 pixels each."""
    columns = np.arange(width)
    lines = [np.where(((columns + 6 * number) // 12) % 2, 200, 50) for number in range(count)]
    return np.repeat(np.stack(lines)[:, None, :, None], height, axis=1).repeat(3, axis=3).astype(np.uint8)


@pytest.mark.parametrize("flagged", [True, False])
def test_interlaced_pictures_show_one_moment(tmp_path, flagged):
    fields = moving_bars(24)
    woven = fields[::2].copy()
    woven[:, 1::2] = fields[1::2, 1::2]
    options = {"x264-params": "interlaced=1:tff=1"} if flagged else {}
    path = write_frames(tmp_path / "video.mkv", woven, b_frames=0, crf="4", **options)
    video = read_video(path)
    assert np.abs(video.frames.astype(int) - fields[::2]).mean() < 6.0
    assert any("interlaced" in note and "upper field" in note for note in video.notes)
    times = read_frame_times(path)
    window = read_video_window(path, int(times[4]), int(times[8]))
    assert np.array_equal(window.frames, video.frames[4:9])


def test_progressive_pictures_keep_all_their_lines(tmp_path):
    rng = np.random.default_rng(1)
    stripes = np.repeat(rng.integers(30, 220, (32, 1, 1)), 2, axis=0) * np.ones((1, 96, 3))
    frames = [np.clip(stripes + rng.normal(0, 4, stripes.shape), 0, 255).astype(np.uint8) for _ in range(4)]
    video = read_video(write_frames(tmp_path / "video.mp4", frames, crf="4"))
    assert not any("interlaced" in note for note in video.notes)
    assert np.abs(video.frames.astype(int) - frames).mean() < 6.0


def test_a_size_that_changes_is_refused(tmp_path):
    path = tmp_path / "video.ts"
    with av.open(str(path), "w") as container:
        for number, height in enumerate((32, 48)):
            encoder = av.CodecContext.create("libx264", "w")
            encoder.width, encoder.height, encoder.pix_fmt = 48, height, "yuv420p"
            encoder.time_base, encoder.framerate = Fraction(1, 25), Fraction(25)
            encoder.options = {"bf": "0"}
            stream = container.streams.video[0] if number else container.add_stream("libx264", rate=25)
            if not number:
                stream.width, stream.height, stream.pix_fmt = 48, height, "yuv420p"
            for index, image in enumerate(corner_frames(10, height)):
                frame = av.VideoFrame.from_ndarray(image, format="rgb24")
                frame.pts, frame.time_base = 10 * number + index, Fraction(1, 25)
                packets = encoder.encode(frame)
                packets += encoder.encode(None) if index == 9 else []
                for packet in packets:
                    packet.stream = stream
                    container.mux(packet)
    with pytest.raises(InputError, match=r"frame 10: is 48 x 48 pixels, those before are 48 x 32"):
        read_video(path)
