"""Line drawings for report pages, as SVG text."""

import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from olt_generator.trajectory import Trajectory


def draw_trajectory(raw: Trajectory, smoothed: Trajectory, reference: Trajectory | None) -> str:
    """The path seen from above and the speed over time, before and after smoothing, beside the truth where known."""
    figure, (path, speed) = _make_figure(2, (10, 3.6))
    curves = [("odometry", raw, "tab:orange", 1.0), ("smoothed", smoothed, "tab:blue", 1.8)]
    if reference is not None:
        curves.insert(0, ("reference", reference, "0.5", 3.0))
    for label, trajectory, color, width in curves:
        positions = trajectory.in_first_frame().positions
        path.plot(positions[:, 0], positions[:, 1], color=color, lw=width, label=label)
        speeds = np.linalg.norm(np.diff(positions, axis=0), axis=1) / np.diff(trajectory.times)
        speed.plot(trajectory.times[1:], speeds, color=color, lw=width, label=label)
    path.set(title="path from above", xlabel="forward (m)", ylabel="left (m)")
    path.set_aspect("equal", adjustable="datalim")
    speed.set(title="speed", xlabel="time (s)", ylabel="m/s", ylim=(0, None))
    path.legend(fontsize=8)
    return _to_svg(figure)


def draw_losses(curves: Sequence[tuple[str, Sequence[float]]], title: str) -> str:
    """Training losses over steps, one named curve each."""
    figure, (axes,) = _make_figure(1, (5, 3.2))
    for label, losses in curves:
        axes.plot(np.arange(1, len(losses) + 1), losses, lw=1.2, label=label)
    axes.set(title=title, xlabel="step", ylabel="loss")
    axes.legend(fontsize=8)
    return _to_svg(figure)


def _make_figure(panels: int, size: tuple[float, float]) -> tuple[Any, Sequence[Any]]:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, panels, figsize=size, layout="constrained", squeeze=False)
    for panel in axes[0]:
        panel.grid(True, alpha=0.3)
    return figure, axes[0]


def _to_svg(figure: Any) -> str:
    from matplotlib import pyplot

    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    pyplot.close(figure)
    return text.getvalue()
