"""How recovered poses are written, by name; it is cheap to import, for the command line."""

from enum import StrEnum
from pathlib import Path

from olt_generator.errors import InputError


class PoseFormat(StrEnum):
    """How poses are written."""

    TUM = "tum"
    KITTI = "kitti"
    PARQUET = "parquet"


class PoseOf(StrEnum):
    """Whose poses are written."""

    RIG = "rig"
    CAMERA = "camera"


def choose_format(path: Path, named: PoseFormat | None) -> PoseFormat:
    """The format that is named, else that of the file's extension; an `InputError` where neither tells one."""
    if named is not None:
        return named
    extension = path.suffix.lower().removeprefix(".")
    if extension not in list(PoseFormat):
        known = ", ".join(f".{each}" for each in PoseFormat)
        raise InputError(f"{path}: {path.suffix or 'no extension'} tells no format of poses; use {known}, or --format")
    return PoseFormat(extension)


def choose_poses(format_: PoseFormat, named: PoseOf | None) -> PoseOf:
    """Whose poses a file holds: those that are named, else the camera's in KITTI's format, which has no others."""
    return named or (PoseOf.CAMERA if format_ is PoseFormat.KITTI else PoseOf.RIG)
