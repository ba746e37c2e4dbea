"""What preflight says: one row a check, with what was found, where, and what to do."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any, TypeVar

from olt_generator.errors import InputError

T = TypeVar("T")
_SHOWN = 3


class Verdict(StrEnum):
    """What became of a check; one that could not look is never one that passed, and a note judges nothing."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_CHECKED = "not checked"
    NOTE = "note"


@dataclass(frozen=True)
class Row:
    """What one check says.

    Attributes:
        group: data, checkpoint, versions, disk, memory, steps or licence.
        check: name of the check.
        where: file, folder or setting that it looked at.
        found: what was found, or why nothing could be looked at.
        action: what to do about it; empty where nothing is to be done.
    """

    group: str
    check: str
    where: str
    verdict: Verdict
    found: str
    action: str = ""


@dataclass(frozen=True)
class PreflightReport:
    """All rows, in the order in which they were looked at, and the seconds that it took."""

    rows: tuple[Row, ...]
    seconds: float

    @property
    def failures(self) -> tuple[Row, ...]:
        """The rows that failed."""
        return tuple(row for row in self.rows if row.verdict is Verdict.FAILED)

    def count(self, verdict: Verdict) -> int:
        """How many rows have this verdict."""
        return sum(row.verdict is verdict for row in self.rows)

    def to_dict(self) -> dict[str, Any]:
        """A JSON-able object."""
        counts = {verdict.name.lower(): self.count(verdict) for verdict in Verdict}
        return {
            "ready": not self.failures,
            **counts,
            "seconds": round(self.seconds, 2),
            "rows": [asdict(row) for row in self.rows],
        }

    def refuse(self) -> None:
        """An `InputError` with the first failures where there are any."""
        if self.failures:
            shown = "; ".join(f"{row.check}: {row.where}: {row.found}; {row.action}" for row in self.failures[:_SHOWN])
            raise InputError(f"preflight: {len(self.failures)} checks failed: {shown}; `olt sft preflight` lists all")


@dataclass(frozen=True)
class RowMaker:
    """Makes the rows of one group."""

    group: str

    def passed(self, check: str, where: object, found: str) -> Row:
        """A check that holds."""
        return Row(self.group, check, str(where), Verdict.PASSED, found)

    def failed(self, check: str, where: object, found: str, action: str) -> Row:
        """A check that does not hold, and what to do."""
        return Row(self.group, check, str(where), Verdict.FAILED, found, action)

    def not_checked(self, check: str, where: object, why: str, action: str = "") -> Row:
        """A check that could not be made, and why."""
        return Row(self.group, check, str(where), Verdict.NOT_CHECKED, f"not checked because {why}", action)

    def note(self, check: str, where: object, found: str, action: str = "") -> Row:
        """Something to know, which is neither right nor wrong."""
        return Row(self.group, check, str(where), Verdict.NOTE, found, action)

    def judge(self, check: str, where: object, wrong: Sequence[str], good: str, action: str) -> Row:
        """Failed with the first of what is wrong, or passed with what is good."""
        return self.failed(check, where, name_first(wrong), action) if wrong else self.passed(check, where, good)


def name_first(problems: Sequence[str]) -> str:
    """The first problems in words, and how many more there are."""
    more = f" and {len(problems) - _SHOWN} more" if len(problems) > _SHOWN else ""
    return "; ".join(problems[:_SHOWN]) + more


def problems_of(look: Callable[[T], object], items: Iterable[T]) -> list[str]:
    """What `look` refuses (`InputError`) of the items, one text each."""
    problems = []
    for item in items:
        try:
            look(item)
        except InputError as error:
            problems.append(str(error))
    return problems
