import pytest

from olt_generator.errors import InputError
from olt_generator.files import make_folder, write_whole, write_whole_folder


def test_file_appears_whole(tmp_path):
    target = tmp_path / "deep" / "result.json"
    with write_whole(target) as temporary:
        temporary.write_text("{}")
        assert temporary.suffix == ".json"
        assert not target.exists()
    assert target.read_text() == "{}"
    assert list(target.parent.iterdir()) == [target]


def test_failure_leaves_the_old_file_and_nothing_else(tmp_path):
    target = tmp_path / "result.json"
    target.write_text("old")
    with pytest.raises(KeyboardInterrupt), write_whole(target) as temporary:
        temporary.write_text("half")
        raise KeyboardInterrupt
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_folder_replaces_the_old_one_whole(tmp_path):
    target = tmp_path / "clip"
    for content in ("first", "second"):
        with write_whole_folder(target) as temporary:
            (temporary / content).write_text(content)
    assert [path.name for path in target.iterdir()] == ["second"]
    with pytest.raises(ValueError, match="stop"), write_whole_folder(target) as temporary:
        (temporary / "third").write_text("third")
        raise ValueError("stop")
    assert [path.name for path in target.iterdir()] == ["second"]
    assert list(tmp_path.iterdir()) == [target]


def test_written_files_obey_the_umask(tmp_path):
    with write_whole(tmp_path / "a.txt") as temporary:
        temporary.write_text("a")
    plain = tmp_path / "b.txt"
    plain.write_text("b")
    assert (tmp_path / "a.txt").stat().st_mode == plain.stat().st_mode


def test_a_file_in_the_way_of_a_folder_is_an_input_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="choose another output folder"):
        make_folder(tmp_path / "file" / "below")
