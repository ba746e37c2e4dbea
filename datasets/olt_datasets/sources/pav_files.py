"""Members of the zips of a PhysicalAI-AV tree, read by their names: nothing is ever extracted to disk."""

import zipfile
import zlib
from functools import lru_cache
from pathlib import Path

from olt_generator.errors import InputError
from olt_toolkit.pai_layout import FEATURES

# A member that claims to be larger than this is none of the data set: its videos take some 20 MB.
_LARGEST_MEMBER_BYTES = 2**30


def chunk_file(root: Path, chunk: int, feature: str) -> Path:
    """The file that holds a feature of the clips of a chunk."""
    return FEATURES[feature].chunk_file(root, chunk)


def has_member(path: Path, feature: str, alias: str, clip_id: str) -> bool:
    """Whether a chunk's zip is there and holds this member of a clip.

    Raises:
        InputError: the zip is damaged.
    """
    return path.is_file() and FEATURES[feature].member(alias, clip_id) in _member_names(path)


def read_member(path: Path, feature: str, alias: str, clip_id: str) -> tuple[bytes, str]:
    """A member of a chunk's zip, and what to call it in errors.

    Raises:
        InputError: the zip or the member is missing, damaged, or larger than anything in the data set.
    """
    name = FEATURES[feature].member(alias, clip_id)
    try:
        with zipfile.ZipFile(path) as archive:
            size = archive.getinfo(name).file_size
            if size > _LARGEST_MEMBER_BYTES:
                raise InputError(f"{path}: member {name} claims to hold {size} bytes; copy the chunk again")
            return archive.read(name), f"{path}: {name}"
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file; copy this chunk too") from error
    except KeyError as error:
        raise InputError(f"{path}: member {name} is missing; copy the chunk again") from error
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, NotImplementedError, RuntimeError) as error:
        raise InputError(f"{path}: member {name} is damaged ({error}); copy the chunk again") from error


@lru_cache(maxsize=32)
def _member_names(path: Path) -> frozenset[str]:
    try:
        with zipfile.ZipFile(path) as archive:
            return frozenset(archive.namelist())
    except (zipfile.BadZipFile, OSError) as error:
        raise InputError(f"{path}: damaged zip file ({error}); copy the chunk again") from error
