"""A contact sheet: each scene from above, and as its front camera sees the event."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scenes.actors import corners, ego_agent
from olt_closed_loop.scenes.conditions import CLEAR_DAY, Conditions
from olt_closed_loop.scenes.scene import Agent, Scene
from olt_closed_loop.scoring.moving_boxes import agent_box
from olt_closed_loop.sensors.ray_casting import rig_sensors
from olt_generator.files import write_whole
from olt_generator.poses import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CAMERA, IMAGE_SIZE = "camera_front_wide_120fov", (320, 576)
COLUMNS = 4
AROUND = 30.0
"""Metres to every side of the ego that are drawn."""
_ROAD, _EGO, _WAY = "#dddddd", "#1f77b4", "#8fbbd9"
_COLORS = {
    "person": "#d9480f",
    "arm": "#d9480f",
    "rider": "#9c36b5",
    "animal": "#7f5539",
    "cone": "#fd7e14",
    "barrier": "#fd7e14",
    "sign_stop": "#c92a2a",
    "sign_go": "#2b8a3e",
}
_OTHER = "#495057"


def draw_suite(path: Path, scenes: Sequence[Scene], conditions: Conditions = CLEAR_DAY) -> None:
    """Write a contact sheet (.png, .svg or .pdf) of scenes, at the moment at which each ego is nearest to somebody."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    pairs = min(COLUMNS, len(scenes))
    rows = -(-len(scenes) // pairs)
    figure, axes = pyplot.subplots(
        rows, 2 * pairs, figsize=(7.2 * pairs, 2.75 * rows), squeeze=False, width_ratios=[1.0, 1.8] * pairs
    )
    for axis in axes.ravel():
        axis.set_axis_off()
    for scene, (above, front) in zip(scenes, axes.reshape(-1, 2), strict=False):
        time_us = moment_of(scene)
        _draw_from_above(above, scene, time_us)
        front.imshow(front_view(scene, time_us, conditions))
        front.set_title(f"{scene.name.removeprefix('longtail_')}, {time_us * 1e-6:.1f} s", fontsize=8)
    figure.tight_layout(pad=0.4, h_pad=1.4)
    with write_whole(path) as temporary:
        figure.savefig(temporary, format=path.suffix.removeprefix("."), dpi=70)
    pyplot.close(figure)


def moment_of(scene: Scene) -> int:
    """When to look: where the ego is slowest or nearest to the middle of those that are ahead, two seconds before."""
    ego = ego_agent(scene.ego, scene.vehicle)
    nearest, best = 5_000_000, np.inf
    for agent in scene.agents:
        box = agent_box(agent)
        times = ego.timestamps_us[box.covers(ego.timestamps_us) & (ego.timestamps_us >= 2_000_000)]
        if len(times) == 0:
            continue
        own = agent_box(ego).at(times, columns=2)
        apart = np.hypot(*(own - box.at(times, columns=2)).T)
        if apart.min() < best:
            best, nearest = float(apart.min()), int(times[np.argmin(apart)])
    return max(nearest - 2_000_000, 1_700_000)


def front_view(scene: Scene, time_us: int, conditions: Conditions = CLEAR_DAY) -> NDArray[np.uint8]:
    """The front camera's image (320, 576, 3) where the recorded ego is at a time."""
    sensors = rig_sensors(scene, conditions=conditions)
    pose = scene.ego.interpolate(np.array([time_us], dtype=np.int64))[0]
    return np.moveaxis(sensors((CAMERA,), IMAGE_SIZE, pose, time_us)[0], 0, -1)


def _draw_from_above(axes: "Axes", scene: Scene, time_us: int) -> None:
    """Road, markings, the ego's way, and everybody at a time."""
    for outline in scene.drivable:
        axes.fill(*outline[:, :2].T, color=_ROAD, linewidth=0.0)
    for lane in scene.lanes:
        for side in (lane.left, lane.right):
            axes.plot(*side[:, :2].T, color="white", linewidth=0.6)
    for crossing in scene.crossings:
        axes.fill(*crossing.outline[:, :2].T, color="white", alpha=0.7, linewidth=0.0)
    for line in scene.stop_lines:
        axes.plot(*line.points[:, :2].T, color="white", linewidth=2.0)
    ego = ego_agent(scene.ego, scene.vehicle)
    axes.plot(*ego.poses[:, :2].T, color=_WAY, linewidth=1.2)
    for agent in (ego, *scene.agents):
        box = _outline(agent, time_us)
        if box is not None:
            axes.fill(*box.T, color=_EGO if agent.id == "ego" else _COLORS.get(agent.label, _OTHER), linewidth=0.6)
    x, y = agent_box(ego).at(np.array([time_us]), columns=2)[0]
    axes.set(xlim=(x - AROUND, x + AROUND), ylim=(y - AROUND, y + AROUND), aspect="equal")


def _outline(agent: Agent, time_us: int) -> Array | None:
    """Corners (4, 2) of an agent's box at a time; None if it is not there."""
    box, moment = agent_box(agent), np.array([time_us])
    return corners(box.at(moment), box.half_size)[0] if box.covers(moment)[0] else None
