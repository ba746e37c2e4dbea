"""Damaged shards are read, or refused in one line."""

import pytest

from ....fuzzing import SECONDS
from .conftest import drive_records, write_shards


@pytest.fixture
def shard(tmp_path):
    write_shards(tmp_path, drive_records("drive", frames=4), shards=1)
    (path,) = tmp_path.glob("*.tfrecord*")
    return path


def test_damaged_shards(fuzzer, shard):
    fuzzer.run("dataset", shard, shard.parent, examples=8)


@pytest.mark.slow
def test_damaged_shards_for_long(fuzzer, shard):
    fuzzer.run("dataset", shard, shard.parent, seconds=SECONDS)
