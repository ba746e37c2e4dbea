"""A comparison of policies as text, JSON and picture."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from olt_closed_loop.evaluation.comparison import Comparison, PairedDifference
from olt_closed_loop.evaluation.score_table import Interval, OpenInterval, ScoreRow
from olt_generator.files import write_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes

POLICY_COLUMNS = (
    "policy",
    "valid / rollouts",
    "AS (95 %)",
    "CR (95 %)",
    "km / incident (95 %)",
    "km / at fault (95 %)",
)
DIFFERENCE_COLUMNS = ("difference", "scenes", "AS (95 %)", "CR (95 %)", "clearly separated")


def policy_rows(comparison: Comparison) -> list[list[str | None]]:
    """A row of `POLICY_COLUMNS` for each policy."""
    return [
        [
            name,
            f"{row.valid} / {row.rollouts}",
            _word_value(row.alpasim_score, row.alpasim_score_interval),
            _word_value(row.collision_rate, row.collision_rate_interval),
            _word_distance(row.driven_km, row.km_between_incidents, row.km_between_incidents_interval),
            _word_distance(
                row.driven_km, row.km_between_incidents_at_fault, row.km_between_incidents_at_fault_interval
            ),
        ]
        for name, row in comparison.policies.items()
    ]


def difference_rows(differences: Sequence[PairedDifference]) -> list[list[str | None]]:
    """A row of `DIFFERENCE_COLUMNS` for each pair of policies."""
    return [
        [
            f"{difference.first} less {difference.second}",
            str(difference.scenes),
            _word_value(difference.score, difference.score_interval, "+.3f"),
            _word_value(difference.collision_rate, difference.collision_rate_interval, "+.3f"),
            "yes" if difference.separated else "no",
        ]
        for difference in differences
    ]


def save_comparison(folder: Path, comparison: Comparison, warnings: Sequence[str] = ()) -> None:
    """Write comparison.json and comparison.png into a folder, each whole or not at all."""
    folder.mkdir(parents=True, exist_ok=True)
    with write_whole(folder / "comparison.json") as temporary:
        values = comparison.to_dict() | {"warnings": list(warnings)}
        temporary.write_text(json.dumps(values, indent=2, allow_nan=False) + "\n")
    draw_comparison(comparison, folder / "comparison.png")


def draw_comparison(comparison: Comparison, path: Path) -> None:
    """Draw each policy's AS, CR and distance between incidents at fault with their intervals, as PNG.

    A value without an interval is a ring; a distance without an incident is an arrow from what it is at least, and one
    whose interval has no upper end an arrow at its value.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    names, rows = list(comparison.policies), list(comparison.policies.values())
    figure, (scores, collisions, distances) = pyplot.subplots(
        1, 3, figsize=(12, 1.6 + 0.35 * len(names)), sharey=True, layout="constrained"
    )
    for place, row in enumerate(rows):
        _draw_value(scores, place, row.alpasim_score, row.alpasim_score_interval)
        _draw_value(collisions, place, row.collision_rate, row.collision_rate_interval)
        _draw_distance(distances, place, row)
    scores.set(title="AS, 95 %", xlim=(-0.02, 1.02), yticks=range(len(names)), yticklabels=names)
    scores.set_ylim(len(names) - 0.5, -0.5)
    collisions.set(title="CR, 95 %", xlim=(-0.02, 1.02))
    distances.set(title="km between incidents at fault, 95 %", xscale="log")
    for axes in (scores, collisions, distances):
        axes.grid(True, axis="x", alpha=0.3)
    figure.suptitle(f"{comparison.scenes} scenes, definition {comparison.definition}", fontsize="medium")
    with write_whole(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110, metadata={"Software": None})
    pyplot.close(figure)


def _draw_value(axes: "Axes", place: int, value: float | None, limits: Interval | None) -> None:
    if value is None:
        axes.text(0.5, place, "not measured", ha="center", va="center", fontsize=8)
        return
    axes.plot(value, place, "o", color="tab:blue", mfc="tab:blue" if limits else "white")
    if limits:
        axes.plot(limits, (place, place), color="tab:blue", lw=1.5)


def _draw_distance(axes: "Axes", place: int, row: ScoreRow) -> None:
    value, limits = row.km_between_incidents_at_fault, row.km_between_incidents_at_fault_interval
    if limits is None:
        return
    low, high = limits
    if value is None:
        axes.plot(low, place, ">", color="tab:blue")
        return
    axes.plot(value, place, "o" if high else ">", color="tab:blue")
    axes.plot((low, high or value), (place, place), color="tab:blue", lw=1.5)


def _word_value(value: float | None, limits: Interval | None, form: str = ".3f") -> str | None:
    if value is None:
        return None
    return f"{value:{form}} ({limits[0]:{form}} to {limits[1]:{form}})" if limits else f"{value:{form}} (no interval)"


def _word_distance(driven: float, value: float | None, limits: OpenInterval | None) -> str | None:
    if limits is None:
        return None
    low, high = limits
    if value is None:
        return f"none in {driven:.3g} (at least {low:.3g})"
    return f"{value:.3g} (at least {low:.3g})" if high is None else f"{value:.3g} ({low:.3g} to {high:.3g})"
