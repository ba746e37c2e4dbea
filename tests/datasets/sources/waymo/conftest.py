"""Small Waymo E2E shards, written independently of the reader: TFRecord and protocol buffers by hand."""

import struct
from functools import cache
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from olt_toolkit.recordings.drives import open_dataset

WIDTH, HEIGHT = 48, 64
FOCAL = 40.0
# Yaw in degrees, to the left, of each camera by its number.
YAWS = {1: 0.0, 2: 45.0, 3: -45.0, 4: 90.0, 5: -90.0, 6: 135.0, 7: 180.0, 8: -135.0}


def crc32c(data):
    """Bit by bit: the reflected polynomial of RFC 3720."""
    state = 0xFFFFFFFF
    for byte in data:
        state ^= byte
        for _ in range(8):
            state = (state >> 1) ^ (0x82F63B78 if state & 1 else 0)
    return state ^ 0xFFFFFFFF


def masked(data):
    checksum = crc32c(data)
    return struct.pack("<I", (((checksum >> 15) | (checksum << 17)) + 0xA282EAD8) & 0xFFFFFFFF)


def tf_record(data):
    length = struct.pack("<Q", len(data))
    return length + masked(length) + data + masked(data)


def varint(value):
    value &= (1 << 64) - 1
    parts = []
    while value > 0x7F:
        parts.append(0x80 | (value & 0x7F))
        value >>= 7
    return bytes([*parts, value])


def number_field(number, value):
    return varint(number << 3) + varint(value)


def data_field(number, data):
    return varint(number << 3 | 2) + varint(len(data)) + data


def floats_field(number, values):
    return data_field(number, np.asarray(values, "<f4").tobytes())


def doubles_fields(number, values):
    """One by one, as proto2 writes what is not declared packed."""
    return b"".join(varint(number << 3 | 1) + struct.pack("<d", value) for value in values)


def calibration(number):
    yaw = np.radians(YAWS[number])
    pose = [np.cos(yaw), -np.sin(yaw), 0, 1.5, np.sin(yaw), np.cos(yaw), 0, 0.1, 0, 0, 1, 2.0, 0, 0, 0, 1]
    return (
        number_field(1, number)
        + doubles_fields(2, [FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, -0.01, 0, 0, 0, 0])
        + data_field(3, doubles_fields(1, pose))
        + number_field(4, WIDTH)
        + number_field(5, HEIGHT)
        + number_field(6, 2)
    )


@cache
def jpeg(level):
    picture = np.full((HEIGHT, WIDTH, 3), level, np.uint8)
    return cv2.imencode(".jpg", picture)[1].tobytes()


def states(positions):
    return floats_field(1, positions[:, 0]) + floats_field(2, positions[:, 1]) + floats_field(4, [1.0] * len(positions))


def frame(name, past, future, cameras=tuple(YAWS), level=100, scores=()):
    """An `E2EDFrame`; calibrations come in another order than the images."""
    context = data_field(1, name.encode()) + b"".join(data_field(2, calibration(k)) for k in reversed(cameras))
    images = b"".join(
        data_field(4, number_field(1, k) + data_field(2, jpeg(level + 10 * k)) + data_field(3, b"")) for k in cameras
    )
    ratings = b"".join(
        data_field(8, states(np.zeros((1, 2))) + varint(8 << 3 | 5) + struct.pack("<f", score)) for score in scores
    )
    inner = data_field(1, context) + number_field(2, 0) + images
    return (
        data_field(1, inner)
        + data_field(5, states(future))
        + data_field(6, states(past))
        + number_field(7, 1)
        + ratings
    )


class BendingDrive:
    """A drive whose speed and curvature change; poses in closed form to within the step of its integration."""

    def __init__(self, seconds=40.0, standing=False):
        self.times = np.arange(-5.0, seconds, 1e-3)
        speed = np.zeros_like(self.times) if standing else 8.0 + 3.0 * np.sin(0.4 * self.times)
        self.yaws = 0.0 * self.times if standing else 0.6 * np.sin(0.25 * self.times)
        steps = speed[:, None] * np.stack([np.cos(self.yaws), np.sin(self.yaws)], -1) * 1e-3
        middle = 0.5 * (steps[1:] + steps[:-1])
        self.positions = np.concatenate([np.zeros((1, 2)), np.cumsum(middle, axis=0)])

    def pose(self, time):
        at = round((time + 5.0) * 1000)
        return self.positions[at], self.yaws[at]

    def states(self, time, offsets):
        """Positions (n, 2) at time + offsets in the rig at that time."""
        origin, yaw = self.pose(time)
        back = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
        return np.array([back @ (self.pose(time + offset)[0] - origin) for offset in offsets]).reshape(-1, 2)


PAST, FUTURE = np.arange(-15, 1) * 0.25, np.arange(1, 21) * 0.25


def drive_records(name, frames=12, drive=None, first=0, rated=(), future=FUTURE, cameras=tuple(YAWS)):
    """One record a frame, 0.1 s apart."""
    drive = drive or BendingDrive()
    return [
        frame(
            f"{name}-{index:03d}",
            drive.states(0.1 * index, PAST),
            drive.states(0.1 * index, future),
            cameras,
            level=index,
            scores=(7.5, -1.0) if index in rated else (),
        )
        for index in range(first, first + frames)
    ]


def write_shards(folder, records, split="training", shards=3):
    """Deal the records out over shards, shuffled."""
    shards = min(shards, len(records))
    order = np.random.default_rng(0).permutation(len(records))
    for shard in range(shards):
        path = folder / f"{split}_202504031202.tfrecord-{shard:05d}-of-{shards:05d}"
        path.write_bytes(b"".join(tf_record(records[k]) for k in order[shard::shards]))


@pytest.fixture(scope="session")
def fields():
    """Writers of single fields of a message."""
    return SimpleNamespace(number=number_field, data=data_field, floats=floats_field, doubles=doubles_fields)


@pytest.fixture(scope="session")
def make_frame():
    return frame


@pytest.fixture(scope="session")
def make_tf_record():
    return tf_record


@pytest.fixture(scope="session")
def make_drive():
    return BendingDrive


@pytest.fixture(scope="session")
def make_records():
    return drive_records


@pytest.fixture
def open_shards(tmp_path):
    """Write records as shards, and open them as a data set."""

    def write_and_open(records, split="training", shards=3):
        root = tmp_path / "shards"
        root.mkdir(exist_ok=True)
        write_shards(root, records, split, shards)
        return open_dataset(root, tmp_path / "cache")

    return write_and_open
