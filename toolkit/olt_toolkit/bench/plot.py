"""Draws the report of a benchmark: error against run time."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LABEL_HEIGHT = 0.16
"""Inches that one label takes up."""


def plot_benchmark(report: dict[str, Any], path: Path) -> None:
    """Draw error against median run time, both logarithmic, with the Pareto front; an error of 0 sits on the floor.

    Labels stand in a column beside the axes, so that they stay apart where settings are equally fast or good.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    rows = report["settings"]
    positive = [row["error"] for row in rows if row["error"] > 0]
    floor = min(positive) / 10 if positive else 1.0
    height = max(5.0, 1.5 + LABEL_HEIGHT * len(rows))
    figure, axes = pyplot.subplots(figsize=(10, height), layout="constrained")
    for row in rows:
        spread = [[row["median_s"] - row["first_quartile_s"]], [row["third_quartile_s"] - row["median_s"]]]
        marker = "s" if row["default"] else "o"
        axes.errorbar(*_point(row, floor), xerr=spread, fmt=marker, color=_color(row), capsize=2)
    front = sorted(_point(row, floor) for row in rows if row["pareto"])
    axes.plot(*zip(*front, strict=True), color="tab:blue", lw=1)
    axes.set(xscale="log", yscale="log", xlabel="median run time (s)")
    axes.set_ylabel(f"{report['error_name']} ({report['error_unit']})")
    axes.margins(0.1)
    axes.grid(True, which="both", alpha=0.3)
    _label_points(axes, rows, floor, LABEL_HEIGHT / (height - 1.0))
    figure.suptitle(report["title"], fontsize="medium")
    figure.savefig(path, dpi=120, metadata={"Software": None})
    pyplot.close(figure)


def spread_out(wanted: Sequence[float], gap: float) -> list[float]:
    """Places near the wanted ones, highest first, that are `gap` apart and between 0 and 1 if there is room for all."""
    places: list[float] = []
    for place in wanted:
        places.append(min([place, *(above - gap for above in places[-1:])]))
    lowest = 0.0
    for index in reversed(range(len(places))):
        places[index] = max(places[index], lowest)
        lowest = places[index] + gap
    return places


def _label_points(axes: "Axes", rows: Sequence[dict[str, Any]], floor: float, gap: float) -> None:
    """Name the points in a column at the right, `gap` axes heights apart, each joined to its point by a thin line."""
    to_axes = axes.transData + axes.transAxes.inverted()
    placed = sorted(
        ((to_axes.transform(_point(row, floor))[1], row) for row in rows),
        key=lambda pair: (-pair[0], pair[1]["median_s"]),
    )
    for height, (_, row) in zip(spread_out([wanted for wanted, _ in placed], gap), placed, strict=True):
        axes.annotate(
            row["setting"] + (" (error 0)" if row["error"] == 0 else "") + (" [default]" if row["default"] else ""),
            _point(row, floor),
            xytext=(1.03, height),
            textcoords="axes fraction",
            verticalalignment="center",
            fontsize=8,
            arrowprops={
                "arrowstyle": "-",
                "relpos": (0.0, 0.5),  # lines end where the label begins
                "color": _color(row),
                "linewidth": 0.5,
                "alpha": 0.6,
            },
        )


def _point(row: dict[str, Any], floor: float) -> tuple[float, float]:
    return row["median_s"], max(row["error"], floor)


def _color(row: dict[str, Any]) -> str:
    return "tab:blue" if row["pareto"] else "tab:gray"
