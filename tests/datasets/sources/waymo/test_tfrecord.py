"""TFRecord files and protocol buffers: the right bytes, or an error in words."""

import struct
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_datasets.sources.waymo.frames import read_images, read_states
from olt_datasets.sources.waymo.messages import read_frame
from olt_generator.errors import InputError
from olt_toolkit.recordings.tfrecord import map_records, masked_crc32c, read_record, record_spans

# From RFC 3720, appendix B.4.
KNOWN_CHECKSUMS = [
    (b"123456789", 0xE3069283),
    (bytes(32), 0x8A9136AA),
    (b"\xff" * 32, 0x62A8AB43),
    (bytes(range(32)), 0x46DD794E),
]


@pytest.mark.parametrize(("content", "checksum"), KNOWN_CHECKSUMS)
def test_crc32c_of_known_bytes(content, checksum):
    assert masked_crc32c(content) == mask(checksum)


def mask(checksum):
    return (((checksum >> 15) | (checksum << 17)) + 0xA282EAD8) & 0xFFFFFFFF


@pytest.mark.parametrize("length", [65_536, 65_537, 100_003, 8 * 4096 * 7])
def test_crc32c_of_many_bytes_is_that_of_one_byte_after_another(length):
    content = np.random.default_rng(length).integers(0, 256, length, dtype=np.uint8).tobytes()
    table = [crc_of_byte(byte) for byte in range(256)]
    state = 0xFFFFFFFF
    for byte in content:
        state = table[(state ^ byte) & 0xFF] ^ (state >> 8)
    assert masked_crc32c(content) == mask(state ^ 0xFFFFFFFF)


def crc_of_byte(byte):
    for _ in range(8):
        byte = (byte >> 1) ^ (0x82F63B78 if byte & 1 else 0)
    return byte


def test_records_come_back_as_they_were_written(tmp_path, make_tf_record):
    contents = [b"", b"one", bytes(300), b"\x00\xff" * 40_000]
    path = tmp_path / "shard"
    path.write_bytes(b"".join(make_tf_record(content) for content in contents))
    mapped = map_records(path)
    spans = list(record_spans(mapped, "shard"))
    assert [bytes(read_record(mapped, *span, "shard")) for span in spans] == contents


@given(st.lists(st.binary(max_size=50), min_size=1, max_size=4), st.data())
def test_a_cut_off_file_is_refused_unless_cut_between_records(make_tf_record, contents, data):
    records = [make_tf_record(content) for content in contents]
    ends = np.cumsum([len(record) for record in records]).tolist()
    cut = data.draw(st.integers(1, ends[-1]))
    content = memoryview(b"".join(records)[:cut])
    if cut in ends:
        assert len(list(record_spans(content, "shard"))) == ends.index(cut) + 1
    else:
        with pytest.raises(InputError, match="cut off"):
            list(record_spans(content, "shard"))


@given(st.binary(min_size=1, max_size=50), st.data())
def test_one_turned_bit_anywhere_is_noticed(make_tf_record, content, data):
    record = bytearray(make_tf_record(content))
    bit = data.draw(st.integers(0, 8 * len(record) - 1))
    record[bit // 8] ^= 1 << (bit % 8)
    with pytest.raises(InputError, match="damaged"):
        for offset, length in record_spans(memoryview(record), "shard"):
            read_record(memoryview(record), offset, length, "shard")


def test_a_length_beyond_the_file_is_refused_even_with_its_right_checksum():
    length = struct.pack("<Q", 1 << 62)
    content = memoryview(length + struct.pack("<I", masked_crc32c(length)) + b"abc")
    with pytest.raises(InputError, match="ends within record 0"):
        list(record_spans(content, "shard"))


def test_missing_and_empty_files_are_refused(tmp_path):
    (tmp_path / "empty").touch()
    for name in ("empty", "absent"):
        with pytest.raises(InputError, match=f"{name}: cannot be read"):
            map_records(tmp_path / name)


@given(st.binary(max_size=300))
def test_noise_is_no_frame(content):
    with pytest.raises(InputError):
        read_states(memoryview(content), "noise")
    with suppress(InputError):
        assert read_images(memoryview(content), "noise")[0] == {}


@given(st.data())
def test_a_damaged_frame_is_a_frame_or_an_input_error(small_frame, data):
    content = bytearray(small_frame)
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    end = data.draw(st.integers(0, len(content)))
    for read in (read_states, read_images):
        try:
            read(memoryview(content)[:end], "damaged")
        except InputError as error:
            assert "damaged" in str(error)
            assert "\n" not in str(error)


@pytest.fixture(scope="module")
def small_frame(make_frame):
    straight = np.stack([np.arange(-2.0, 1.0), np.zeros(3)], -1)
    return make_frame("drive-001", straight, straight[:2] + 3.0, cameras=(1, 4))


def test_images_are_jumped_over_and_all_else_stays(small_frame):
    whole, small = (read_frame(memoryview(small_frame), "frame", with_images) for with_images in (True, False))
    assert [image.name for image in small.frame.images] == [image.name for image in whole.frame.images] == [1, 4]
    assert all(len(image.image) > 100 for image in whole.frame.images)
    assert {image.image for image in small.frame.images} == {b""}
    for image in whole.frame.images:
        image.ClearField("image")
        image.DiscardUnknownFields()
    small.DiscardUnknownFields()
    whole.DiscardUnknownFields()
    assert small == whole


@given(st.lists(st.floats(-1e3, 1e3, width=32), min_size=2, max_size=16))
def test_positions_come_back_as_they_were_written(make_frame, along):
    past = np.stack([np.asarray(along) - along[-1], np.zeros(len(along))], -1).astype(np.float32)
    states = read_states(memoryview(make_frame("drive-001", past, past[:1], cameras=(1,))), "frame")
    assert np.array_equal(states["past"], past.astype(float))
    assert np.array_equal(states["future"], past[:1].astype(float))


def test_absent_fields_have_the_values_of_the_format():
    message = read_frame(memoryview(b""), "message")
    assert (message.frame.context.name, len(message.frame.images), len(message.past_states.pos_x)) == (b"", 0, 0)


@pytest.mark.parametrize(
    "content",
    [
        b"\x08",
        b"\x08" + b"\xff" * 10 + b"\x01",
        b"\x0a\x05ab",
        b"\x09\x00",
        b"\x00\x00",
        b"\x0b\x08\x01",
        b"\x0a\xff\xff\xff\xff\xff\xff\xff\xff\x7f",
        b"\x2a\x04\x0a\x03abc",
    ],
)
@pytest.mark.parametrize("with_images", [False, True])
def test_what_is_no_message(content, with_images):
    with pytest.raises(InputError, match="message: cut off, damaged or no frame"):
        read_frame(memoryview(content), "message", with_images)
