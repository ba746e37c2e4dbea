"""Strict access to what files of recorded drives hold; every complaint is an `InputError` that names the field.

Whoever reads the file puts its name before the complaint. Numbers are those of a drive in metres: finite, and no
farther from zero than any map projection reaches.
"""

from typing import Any, TypeVar

import numpy as np

from olt_generator.errors import InputError
from olt_generator.poses import Array

Kind = TypeVar("Kind")

FARTHEST = 1e8
"""Metres: northings of map projections end at 1e7."""
_KINDS = {dict: "an object", list: "a list", str: "a text"}


def member(holder: Any, name: str, kind: type[Kind], where: str) -> Kind:
    """The member of an object of JSON, which is called `where`.

    Raises:
        InputError: it is no object, has no such member, or that is of another kind.
    """
    if not isinstance(holder, dict) or name not in holder:
        raise InputError(f"{where}: {name} is missing")
    return expect(holder[name], kind, f"{where}: {name}")


def expect(value: Any, kind: type[Kind], where: str) -> Kind:
    """The value, an `InputError` if it is not of the kind."""
    if not isinstance(value, kind):
        raise InputError(f"{where} is not {_KINDS[kind]}")
    return value


def numbers(values: Any, where: str) -> Array:
    """Numbers of any shape; NaN for what is None.

    Raises:
        InputError: rows differ in length, or something is no number.
    """
    try:
        return np.array(values, dtype=np.float64)
    except (ValueError, TypeError, OverflowError) as error:
        raise InputError(f"{where} is not made of numbers in rows of equal length") from error


def coordinates(values: Any, where: str, columns: int = 2, fewest: int = 0) -> Array:
    """The first `columns` columns of finite rows (n, c), n >= `fewest`.

    Raises:
        InputError: there are fewer rows or columns, or a number is not finite or beyond FARTHEST.
    """
    rows = numbers(values, where)
    if rows.size == 0 and rows.ndim < 3:
        rows = np.zeros((0, columns))
    if rows.ndim != 2 or rows.shape[1] < columns or len(rows) < fewest:
        raise InputError(f"{where}: {fewest} or more rows of {columns} or more numbers are needed")
    rows = rows[:, :columns]
    wrong = ~(np.abs(rows) <= FARTHEST).all(axis=1)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(f"{where}: row {row} ({', '.join(f'{value:g}' for value in rows[row])}) is no place in metres")
    return rows
