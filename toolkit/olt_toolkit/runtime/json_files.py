"""JSON files from outside: what a parser would lose or take on trust is refused."""

import json
from pathlib import Path
from typing import Any

from olt_generator.errors import InputError
from olt_generator.files import read_bounded

MOST_BYTES = 1 << 30


def read_json(path: Path, what: str, most_bytes: int = MOST_BYTES) -> Any:
    """Read a JSON file, which errors call `what`, such as "rollout".

    Its content is left to the caller to check, and so is whether numbers are finite: Python reads NaN and Infinity.

    Raises:
        InputError: the file cannot be read or is larger than that, or see `parse_json`.
    """
    return parse_json(read_bounded(path, what, most_bytes), str(path))


def parse_json(content: bytes | str, where: str) -> Any:
    """The content of a JSON text, which errors call `where`.

    Raises:
        InputError: it is not JSON, an object has a key twice, or it is nested too deep.
    """
    try:
        return json.loads(content, object_pairs_hook=unique_keys)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
    except (ValueError, RecursionError) as error:  # ValueError: text that is not Unicode, and integers without end
        raise InputError(f"{where}: not readable as JSON ({error}); write or copy it again") from error


def unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of JSON; an `InputError` where a key comes twice, of which a parser would drop one."""
    values = dict(pairs)
    if len(values) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"key {twice!r:.60} is there twice in one object; remove one")
    return values
