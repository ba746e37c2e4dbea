"""A rollout as one picture: from above, and over time."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from olt_closed_loop.evaluation.drive_views import DriveView, plan_deviations
from olt_closed_loop.scenes.actors import corners
from olt_closed_loop.scoring.moving_boxes import MovingBox
from olt_closed_loop.vehicle.state import STATE
from olt_generator.files import write_whole
from olt_generator.poses import Array
from olt_toolkit.policy.contract import STEP_US

if TYPE_CHECKING:
    from matplotlib.axes import Axes

EGO, RECORDED, AGENT, PLAN, BAD = "#1f6feb", "#4b5563", "#9a3412", "#f0883e", "#c4212a"
MARGIN = 25.0
"""Metres around the drive that the picture shows."""
_BOX_EVERY_US, _PLAN_EVERY_US = 2_000_000, 1_000_000
_MOST_LABELS = 8


def draw_drive(view: DriveView, path: Path) -> None:
    """Write a PNG: the drive from above, and speed, commands and deviation from the plan over time with the moments."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplot_mosaic(
        [["above", "speed"], ["above", "commands"], ["above", "deviation"]],
        figsize=(15, 8),
        width_ratios=[1.6, 1.0],
        layout="constrained",
    )
    figure.suptitle(view.title(), fontsize=11)
    _draw_from_above(axes["above"], view)
    _draw_over_time(axes["speed"], axes["commands"], axes["deviation"], view)
    with write_whole(path) as temporary:
        figure.savefig(temporary, format="png", dpi=100, metadata={"Software": None})
    pyplot.close(figure)


def outline(box: MovingBox, time_us: int) -> Array:
    """The closed outline (5, 2) of a box at a time within its own, metres."""
    return corners(box.at(np.array([time_us]))[0], box.half_size)[[0, 1, 2, 3, 0]]


def _draw_from_above(axes: "Axes", view: DriveView) -> None:
    scene, rollout = view.scene, view.rollout
    for area in scene.drivable:
        axes.fill(area[:, 0], area[:, 1], color="#e7e9ec", zorder=0)
    for lane in scene.lanes:
        for border in (lane.left, lane.right):
            axes.plot(border[:, 0], border[:, 1], color="#b6bcc4", lw=0.6, zorder=1)
    for edge in scene.road_edges:
        axes.plot(edge[:, 0], edge[:, 1], color="#57606a", lw=1.0, zorder=1)
    recorded = scene.ego.positions
    axes.plot(recorded[:, 0], recorded[:, 1], "--", color=RECORDED, lw=1.0, label="recorded path", zorder=2)
    for number, plan in enumerate(rollout.plans[:: _PLAN_EVERY_US // STEP_US]):
        axes.plot(
            plan[:, 0], plan[:, 1], color=PLAN, lw=0.6, alpha=0.6, label="plans" if not number else None, zorder=2
        )
    axes.plot(*rollout.states[:, :2].T, color=EGO, lw=1.8, label="driven path", zorder=3)
    first, last = int(rollout.timestamps_us[0]), int(rollout.timestamps_us[-1])
    for time_us in range(first, last + 1, _BOX_EVERY_US):
        _draw_boxes(axes, view, time_us)
    _draw_boxes(axes, view, last, strong=True)
    _draw_contacts(axes, view)
    low, high = rollout.states[:, :2].min(axis=0) - MARGIN, rollout.states[:, :2].max(axis=0) + MARGIN
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x (m)", ylabel="y (m)")
    axes.legend(loc="best", fontsize=8)


def _draw_boxes(axes: "Axes", view: DriveView, time_us: int, strong: bool = False) -> None:
    """All boxes at a time, the ego's with the time beside it."""
    alpha = 1.0 if strong else 0.35
    for box in view.agents.values():
        if box.covers(np.array([time_us]))[0]:
            axes.plot(*outline(box, time_us).T, color=AGENT, lw=1.0, alpha=alpha, zorder=4)
    drawn = outline(view.ego, time_us)
    axes.fill(*drawn.T, facecolor=EGO, alpha=0.5 * alpha, zorder=5)
    axes.plot(*drawn.T, color=EGO, lw=1.0, zorder=5)
    axes.annotate(
        f"{view.seconds(time_us):.0f} s", drawn[:4].mean(axis=0), (6, 6), textcoords="offset points", fontsize=7
    )


def _draw_contacts(axes: "Axes", view: DriveView) -> None:
    for moment in view.moments:
        if moment.agent_id is None or moment.agent_id not in view.agents:
            continue
        color = BAD if moment.bad else "#7d4cdb"
        axes.plot(*outline(view.ego, moment.time_us).T, color=color, lw=1.8, zorder=6)
        axes.plot(*outline(view.agents[moment.agent_id], moment.time_us).T, color=color, lw=1.8, zorder=6)
        x, y = view.ego.at(np.array([moment.time_us]), 2)[0]
        label = f"{view.seconds(moment.time_us):.2f} s: {moment.text}"
        axes.annotate(label, (x, y), (12, -18), textcoords="offset points", color=color, fontsize=8, zorder=7)


def _draw_over_time(speed: "Axes", commands: "Axes", deviation: "Axes", view: DriveView) -> None:
    rollout = view.rollout
    seconds = np.array([view.seconds(time_us) for time_us in rollout.timestamps_us])
    speed.plot(seconds, rollout.states[:, STATE.speed], color=EGO, label="driven")
    recorded = view.scene.ego
    steps = np.linalg.norm(np.diff(recorded.positions, axis=0), axis=1) / np.diff(recorded.times)
    speed.plot(recorded.times[1:], steps, "--", color=RECORDED, lw=1.0, label="recorded")
    speed.set(ylabel="speed (m/s)")
    speed.legend(fontsize=8)
    steering, acceleration = rollout.controls.T
    commands.step(seconds[:-1], acceleration, where="post", color=AGENT, label="acceleration (m/s²)")
    commands.step(seconds[:-1], np.degrees(steering), where="post", color=EGO, label="steering (°)")
    _widen(commands)
    commands.set(ylabel="commands")
    commands.legend(fontsize=8)
    deviation.plot(seconds, plan_deviations(rollout), color=PLAN)
    deviation.set(ylabel="from the plan (m)", xlabel="time (s)")
    _widen(deviation)
    deviation.set_ylim(bottom=0.0)
    for axes in (speed, commands, deviation):
        axes.grid(visible=True, alpha=0.3)
        axes.set_xlim(seconds[0], seconds[-1] + 0.1)
        for moment in view.moments:
            axes.axvline(view.seconds(moment.time_us), color=BAD if moment.bad else RECORDED, lw=0.8, ls=":")
    for moment in view.moments[:_MOST_LABELS]:
        place = view.seconds(moment.time_us), speed.get_ylim()[0]
        text = moment.text if len(moment.text) <= 45 else f"{moment.text[:42]}..."
        speed.annotate(text, place, (2, 4), textcoords="offset points", rotation=90, fontsize=7, va="bottom")


def _widen(axes: "Axes") -> None:
    """Let the axis span 0.1 at least: rounding is not to look like motion."""
    low, high = axes.get_ylim()
    room = max(0.0, 0.1 - (high - low)) / 2.0
    axes.set_ylim(low - room, high + room)
