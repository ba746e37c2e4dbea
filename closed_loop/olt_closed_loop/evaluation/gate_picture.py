"""A picture of the gate: each scene from above, as the recorded ego drove it, and around its narrowest place."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from olt_closed_loop.evaluation.gate import GateResult
from olt_closed_loop.evaluation.margins import NarrowPlace
from olt_closed_loop.scenes.actors import corners, ego_agent
from olt_closed_loop.scenes.maps.drawing import draw_map
from olt_closed_loop.scenes.scene import Agent, Scene
from olt_closed_loop.scenes.scene_map import map_of
from olt_closed_loop.scoring.moving_boxes import agent_box
from olt_generator.files import write_whole
from olt_generator.poses import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AROUND = 15.0
"""Metres to every side of the narrowest place that are drawn."""
_EGO, _AGENT = "#1f77b4", "#d62728"


def draw_gate(path: Path, scenes: Sequence[tuple[Scene, GateResult]]) -> None:
    """Write a picture (.png, .svg or .pdf) with a row for each scene: the whole drive, and its narrowest place."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(len(scenes), 2, figsize=(12.0, 5.5 * len(scenes)), squeeze=False)
    for (scene, result), (whole, narrow) in zip(scenes, axes, strict=True):
        _draw_scene(whole, scene)
        whole.set_title(f"{scene.name}: {'holds' if result.passed else 'does NOT hold'}", fontsize=9)
        place = min(result.narrow, key=lambda place: place.metres, default=None)
        if place is None:
            narrow.set_axis_off()
            continue
        whole.plot(place.x, place.y, "o", color="black", fillstyle="none", markersize=12)
        _draw_scene(narrow, scene)
        _draw_moment(narrow, scene, place)
    figure.tight_layout()
    with write_whole(path) as temporary:
        figure.savefig(temporary, format=path.suffix.removeprefix("."), dpi=110)
    pyplot.close(figure)


def _draw_scene(axes: "Axes", scene: Scene) -> None:
    """Road, lanes and the way of the ego's box."""
    draw_map(axes, map_of(scene))
    ego = ego_agent(scene.ego, scene.vehicle)
    axes.plot(*ego.poses[:, :2].T, color=_EGO, linewidth=1.5)
    (west, south), (east, north) = ego.poses[:, :2].min(axis=0), ego.poses[:, :2].max(axis=0)
    axes.set(xlim=(west - AROUND, east + AROUND), ylim=(south - AROUND, north + AROUND), aspect="equal")


def _draw_moment(axes: "Axes", scene: Scene, place: NarrowPlace) -> None:
    """The boxes of all at the time of a narrow place, around it."""
    ego = ego_agent(scene.ego, scene.vehicle)
    for agent, color in [(ego, _EGO), *((agent, _AGENT) for agent in scene.agents)]:
        box = _outline(agent, place.time_us)
        if box is not None:
            axes.fill(*box.T, color=color, alpha=0.6)
    axes.set(xlim=(place.x - AROUND, place.x + AROUND), ylim=(place.y - AROUND, place.y + AROUND))
    axes.set_title(f"{place.metres:.2f} m to {place.what:.40} at {place.time_us * 1e-6:.1f} s", fontsize=9)


def _outline(agent: Agent, time_us: int) -> Array | None:
    """Corners (4, 2) of an agent's box at a time; None if it is not there."""
    box, moment = agent_box(agent), np.array([time_us])
    return corners(box.at(moment), box.half_size)[0] if box.covers(moment)[0] else None
