"""What a report page is made of."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from olt_toolkit.runtime.console import format_cell


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str
    kind: str = "text"


@dataclass(frozen=True)
class Bullets:
    """A list of sentences."""

    items: Sequence[str]
    kind: str = "bullets"


@dataclass(frozen=True)
class Table:
    """A table; a cell that is None reads "not measured"."""

    columns: Sequence[str]
    rows: Sequence[Sequence[object]]
    caption: str = ""
    kind: str = "table"

    @property
    def cells(self) -> list[list[str]]:
        """The rows as text."""
        return [[format_cell(cell) for cell in row] for row in self.rows]


@dataclass(frozen=True)
class Picture:
    """A picture as a data address, so that the page needs no other file."""

    source: str
    caption: str
    kind: str = "picture"

    @classmethod
    def from_file(cls, path: Path, caption: str) -> "Picture":
        """Embed a PNG or JPEG file."""
        kind = "jpeg" if path.suffix in (".jpg", ".jpeg") else "png"
        return cls(f"data:image/{kind};base64," + base64.b64encode(path.read_bytes()).decode(), caption)

    @classmethod
    def from_svg(cls, svg: str, caption: str) -> "Picture":
        """Embed a drawing."""
        return cls("data:image/svg+xml;base64," + base64.b64encode(svg.encode()).decode(), caption)


@dataclass(frozen=True)
class DrivenPath:
    """The motion of one box over the frames of an animation.

    Attributes:
        label: what the legend calls it; boxes without one are not in the legend.
        color: a CSS colour.
        length, width: box size in metres; offset: how far the box centre lies ahead of the pose.
        poses: one [x, y, yaw] a frame, None where the box does not exist.
        events: {frame: what happened there}, drawn as a cross.
    """

    label: str
    color: str
    length: float
    width: float
    offset: float
    poses: Sequence[Sequence[float] | None]
    events: dict[int, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Rollouts:
    """Bird's-eye rollouts of one scene, drawn on a canvas that follows the first path.

    Attributes:
        step_seconds: time between frames.
        areas: closed outlines [[x, y], ...] of the drivable surface.
        lines, route: polylines [[x, y], ...] of lane borders, and the one to follow.
        paths: the ego of every rollout first, the agents in `agents`.
    """

    title: str
    caption: str
    step_seconds: float
    areas: Sequence[Sequence[Sequence[float]]]
    lines: Sequence[Sequence[Sequence[float]]]
    route: Sequence[Sequence[float]]
    paths: Sequence[DrivenPath]
    agents: Sequence[DrivenPath]
    kind: str = "rollouts"

    @property
    def data(self) -> dict[str, Any]:
        """What the page's script draws, coordinates rounded to centimetres."""
        return {
            "step": self.step_seconds,
            "areas": [_round_points(area) for area in self.areas],
            "lines": [_round_points(line) for line in self.lines],
            "route": _round_points(self.route),
            "paths": [_path_data(path) for path in self.paths],
            "agents": [_path_data(path) for path in self.agents],
        }


Block = Text | Bullets | Table | Picture | Rollouts


@dataclass(frozen=True)
class Section:
    """A heading and what stands under it."""

    title: str
    blocks: Sequence[Block]


def _round_points(points: Sequence[Sequence[float]]) -> list[list[float]]:
    return [[round(float(x), 2), round(float(y), 2)] for x, y in points]


def _path_data(path: DrivenPath) -> dict[str, Any]:
    poses = [None if pose is None else [round(float(value), 3) for value in pose] for pose in path.poses]
    box = {"length": path.length, "width": path.width, "offset": path.offset}
    return {"label": path.label, "color": path.color, "poses": poses, "events": path.events, **box}
