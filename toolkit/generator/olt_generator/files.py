"""Files and folders that appear whole or not at all, and files of bounded size.

What the system refuses to write becomes an `InputError` that names the file; no writer has to see to that itself.
"""

import errno
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

from olt_generator.errors import InputError

# Why a disk takes no more. Libraries tell it in errors of their own, but in the words of the system.
_NOT_WRITTEN = [os.strerror(code) for code in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)]


def read_bounded(path: Path, what: str, most_bytes: int) -> bytes:
    """The content of a file that errors call `what`, such as "recipe", and that has at most so many bytes.

    Raises:
        InputError: the file is missing, is no regular file (a pipe or a device would never end), is too large, or
            cannot be read.
    """
    try:
        if not path.exists():
            raise InputError(f"{path}: cannot read this {what}: no such file")
        if not path.is_file():
            raise InputError(f"{path}: cannot read this {what}: not a regular file")
        if (size := path.stat().st_size) > most_bytes:
            raise InputError(f"{path}: has {size} bytes; a {what} has at most {most_bytes}")
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot read this {what} ({error.strerror})") from error


def make_folder(path: Path) -> Path:
    """Create a folder and its parents.

    Raises:
        InputError: the folder cannot be made or written to.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot make this folder ({error.strerror}); choose another output folder") from error
    if not os.access(path, os.W_OK | os.X_OK):
        raise InputError(f"{path}: this folder is not writable; choose another output folder")
    return path


def walk_files(folder: Path) -> list[Path]:
    """All files in a folder and below, sorted; links to folders are not followed, so that no loop is walked.

    Raises:
        InputError: a folder cannot be listed, so that files in it would be passed over in silence.
    """

    def refuse(error: OSError) -> NoReturn:
        raise InputError(f"{error.filename}: cannot be listed ({error.strerror}); make it readable") from error

    return sorted(Path(parent) / name for parent, _, names in os.walk(folder, onerror=refuse) for name in names)


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Turn the system's refusal to write, whichever library tells it, into an `InputError` that names the file."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        reason = next((words for words in _NOT_WRITTEN if words in str(error)), None)
        if reason is None:
            raise
        raise InputError(f"{path}: cannot be written ({reason}); free some space or choose another folder") from error


@contextmanager
def write_whole(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it to `path` on success, remove it on any failure.

    The temporary name keeps the suffix of `path`, because writers choose their format by it.

    Raises:
        InputError: the folder cannot be made, the disk is full, or `path` cannot be replaced.
    """
    make_folder(path.parent)
    with _placing(path):
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        with naming(path):
            yield temporary
        temporary.chmod(0o666 & ~_umask())
        with _placing(path):
            temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def write_whole_folder(path: Path) -> Iterator[Path]:
    """Yield a temporary folder beside `path` that replaces `path` on success and is removed on any failure.

    Whenever the process is killed, `find_whole_folder` finds the old content or the new, whole.

    Raises:
        InputError: see `write_whole`.
    """
    make_folder(path.parent)
    with _placing(path):
        temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    try:
        with naming(path):
            yield temporary
            _let_others_read(temporary)
        with _placing(path):
            if path.exists():
                shutil.rmtree(_aside(path), ignore_errors=True)
                path.rename(_aside(path))
            temporary.rename(path)
        shutil.rmtree(_aside(path), ignore_errors=True)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _let_others_read(folder: Path) -> None:
    """Give a folder and all that was written into it the permissions that new files have: some libraries give less."""
    umask = _umask()
    new = 0o666 & ~umask
    folder.chmod(0o777 & ~umask)
    for path in folder.rglob("*"):
        facts = path.lstat()
        # What is linked belongs elsewhere, too.
        if stat.S_ISREG(facts.st_mode) and facts.st_nlink == 1 and facts.st_mode & new != new:
            path.chmod(stat.S_IMODE(facts.st_mode) | new)


def find_whole_folder(path: Path) -> Path:
    """Where the folder that `write_whole_folder` wrote is: at `path`, or aside where what replaces it was killed."""
    return _aside(path) if not path.exists() and _aside(path).is_dir() else path


def remove_whole_folder(path: Path) -> None:
    """Remove a folder that `write_whole_folder` wrote, if there is one; it is never there by halves under its name."""
    whole, aside = find_whole_folder(path), path.with_name(f".{path.name}.removed")
    if whole.exists():
        whole.rename(aside)
        shutil.rmtree(aside)


def sync(path: Path) -> None:
    """Have a file, or the names in a folder, written to the disk, so that they outlive a power cut."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def sync_folder(path: Path) -> None:
    """`sync` a folder and all below it."""
    for place in [*path.rglob("*"), path]:
        sync(place)


def _aside(path: Path) -> Path:
    return path.with_name(f".{path.name}.replaced")


@contextmanager
def _placing(path: Path) -> Iterator[None]:
    """Name the file where the system does not let it appear, for whatever reason."""
    try:
        yield
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror}); free some space or choose another name"
        ) from error


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
