"""Members of a zip file, where they lie."""

import zipfile
from contextlib import suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_generator.errors import InputError
from olt_toolkit.clips.chunk_archive import LARGEST_MEMBER, ChunkArchive


@pytest.fixture
def write_zip(tmp_path):
    def write(members, method=zipfile.ZIP_STORED):
        path = tmp_path / "chunk.zip"
        with zipfile.ZipFile(path, "w", method) as archive:
            for name, data in members.items():
                archive.writestr(name, data)
        return path

    return write


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_members_come_back(write_zip, method):
    archive = ChunkArchive(write_zip({"a": b"first", "b": b"second" * 1000, "../../c": b"outside"}, method))
    assert archive.read("b") == b"second" * 1000
    assert "a" in archive and "c" not in archive


def test_a_stored_member_is_read_where_it_lies(write_zip):
    path = write_zip({"a": b"first", "b": b"second"})
    place = ChunkArchive(path).locate("b")
    assert place is not None
    assert path.read_bytes()[place.start : place.start + place.size] == b"second"
    assert ChunkArchive(write_zip({"a": b"first"}, zipfile.ZIP_DEFLATED)).locate("a") is None


def test_a_bomb_is_refused_without_being_unpacked(write_zip):
    path = write_zip({"a": bytes(1 << 20)}, zipfile.ZIP_DEFLATED)
    data = path.read_bytes()
    size = (1 << 20).to_bytes(4, "little")
    path.write_bytes(data.replace(size, (LARGEST_MEMBER + 1).to_bytes(4, "little")))
    with pytest.raises(InputError, match="member a claims"):
        ChunkArchive(path).read("a")


def test_a_member_larger_than_it_claims_is_damaged(write_zip):
    path = write_zip({"a": bytes(1 << 20)}, zipfile.ZIP_DEFLATED)
    path.write_bytes(path.read_bytes().replace((1 << 20).to_bytes(4, "little"), (1 << 10).to_bytes(4, "little")))
    with pytest.raises(InputError, match="member a is damaged"):
        ChunkArchive(path).read("a")


def test_what_is_no_zip_is_refused(tmp_path):
    (tmp_path / "chunk.zip").write_bytes(b"PK not really")
    with pytest.raises(InputError, match=r"chunk\.zip"):
        ChunkArchive(tmp_path / "chunk.zip")


@settings(max_examples=60)
@given(place=st.integers(0, 2000), byte=st.integers(0, 255))
def test_any_damaged_byte_gives_the_data_or_an_error(tmp_path_factory, place, byte):
    path = tmp_path_factory.mktemp("zip") / "chunk.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a", bytes(range(256)) * 4)
    data = bytearray(path.read_bytes())
    data[place % len(data)] = byte
    path.write_bytes(bytes(data))
    with suppress(InputError):
        assert ChunkArchive(path).read("a") == bytes(range(256)) * 4
