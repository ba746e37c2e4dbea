"""Files of an export: written whole, named in errors, and in a folder that can be taken up again."""

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from olt_generator.errors import InputError
from olt_generator.files import make_folder, write_whole

EXPORT_FILE = "export.json"
_STATE = ".export"


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Turn a failure of the file system into an `InputError` that names the file."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"{path}: cannot be written ({reason}); free some space or choose another folder") from error


@contextmanager
def write_file(path: Path) -> Iterator[Path]:
    """`write_whole` whose failures name the file: InputError where the disk is full, say."""
    with naming(path), write_whole(path) as temporary:
        yield temporary


def link_or_copy(source: Path, target: Path) -> bool:
    """Give a file a second name, or copy it to a file system that cannot; whether it was linked."""
    make_folder(target.parent)
    target.unlink(missing_ok=True)
    try:
        os.link(source, target)
        return True
    except OSError:  # another file system, or one without links
        with write_file(target) as temporary:
            shutil.copyfile(source, temporary)
        return False


@contextmanager
def resumable_folder(out: Path, fingerprint: str) -> Iterator[Path]:
    """Yield a hidden folder beside `out` that becomes `out` on success and is kept on failure, to be taken up again.

    What another export with another fingerprint left there is removed.

    Raises:
        InputError: `out` exists, or the folder cannot be made.
    """
    if out.exists():
        raise InputError(f"{out}: exists already; choose another folder, or remove it first")
    folder = out.parent / f".{out.name}.partial"
    marker = folder / _STATE / "fingerprint"
    if folder.exists() and (not marker.exists() or marker.read_text() != fingerprint):
        shutil.rmtree(folder)
    make_folder(marker.parent)
    with write_file(marker) as temporary:
        temporary.write_text(fingerprint)
    yield folder
    shutil.rmtree(folder / _STATE)
    folder.rename(out)


def finished_part(folder: Path, name: str) -> dict | None:
    """What an earlier run noted when it finished this part; None where it did not."""
    path = folder / _STATE / f"{name}.json"
    return json.loads(path.read_text()) if path.exists() else None


def note_finished(folder: Path, name: str, result: dict) -> None:
    """Note that a part is finished, and with what result."""
    with write_file(folder / _STATE / f"{name}.json") as temporary:
        temporary.write_text(json.dumps(result))


def find_finished(out: Path, fingerprint: str) -> dict | None:
    """The summary of an export that is complete already; None where there is none with this fingerprint."""
    path = out / EXPORT_FILE
    if not path.exists():
        return None
    summary = json.loads(path.read_text())
    return summary if summary.get("fingerprint") == fingerprint else None
