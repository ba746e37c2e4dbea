"""YAML files written by users."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import yaml

from olt_generator.errors import InputError


def read_yaml_mapping(path: Path, what: str, keys: Iterable[str]) -> dict[Any, Any]:
    """Read a YAML file that holds a mapping, with safe tags only; keys and values are left to the caller to check.

    Errors call the file `what`, such as "recipe", and name the `keys` that it may have.

    Raises:
        InputError: the file cannot be read, is not YAML, or is not a mapping.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot read this {what} ({error}); give a YAML file") from error
    except (yaml.YAMLError, ValueError) as error:  # ValueError: a date that is none
        raise InputError(f"{path}: not YAML ({' '.join(str(error).split())})") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: a {what} is a mapping with the keys {', '.join(keys)}")
    return content
