"""The findings of many clips, counted by check, with the worst of each; what failed is kept one by one."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from typing import Any

from olt_toolkit.clips.verification.findings import Finding, Verdict

_REASONS = 3  # examples of why something was not compared, for each check


@dataclass
class CheckTally:
    """What became of one check: how often it passed, failed and could not be made, and the worst that it measured.

    `not_compared` holds examples of reasons; `worst` is the finding nearest to its limit, or furthest beyond it.
    """

    counts: Counter[Verdict] = field(default_factory=Counter)
    not_compared: list[Finding] = field(default_factory=list)
    worst: Finding | None = None

    def add(self, finding: Finding) -> None:
        """Count a finding."""
        self.counts[finding.verdict] += 1
        if finding.verdict is Verdict.NOT_COMPARED and len(self.not_compared) < _REASONS:
            self.not_compared.append(finding)
        if finding.measured is not None and (self.worst is None or _badness(finding) > _badness(self.worst)):
            self.worst = finding

    def merge(self, other: "CheckTally") -> None:
        """Add what another one counted."""
        self.counts += other.counts
        self.not_compared = [*self.not_compared, *other.not_compared][:_REASONS]
        if other.worst is not None and (self.worst is None or _badness(other.worst) > _badness(self.worst)):
            self.worst = other.worst


@dataclass
class Report:
    """Tallies by check, all failures, and how many clips (or files of a table) were looked at."""

    tallies: dict[str, CheckTally] = field(default_factory=dict)
    failures: list[Finding] = field(default_factory=list)
    clips: int = 0

    def add(self, findings: Iterable[Finding]) -> "Report":
        """Count findings; the same one twice counts once."""
        for finding in dict.fromkeys(findings):
            self.tallies.setdefault(finding.check, CheckTally()).add(finding)
            if finding.verdict is Verdict.FAILED:
                self.failures.append(finding)
        return self

    def merge(self, other: "Report") -> "Report":
        """Add what another report counted."""
        for check, tally in other.tallies.items():
            self.tallies.setdefault(check, CheckTally()).merge(tally)
        self.failures += other.failures
        self.clips += other.clips
        return self

    def count(self, verdict: Verdict) -> int:
        """How many findings have this verdict."""
        return sum(tally.counts[verdict] for tally in self.tallies.values())

    def to_dict(self) -> dict[str, Any]:
        """A JSON-able object."""
        return {
            "clips": self.clips,
            **{verdict.name.lower(): self.count(verdict) for verdict in Verdict},
            "checks": {
                check: {
                    **{verdict.name.lower(): tally.counts[verdict] for verdict in Verdict},
                    "worst": None if tally.worst is None else asdict(tally.worst),
                    "reasons_not_compared": [asdict(finding) for finding in tally.not_compared],
                }
                for check, tally in self.tallies.items()
            },
            "failures": [asdict(finding) for finding in self.failures],
        }


def _badness(finding: Finding) -> float:
    """Order of findings of one check: failures first, then by the share of the limit that was measured."""
    assert finding.measured is not None
    share = finding.measured / finding.limit if finding.limit else finding.measured
    return share + (1e9 if finding.verdict is Verdict.FAILED else 0.0)
