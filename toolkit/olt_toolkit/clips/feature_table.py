"""Reading `features.csv`: where a PhysicalAI-AV folder says that its files are (docs/formats/physicalai_av.md)."""

import json
import re
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path, PurePosixPath
from string import Formatter

import pandas as pd

from olt_generator.errors import InputError
from olt_generator.files import read_bounded
from olt_toolkit.clips.pai_layout import FEATURE_TABLE, Feature

_LARGEST_TABLE = 1 << 20
_COLUMNS = ("feature", "directory", "chunk_path", "clip_files_in_zip")
_WIDTH = re.compile(r"\d{0,2}d?")  # a width of thousands of digits would fill the memory
_CHUNKS = (0, 123, 45678)  # of fewer, as many and more digits than the four that the layout writes


@dataclass(frozen=True)
class FeatureRow:
    """A row of `features.csv`: members of zips are alias to template of a name."""

    name: str
    directory: str
    chunk_path: str
    members: dict[str, str]

    def chunk_file(self, root: Path, chunk: int) -> Path:
        """File of one chunk."""
        return root / self.chunk_path.format(chunk_id=chunk)

    def member(self, alias: str, clip_id: str) -> str:
        """Name of a clip's member; an `InputError` where the row has no such alias."""
        if alias not in self.members:
            raise InputError(f"{FEATURE_TABLE}: {self.name} has no member {alias!r} in clip_files_in_zip; export again")
        return self.members[alias].format(clip_id=clip_id)

    def leads_to(self, feature: Feature) -> bool:
        """Whether the row names the files of the layout; it may name further members, as published rows do."""
        return (
            self.directory == feature.directory
            and all(
                self.chunk_path.format(chunk_id=chunk) == feature.chunk_path.format(chunk_id=chunk) for chunk in _CHUNKS
            )
            and feature.members.keys() <= self.members.keys()
            and all(self.member(alias, "a-clip") == feature.member(alias, "a-clip") for alias in feature.members)
        )


def read_feature_table(path: Path) -> dict[str, FeatureRow]:
    """The rows of `features.csv` by name.

    Raises:
        InputError: the file is no such table, has a feature twice, or a row of which no path inside the folder can be
            made.
    """
    content = read_bounded(path, "table of features", _LARGEST_TABLE)
    try:
        table = pd.read_csv(BytesIO(content), dtype=str)
    except ValueError as error:
        raise InputError(f"{path}: not a readable table ({' '.join(str(error).split())}); export again") from error
    missing = [name for name in _COLUMNS if name not in table]
    if missing:
        raise InputError(f"{path}: column {', '.join(missing)} is missing; export again")
    if table["feature"].duplicated().any():
        raise InputError(f"{path}: a feature is there twice; remove one row")
    rows = table.astype(object).where(table.notna(), None).to_dict("records")
    return {str(row["feature"]): _read_row(row, path) for row in rows}


def _read_row(row: dict[str, str | None], path: Path) -> FeatureRow:
    name, directory, chunk_path = (str(row[key] or "") for key in _COLUMNS[:3])
    try:
        members = {} if row["clip_files_in_zip"] is None else json.loads(row["clip_files_in_zip"])
        named = [_fill(chunk_path, chunk_id=0), *(_fill(template, clip_id="") for template in members.values())]
    except (ValueError, KeyError, IndexError, AttributeError, TypeError, RecursionError) as error:
        raise InputError(f"{path}: row {name}: paths cannot be made of it ({error!r}); export again") from error
    if any(each.is_absolute() or ".." in each.parts for each in named):
        raise InputError(f"{path}: row {name} leads out of the folder; export again")
    # The reader takes a feature for a zip by the ending of its file, and {} for a zip without members.
    if (chunk_path.endswith(".zip") and not members) or (
        chunk_path.endswith(".parquet") and row["clip_files_in_zip"] is not None
    ):
        raise InputError(f"{path}: row {name}: clip_files_in_zip must name members of a zip and be empty elsewhere")
    return FeatureRow(name, directory, chunk_path, members)


def _fill(template: str, **values: object) -> PurePosixPath:
    for _, field, width, _ in Formatter().parse(template):
        if field is not None and (field not in values or not _WIDTH.fullmatch(width or "")):
            raise ValueError(f"{{{field}:{width}}} stands for nothing")
    return PurePosixPath(template.format(**values))
