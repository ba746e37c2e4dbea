"""Large JSON files that hold a list of objects, read object by object."""

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from olt_generator.errors import InputError
from olt_toolkit.runtime.json_files import unique_keys

_BLOCK = 2**20
_LARGEST_ROW = 16 * 2**20
_LARGEST_INTEGER = 2**63 - 1
_MOST_DEPTH = 4
_BETWEEN = " \t\r\n,"


def read_rows(path: Path, fields: Mapping[str, type]) -> Iterator[dict[str, Any]]:
    """The objects of a list, each with at least the given fields; only a block of the file is in memory.

    Types of fields are str, int and list (of finite numbers, or of lists of them). InputError names file, row and field
    that are not as they should be.
    """
    for number, row in enumerate(_objects(path)):
        for name, kind in fields.items():
            if name not in row:
                raise InputError(f"{path}: row {number}: field {name} is missing")
            if type(row[name]) is not kind or not _is_bounded(row[name]):
                raise InputError(f"{path}: row {number}: field {name} is {row[name]!r:.60}, not {_WORDS[kind]}")
        yield row


_WORDS = {str: "text", int: "an integer", list: "a list of finite numbers"}


def _is_bounded(value: Any, depth: int = 0) -> bool:
    """Whether the numbers in lists, which hold nothing else and are no more than a few deep, are finite floats."""
    if isinstance(value, list):
        return depth < _MOST_DEPTH and all(not isinstance(each, str) and _is_bounded(each, depth + 1) for each in value)
    if type(value) is int:
        return depth == 0 or abs(value) <= _LARGEST_INTEGER
    return isinstance(value, str) or (type(value) is float and math.isfinite(value))


def _objects(path: Path) -> Iterator[dict[str, Any]]:
    decoder = json.JSONDecoder(object_pairs_hook=unique_keys)
    try:
        with path.open(encoding="utf-8") as file:
            text, position = file.read(_BLOCK).lstrip(), 1
            if not text.startswith("["):
                raise InputError(f"{path}: not a list of rows; copy it again")
            while True:
                while position < len(text) and text[position] in _BETWEEN:
                    position += 1
                if text.startswith("]", position):
                    return
                try:
                    row, position = decoder.raw_decode(text, position)
                except json.JSONDecodeError as error:
                    more = file.read(_BLOCK)
                    if not more or len(text) - position > _LARGEST_ROW:
                        raise InputError(f"{path}: cut off or not JSON ({error.msg}); copy it again") from error
                    text, position = text[position:] + more, 0
                    continue
                except ValueError as error:  # a number of thousands of digits
                    raise InputError(f"{path}: holds what is no number ({error}); copy it again") from error
                if not isinstance(row, dict):
                    raise InputError(f"{path}: holds {row!r:.60} where a row is expected")
                yield row
    except (OSError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{path}: cannot be read ({error}); copy it again") from error
