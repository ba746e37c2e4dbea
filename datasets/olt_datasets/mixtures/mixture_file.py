"""A composed mixture as a file: everything that training needs to repeat it without the clip table.

Two forms hold the same: JSON for people and small mixtures, Parquet (with what is not a sample as JSON in its metadata)
for those of any size.
"""

import json
from itertools import accumulate
from pathlib import Path
from typing import Any, Literal

import polars as pl
from polars.exceptions import PanicException
from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from olt_datasets.mixtures.mixture import SAMPLE_SCHEMA, Mixture, MixtureComponent
from olt_datasets.mixtures.quality import SAMPLE_QUALITIES
from olt_datasets.mixtures.recipe import Recipe
from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_toolkit import __version__
from olt_toolkit.clips.parquet_files import open_parquet, read_rows
from olt_toolkit.runtime.json_files import parse_json, read_json

MIXTURE_SUFFIXES = (".json", ".parquet")
METADATA_KEY = "openlongtail mixture"
# Of the columns of samples those in which every cell is filled.
_NEEDED = [name for name in SAMPLE_SCHEMA if name not in ("country", *SAMPLE_QUALITIES)]


class _Header(BaseModel):
    """All of a mixture but its samples."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    format: Literal["openlongtail mixture"] = "openlongtail mixture"
    version: Literal[3] = 3
    created_with: str = __version__
    recipe: Recipe
    seed: int
    checksum: str
    items: int
    available: list[int]
    not_measured: list[int]
    distinct: list[int]
    summary: dict[str, Any]

    @model_validator(mode="after")
    def _check(self) -> "_Header":
        if not len(self.available) == len(self.not_measured) == len(self.distinct) == len(self.recipe.components):
            raise ValueError("the recipe and the mixture differ in their number of components")
        return self


def write_mixture(mixture: Mixture, path: Path) -> None:
    """Write a mixture as JSON or Parquet, by the suffix of the file; it appears whole.

    Raises:
        InputError: the suffix is another one, or the folder cannot be written to.
    """
    if path.suffix not in MIXTURE_SUFFIXES:
        raise InputError(
            f"{path}: a mixture is JSON or Parquet; give a name that ends in {' or '.join(MIXTURE_SUFFIXES)}"
        )
    header = _Header(
        recipe=mixture.recipe,
        seed=mixture.seed,
        checksum=mixture.checksum,
        items=mixture.items,
        available=[part.available for part in mixture.components],
        not_measured=[part.not_measured for part in mixture.components],
        distinct=[len(part.samples) for part in mixture.components],
        summary=mixture.describe(),
    ).model_dump_json()
    with write_whole(path) as temporary:
        if path.suffix == ".parquet":
            mixture.samples.write_parquet(temporary, metadata={METADATA_KEY: header})
        else:
            samples = json.dumps(mixture.samples.to_dict(as_series=False))
            temporary.write_text(f'{header[:-1]},"samples":{samples}}}\n', encoding="utf-8")


def read_mixture(path: Path) -> Mixture:
    """Read a mixture that `write_mixture` wrote.

    Raises:
        InputError: the file cannot be read or is not a mixture of this version; names the field.
    """
    if not path.is_file():
        raise InputError(f"{path}: cannot read this mixture: no such file")
    try:
        header, samples = _read_parts(path)
    except OSError as error:
        raise InputError(f"{path}: cannot read this mixture ({error.strerror or error})") from error
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(map(str, first["loc"])) or "file"
        if field == "version":
            raise InputError(
                f"{path}: version is {first['input']!r}, this release reads 3; compose it again"
            ) from error
        raise InputError(f"{path}: {field}: {first['msg']}; compose the mixture again") from error
    except (InputError, ValueError, TypeError, OverflowError, pl.exceptions.PolarsError, PanicException) as error:
        reason = str(error).partition("\n")[0]
        raise InputError(f"{path}: not a mixture ({reason}); compose it again") from error
    if len(samples) != sum(header.distinct) or any(samples[name].has_nulls() for name in _NEEDED):
        raise InputError(f"{path}: samples: some are missing; compose the mixture again")
    ends = accumulate(header.distinct)
    parts = [samples.slice(end - count, count) for end, count in zip(ends, header.distinct, strict=True)]
    components = map(MixtureComponent, header.recipe.components, header.available, header.not_measured, parts)
    mixture = Mixture(header.recipe, header.seed, header.items, tuple(components))
    if mixture.checksum != header.checksum:
        raise InputError(f"{path}: samples: not those that were composed; compose the mixture again")
    return mixture


def _parse_header(content: object) -> _Header:
    # JSON knows no tuples and no numbers as keys; pydantic allows for that in JSON text alone.
    return _Header.model_validate_json(json.dumps(content))


def _read_parts(path: Path) -> tuple[_Header, pl.DataFrame]:
    if path.suffix == ".parquet":
        with open_parquet(path, str(path)) as file:
            header = (file.metadata.metadata or {}).get(METADATA_KEY.encode())
            if header is None:
                raise ValueError("it was not written by `olt mix compose`")
            samples = pl.DataFrame(read_rows(file, str(path)))
        return _parse_header(parse_json(header, str(path))), samples.match_to_schema(SAMPLE_SCHEMA)
    content = read_json(path, "mixture")
    if not isinstance(content, dict):
        raise ValueError("it is not a JSON object")
    samples = content.pop("samples", None)
    return _parse_header(content), pl.DataFrame(samples, schema=SAMPLE_SCHEMA, strict=True)
