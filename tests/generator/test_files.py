import os
import signal
import subprocess
import sys
import zipfile

import cv2
import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from PIL import Image
from safetensors.torch import save_file

from olt_generator.errors import InputError
from olt_generator.files import find_whole_folder, make_folder, naming, read_bounded, write_whole, write_whole_folder
from olt_generator.video import write_video


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


@pytest.mark.parametrize("renames", [0, 1, 2])
def test_a_killed_process_leaves_one_whole_folder(tmp_path, renames):
    """Killed after so many renames: of the old folder away, and of the new one into its place."""
    target = tmp_path / "clip"
    with write_whole_folder(target) as temporary:
        (temporary / "old").touch()
    script = f"""
import os, signal, shutil, sys
from pathlib import Path
from olt_generator.files import write_whole_folder

rename, remove, count = Path.rename, shutil.rmtree, 0
def kill_after():
    if count == {renames}:
        os.kill(os.getpid(), signal.SIGKILL)
def rename_or_kill(path, to):
    global count
    kill_after()
    count += 1
    return rename(path, to)
def remove_or_kill(path, **options):
    if count:
        kill_after()
    return remove(path, **options)
Path.rename, shutil.rmtree = rename_or_kill, remove_or_kill
with write_whole_folder(Path(sys.argv[1])) as temporary:
    (temporary / "new").touch()
"""
    ended = subprocess.run([sys.executable, "-c", script, str(target)], check=False)
    assert ended.returncode == -signal.SIGKILL
    assert [path.name for path in find_whole_folder(target).iterdir()] == ["new" if renames == 2 else "old"]
    with write_whole_folder(target) as temporary:
        (temporary / "later").touch()
    assert find_whole_folder(target) == target
    assert [path.name for path in target.iterdir()] == ["later"]
    assert not (tmp_path / ".clip.replaced").exists()


def test_written_files_obey_the_umask(tmp_path):
    with write_whole(tmp_path / "a.txt") as temporary:
        temporary.write_text("a")
    plain = tmp_path / "b.txt"
    plain.write_text("b")
    assert (tmp_path / "a.txt").stat().st_mode == plain.stat().st_mode


def test_files_in_a_written_folder_obey_the_umask_too(tmp_path):
    plain = tmp_path / "plain.txt"
    plain.write_text("x")
    kept = tmp_path / "kept.txt"
    kept.touch(0o600)
    with write_whole_folder(tmp_path / "folder") as temporary:
        (temporary / "deep").mkdir()
        save_file({"noise": torch.tensor([1.0])}, temporary / "deep" / "model.safetensors")
        (temporary / "run.sh").touch(0o700)
        os.link(kept, temporary / "linked.txt")
    modes = {path.name: path.stat().st_mode & 0o777 for path in (tmp_path / "folder").rglob("*") if path.is_file()}
    usual = plain.stat().st_mode & 0o777
    assert modes == {"model.safetensors": usual, "run.sh": 0o700 | usual, "linked.txt": 0o600}


def test_a_file_in_the_way_of_a_folder_is_an_input_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="choose another output folder"):
        make_folder(tmp_path / "file" / "below")


NOISE = np.random.default_rng(0).integers(0, 256, (4, 64, 64, 3), dtype=np.uint8)


def write_zip(path):
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("member", NOISE.tobytes())


def write_stage(path):
    usd = pytest.importorskip("pxr.Usd")
    stage = usd.Stage.CreateInMemory()
    stage.GetRootLayer().comment = NOISE.tobytes().hex()
    stage.GetRootLayer().Export(str(path))


WRITERS = {
    "text.json": lambda path: path.write_text("x" * 10_000),
    "bytes": lambda path: path.write_bytes(NOISE.tobytes()),
    "lines.txt": lambda path: np.savetxt(path, NOISE.reshape(-1, 3)),
    "arrow.parquet": lambda path: pq.write_table(pa.table({"noise": NOISE.ravel()}), path),
    "pandas.parquet": lambda path: pd.DataFrame({"noise": NOISE.ravel()}).to_parquet(path),
    "polars.parquet": lambda path: pl.DataFrame({"noise": NOISE.ravel()}).write_parquet(path),
    "table.csv": lambda path: pd.DataFrame({"noise": NOISE.ravel()}).to_csv(path),
    "chunk.zip": write_zip,
    "picture.webp": lambda path: Image.fromarray(NOISE[0]).save(path, lossless=True),
    "model.safetensors": lambda path: save_file({"noise": torch.tensor(NOISE)}, path),
    "scene.usda": write_stage,
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_names_the_file_and_leaves_the_old_one_whatever_writes(tmp_path, full_disk, name):
    target = tmp_path / name
    target.write_text("old")
    with pytest.raises(InputError, match=rf"{name}: cannot be written \(File too large\); free some space"):  # noqa: SIM117
        with full_disk(3000), write_whole(target) as temporary:
            WRITERS[name](temporary)
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_a_full_disk_names_the_video(tmp_path, full_disk):
    with pytest.raises(InputError, match=r"film\.mp4: cannot be written"), full_disk(3000):
        write_video(tmp_path / "film.mp4", np.tile(NOISE, (4, 1, 1, 1)), 10.0)
    assert not list(tmp_path.iterdir())


def test_a_full_disk_names_the_folder_and_leaves_the_old_one(tmp_path, full_disk):
    target = tmp_path / "clip"
    with write_whole_folder(target) as temporary:
        (temporary / "old").touch()
    with (
        pytest.raises(InputError, match="clip: cannot be written"),
        full_disk(100),
        write_whole_folder(target) as temporary,
    ):
        (temporary / "new").write_bytes(NOISE.tobytes())
    assert [path.name for path in tmp_path.rglob("*")] == ["clip", "old"]


def test_only_a_refusal_to_write_is_named(tmp_path):
    with pytest.raises(FileNotFoundError), write_whole(tmp_path / "out"):
        (tmp_path / "source that is absent").read_bytes()
    with pytest.raises(InputError, match=r"^told already$"), naming(tmp_path):
        raise InputError("told already")
    assert not list(tmp_path.iterdir())


def test_a_name_that_cannot_be_is_refused(tmp_path):
    with (
        pytest.raises(InputError, match=r"cannot be written \(File name too long"),
        write_whole(tmp_path / ("n" * 300)),
    ):
        pass
    (tmp_path / "folder" / "full").mkdir(parents=True)
    with (
        pytest.raises(InputError, match=r"folder: cannot be written \(Is a directory"),
        write_whole(tmp_path / "folder"),
    ):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


def test_files_are_read_up_to_a_size(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"1234")
    assert read_bounded(path, "list", 4) == b"1234"
    with pytest.raises(InputError, match="file: has 4 bytes; a list has at most 3"):
        read_bounded(path, "list", 3)
    with pytest.raises(InputError, match="no such file"):
        read_bounded(tmp_path / "absent", "list", 3)


def test_what_would_never_end_is_not_read(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "zeros").symlink_to("/dev/zero")
    for name, message in (("pipe", "not a regular"), ("zeros", "not a regular"), ("loop", "no such file")):
        with pytest.raises(InputError, match=message):
            read_bounded(tmp_path / name, "list", 10)
    with pytest.raises(InputError, match="not a regular"):
        read_bounded(tmp_path, "list", 10)


def test_opencv_encodes_pictures_before_they_are_written(tmp_path, full_disk):
    from olt_toolkit.clips.pictures import write_picture

    with pytest.raises(InputError, match=r"sheet\.png: cannot be written"), full_disk(3000):
        write_picture(tmp_path / "sheet.png", NOISE[0])
    write_picture(tmp_path / "sheet.png", NOISE[0])
    assert np.array_equal(cv2.imread(str(tmp_path / "sheet.png"))[..., ::-1], NOISE[0])
