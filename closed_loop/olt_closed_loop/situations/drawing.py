"""Pictures of situations, seen from above, and of sweeps."""

from collections.abc import Sequence
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from olt_closed_loop.rollouts.rollout_record import RolloutRecord
from olt_closed_loop.scenes.actors import corners
from olt_closed_loop.scoring.moving_boxes import MovingBox, agent_box, ego_box
from olt_closed_loop.situations.situation import PARTNER
from olt_closed_loop.situations.sweeps import Sweep
from olt_closed_loop.situations.table import SITUATIONS, Row
from olt_generator.files import write_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

VERDICTS = {True: "at fault", False: "not at fault", None: "no contact"}
_COLORS = {True: "#c0392b", False: "#1e8449", None: "#7f8c8d"}
_COLUMNS = 6
_WINDOW = 24.0
_BEFORE_US = (3_000_000, 2_000_000, 1_000_000, 0)


def draw_situations(rows: Sequence[Row], path: Path) -> None:
    """Write a picture of all situations: the last three seconds before each contact, and the verdict."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(ceil(len(rows) / _COLUMNS), _COLUMNS, figsize=(24, 2.6 * ceil(len(rows) / _COLUMNS)))
    for axis in axes.flat:
        axis.set_axis_off()
    for axis, row, situation in zip(axes.flat, rows, SITUATIONS, strict=False):
        record = situation.record()
        _draw(axis, record, 5_000_000 if row.time_us is None else row.time_us)
        axis.set_title(
            f"{row.situation}\n{VERDICTS[row.at_fault]}: {row.rule}", fontsize=7, color=_COLORS[row.at_fault]
        )
    figure.tight_layout()
    _write(figure, path)


def _draw(axis: "Axes", record: RolloutRecord, time_us: int) -> None:
    for lane in record.lanes:
        for line, style in ((lane.left, "-"), (lane.right, "-"), (lane.center, ":")):
            if line is not None:
                axis.plot(*line[:, :2].T, style, color="#bbbbbb", linewidth=0.6)
    boxes = [(ego_box(record), "#2471a3")]
    boxes += [(agent_box(agent), "#d35400" if agent.id == PARTNER else "#888888") for agent in record.agents]
    for box, color in boxes:
        _draw_box(axis, box, time_us, color)
    center = ego_box(record).at(np.array([time_us]))[0, :2]
    axis.set_xlim(center[0] - _WINDOW, center[0] + _WINDOW)
    axis.set_ylim(center[1] - 0.4 * _WINDOW, center[1] + 0.4 * _WINDOW)
    axis.set_aspect("equal")


def _draw_box(axis: "Axes", box: MovingBox, time_us: int, color: str) -> None:
    times = np.array([time_us - before for before in _BEFORE_US])
    for pose, there, shade in zip(box.at(times), box.covers(times), (0.15, 0.25, 0.4, 0.9), strict=True):
        if there:
            outline = corners(pose, box.half_size)
            axis.fill(*outline.T, color=color, alpha=shade, linewidth=0)
            axis.plot(*outline[[3, 0]].T, color="black", alpha=shade, linewidth=1)


def draw_sweeps(sweeps: Sequence[Sweep], path: Path) -> None:
    """Write a picture of where verdicts change."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot
    from matplotlib.colors import ListedColormap

    figure, axes = pyplot.subplots(2, ceil(len(sweeps) / 2), figsize=(6 * ceil(len(sweeps) / 2), 9))
    codes = {True: 0, False: 1, None: 2}
    for axis, sweep in zip(axes.flat, sweeps, strict=False):
        grid = np.array([[codes[verdict] for verdict in row] for row in sweep.verdicts])
        axis.pcolormesh(grid, cmap=ListedColormap(list(_COLORS.values())), vmin=-0.5, vmax=2.5)
        for values, ticks, labels in (
            (sweep.column_values, axis.set_xticks, axis.set_xticklabels),
            (sweep.row_values, axis.set_yticks, axis.set_yticklabels),
        ):
            shown = range(0, len(values), max(len(values) // 8, 1))
            ticks([index + 0.5 for index in shown])
            labels([f"{values[index]:.3g}" for index in shown], fontsize=7)
        axis.set(xlabel=sweep.columns, ylabel=sweep.rows, title=sweep.name)
    figure.suptitle("red: at fault, green: not at fault, grey: no contact")
    figure.tight_layout()
    _write(figure, path)


def _write(figure: "Figure", path: Path) -> None:
    from matplotlib import pyplot

    with write_whole(path) as temporary:
        figure.savefig(temporary, dpi=80, format=path.suffix.lstrip("."))
    pyplot.close(figure)
