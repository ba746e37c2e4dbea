"""The messages of the Waymo E2E data set that are read, and a frame without its images.

Field numbers are those of Waymo's `end_to_end_driving_data.proto` and `dataset.proto`. Fields that are not named here
are kept by the parser as unknown ones and never looked at. The encoding is that of the Protocol Buffers documentation.
"""

from collections.abc import Mapping
from typing import Any

from google.protobuf.message import DecodeError

from olt_generator.errors import InputError
from olt_toolkit.recordings.messages import make_message_class

_FIELDS = {
    "E2EDFrame": (
        (1, "frame", "Frame"),
        (5, "future_states", "States"),
        (6, "past_states", "States"),
        (8, "preference_trajectories", "States*"),
    ),
    "Frame": ((1, "context", "Context"), (4, "images", "CameraImage*")),
    "Context": ((1, "name", "bytes"), (2, "camera_calibrations", "CameraCalibration*")),
    "CameraImage": ((1, "name", "int32"), (2, "image", "bytes")),
    "CameraCalibration": (
        (1, "name", "int32"),
        (2, "intrinsic", "double*"),
        (3, "extrinsic", "Transform"),
        (4, "width", "int32"),
        (5, "height", "int32"),
    ),
    "Transform": ((1, "transform", "double*"),),
    "States": ((1, "pos_x", "float*"), (2, "pos_y", "float*"), (8, "preference_score", "float")),
}
_IMAGES = {1: {4: {2: None}}}
_VARINT, _LENGTH, _SIZES = 0, 2, {1: 8, 5: 4}
_LONGEST_VARINT = 10


def read_frame(record: bytes | memoryview, where: str, with_images: bool = False) -> Any:
    """The `E2EDFrame` of a record, else InputError; without images their bytes are jumped over, not read from disk."""
    try:
        return _FRAME.FromString(bytes(record) if with_images else leave_out(memoryview(record), _IMAGES))
    except DecodeError as error:
        raise InputError(f"{where}: cut off, damaged or no frame of Waymo's; copy the file again") from error


def leave_out(content: memoryview, fields: Mapping[int, Any]) -> bytes:
    """The bytes of a message without some of its fields, which are jumped over; DecodeError where it is damaged.

    The fields are numbers of those of bytes, with None, and of embedded messages, with what to leave out of them.
    """
    kept: list[bytes | memoryview] = []
    at = 0
    while at < len(content):
        start = at
        key, at = _varint(content, at)
        number, kind = key >> 3, key & 7
        if kind == _VARINT:
            _, end = _varint(content, at)
        elif kind == _LENGTH:
            size, at = _varint(content, at)
            end = at + size
        elif kind in _SIZES:
            end = at + _SIZES[kind]
        else:
            raise DecodeError(f"wire type {kind}")
        if end > len(content):
            raise DecodeError(f"field {number} is cut off")
        if kind != _LENGTH or number not in fields:
            kept.append(content[start:end])
        elif fields[number] is not None:
            part = leave_out(content[at:end], fields[number])
            kept += [_encode(key), _encode(len(part)), part]
        at = end
    return b"".join(kept)


def _varint(content: memoryview, at: int) -> tuple[int, int]:
    """An unsigned integer, seven bits a byte, and where it ends."""
    value = 0
    for count, byte in enumerate(content[at : at + _LONGEST_VARINT]):
        value |= (byte & 0x7F) << (7 * count)
        if byte < 0x80:
            return value, at + count + 1
    raise DecodeError(f"the number at byte {at} does not end")


def _encode(value: int) -> bytes:
    coded = bytearray()
    while value > 0x7F:
        coded.append(0x80 | (value & 0x7F))
        value >>= 7
    return bytes([*coded, value])


_FRAME = make_message_class("olt.waymo", _FIELDS, "E2EDFrame")
