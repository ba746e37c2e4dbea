"""What a component registers so that `olt bench` can hold its error against its run time."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any


@dataclass(frozen=True)
class Setting:
    """One way of doing the work; the default is the one that the project uses.

    `prepare` builds the input and returns the call that is timed, which returns plain arrays or numbers.
    """

    name: str
    prepare: Callable[[], Callable[[], Any]]
    default: bool = False


def list_settings(
    build_input: Callable[[], object], calls: Mapping[str, Callable[[], Any]], default: str
) -> list[Setting]:
    """Settings of calls by name that share a cached input: it is built first, so that its time is not the calls'."""

    def prepare(call: Callable[[], Any]) -> Callable[[], Any]:
        build_input()
        return call

    return [Setting(name, partial(prepare, call), name == default) for name, call in calls.items()]


@dataclass(frozen=True)
class Grid:
    """What a component does over its stiff and extreme cases: a JSON-able object for each, and lines that sum up."""

    rows: Sequence[dict[str, Any]]
    summary: Sequence[str]


@dataclass(frozen=True)
class Benchmark:
    """Settings of one component, measured against a reference that does not use them: an entry of `olt.benchmarks`.

    Attributes:
        settings: builds the settings; called in the measuring process too, so it must give the same ones each time.
        measure_error: the error of what a setting's call returned; called once per setting.
        figures: what else is told of a setting's call, by name with unit, or None where the error says all.
        grid: drives the stiff and extreme cases, or None where the component has none.
    """

    title: str
    error_name: str
    error_unit: str
    reference: str
    settings: Callable[[], Sequence[Setting]]
    measure_error: Callable[[Any], float]
    figures: Callable[[Any], Mapping[str, float]] | None = None
    grid: Callable[[], Grid] | None = None
