"""What a check for leaks says: every leak, and for each rule how much was compared, how much was not, and why."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from typing import Any

from olt_datasets.tables.near_duplicate_match import Match

SHOWN = 3
NO_FINGERPRINT = "no fingerprint"
NOTHING_TO_SEE = "images too plain to compare (fog, night, a wall)"
TOO_MANY_ALIKE = "looks of more clips than are compared with one"


@dataclass(frozen=True)
class ClipPlace:
    """Which clip is meant, and the store or table that holds it."""

    clip_id: str
    scene_id: str
    split: str | None
    store: str

    def __str__(self) -> str:
        return f"clip {self.clip_id} of scene {self.scene_id} in split {self.split} ({self.store})"


@dataclass(frozen=True)
class Leak:
    """A scene that breaks a rule of `leaks.find_leaks`, and what was found, for people.

    `clips` is the clip and, where two are alike, the other one; of the first pair where there are more. `pairs` is the
    number of clips, or of pairs of clips, that break the rule in this way. `match` is how alike near-duplicates are.
    """

    rule: str
    scene_id: str
    detail: str
    clips: tuple[ClipPlace, ...] = ()
    pairs: int = 1
    match: Match | None = None

    def __str__(self) -> str:
        return f"scene {self.scene_id}: {self.detail}"


@dataclass(frozen=True)
class Comparison:
    """How far one rule, or two that look at the same, could be applied.

    Attributes:
        rule: their names.
        what: what was compared with what, in words; None where nothing was named to compare with.
        compared: number of clips, or of pairs of clips.
        not_compared: the number that could not be, by why.
        clips: number of clips for whose sake they could not be, by why.
    """

    rule: str
    what: str | None
    compared: int
    not_compared: dict[str, int] = field(default_factory=dict)
    clips: dict[str, int] = field(default_factory=dict)

    def __str__(self) -> str:
        if self.what is None:
            return f"{self.rule}: none was named"
        missed = "".join(
            f"; {count:,} not compared, {self.clips[why]:,} clips with {why}"
            for why, count in self.not_compared.items()
        )
        return f"{self.rule}: {self.compared:,} {self.what} compared{missed}"


@dataclass(frozen=True)
class LeakReport:
    """All leaks, what was compared, and why nothing was where nothing could be.

    Attributes:
        leaks: by rule and scene; the first of each rule where there are many.
        counts: number of all leaks by rule.
        comparisons: one for each rule, or two rules that look at the same.
        splits: number of clips in each split; those in none, under "none", were compared with nothing.
        empty: why there was nothing to compare, None where there was.
    """

    leaks: tuple[Leak, ...]
    counts: dict[str, int]
    comparisons: tuple[Comparison, ...]
    splits: dict[str, int]
    empty: str | None

    @property
    def not_compared(self) -> tuple[str, ...]:
        """A sentence for everything that a rule should have compared and could not."""
        return tuple(str(each) for each in self.comparisons if each.not_compared)

    @property
    def is_complete(self) -> bool:
        """Whether something was compared, and everything that should have been."""
        return self.empty is None and not self.not_compared

    def to_dict(self) -> dict[str, Any]:
        """The report as JSON has it."""
        return {
            "clean": not self.leaks and self.is_complete,
            "complete": self.is_complete,
            "empty": self.empty,
            "splits": self.splits,
            "leak_counts": self.counts,
            "comparisons": [asdict(each) for each in self.comparisons],
            "leaks": [asdict(each) for each in self.leaks],
        }


def word_report(report: LeakReport, shown: int, rest: str = "olt data check --leaks FILE") -> list[str]:
    """Lines for people: the leaks, of which so many are shown, where the `rest` is, and what was compared."""
    total = sum(report.counts.values())
    if report.leaks:
        lines = [f"{total:,} leaks: {', '.join(f'{count:,} {rule}' for rule, count in report.counts.items())}"]
    elif report.empty is not None:
        lines = [f"nothing was compared: {report.empty}"]
    else:
        lines = ["no leaks in what was compared"]
    told = report.leaks[:shown]
    lines += [f"  {leak.rule}: {leak}" for leak in told]
    if total > len(told):
        lines.append(f"  and {total - len(told):,} more; {rest} lists them")
    held = ", ".join(f"{count:,} {split}" for split, count in report.splits.items())
    return [*lines, f"clips by split: {held or 'none'}", *map(str, report.comparisons)]


def summarize_leaks(report: LeakReport) -> str:
    """One line that names the first few leaks and counts the rest."""
    shown, total = "; ".join(map(str, report.leaks[:SHOWN])), sum(report.counts.values())
    return shown if total <= SHOWN else f"{shown}; and {total - SHOWN} more (`olt data check --leaks FILE` lists them)"


def join_reports(reports: Iterable[LeakReport], splits: dict[str, int], empty: str | None) -> LeakReport:
    """One report of several, with the counts of each rule added up."""
    reports = list(reports)
    comparisons: dict[str, Comparison] = {}
    for each in (comparison for report in reports for comparison in report.comparisons):
        before = comparisons.get(each.rule, Comparison(each.rule, each.what, 0))
        comparisons[each.rule] = Comparison(
            each.rule,
            before.what or each.what,
            before.compared + each.compared,
            _add(before.not_compared, each.not_compared),
            # A clip stands in several comparisons and is one clip.
            {why: max(before.clips.get(why, 0), count) for why, count in (before.clips | each.clips).items()},
        )
    leaks = tuple(leak for report in reports for leak in report.leaks)
    counts = sum((Counter(report.counts) for report in reports), Counter())
    return LeakReport(leaks, dict(counts), tuple(comparisons.values()), splits, empty)


def _add(first: dict[str, int], second: dict[str, int]) -> dict[str, int]:
    return {why: first.get(why, 0) + second.get(why, 0) for why in first | second}
