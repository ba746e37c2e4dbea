"""Everything in a scene that stands on the ground, as boxes, and their colours where rays meet them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scenes.looks import Color, SceneryBox
from olt_closed_loop.scenes.scene import Agent
from olt_closed_loop.sensors.bodies import parts_of
from olt_closed_loop.sensors.surfaces import SURFACE_INDEX, TILE, sample_surfaces
from olt_closed_loop.sensors.textures import FloatImage, Image
from olt_generator.poses import Array, planar_pose

# Faces in the order +x, -x, +y, -y, +z, -z: the axes that run across and up the face.
FACE_ACROSS = np.array([1, 1, 0, 0, 0, 0])
FACE_UP = np.array([2, 2, 2, 2, 1, 1])


@dataclass(frozen=True)
class Boxes:
    """Boxes.

    Attributes:
        center: (n, 3) metres.
        half: (n, 3) half of length, width, height.
        axes: (n, 3, 3) rotation matrices whose columns are the directions of length, width and height.
        color: (n, 3) base colour, 0 ... 255.
        surface: (n, 6) index of the surface on each face.
        repeats: (n, 3) how often surfaces repeat along each axis.
        lit: (n,) whether the lamps on its faces are switched on.
    """

    center: Array
    half: Array
    axes: Array
    color: FloatImage
    surface: NDArray[np.int32]
    repeats: FloatImage
    lit: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.center)

    def select(self, index: NDArray[np.intp]) -> "Boxes":
        """The boxes of an index (m,)."""
        return Boxes(*(values.take(index, axis=0) for values in vars(self).values()))

    @classmethod
    def concatenate(cls, groups: "Sequence[Boxes]") -> "Boxes":
        """All boxes of some groups."""
        columns = zip(*(vars(group).values() for group in groups), strict=True)
        return cls(*(np.concatenate(column) for column in columns))

    def moved(self, pose: Array) -> "Boxes":
        """The boxes of a body, given relative to it, in the axes in which the body's pose is (4, 4)."""
        rotation = pose[:3, :3]
        center, axes = self.center @ rotation.T + pose[:3, 3], rotation @ self.axes
        return Boxes(center, self.half, axes, self.color, self.surface, self.repeats, self.lit)

    def corners(self) -> Array:
        """Corners (n, 8, 3)."""
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return self.center[:, None] + (signs * self.half[:, None]) @ np.swapaxes(self.axes, 1, 2)


_AMBIENT = 0.55

_PLAIN = (("plain", "plain", "plain", "plain"), np.inf, np.inf)
# By kind: surfaces of front, rear, sides and top, and how many metres one picture of them covers across and up. That of
# a building shows two storeys of 3 m.
_SCENERY: dict[str, tuple[tuple[str, str, str, str], float, float]] = {
    "building": (("building", "building", "building", "plain"), 9.0, 6.0),
    "crown": (("foliage", "foliage", "foliage", "foliage"), 3.0, 3.0),
    "street_light": (("lamp", "lamp", "lamp", "lamp"), np.inf, np.inf),
}


def body_boxes(agent: Agent, color: Color, lit: bool = True) -> Boxes:
    """The boxes that make up an agent, relative to the centre of its own box; a plain box for a label unknown here.

    `lit` tells whether its lamps are switched on, which shows at night.
    """
    parts = parts_of(agent)
    size = np.array([agent.length, agent.width, agent.height])
    low, high = (np.array([getattr(part, end) for part in parts]) for end in ("low", "high"))
    return Boxes(
        center=((low + high) / 2 - 0.5) * size,
        half=(high - low) / 2 * size,
        axes=np.tile(np.eye(3), (len(parts), 1, 1)),
        color=np.array([part.color or color for part in parts], dtype=np.float32),
        surface=np.array([_faces(*part.surfaces) for part in parts], dtype=np.int32),
        repeats=np.ones((len(parts), 3), dtype=np.float32),
        lit=np.full(len(parts), lit),
    )


def scenery_boxes(scenery: Sequence[SceneryBox]) -> Boxes:
    """The buildings, trees and poles."""
    size = np.array([box.size for box in scenery]).reshape(-1, 3)
    surfaces = [_SCENERY.get(box.kind, _PLAIN) for box in scenery]
    covered = np.array([[across, across, up] for _, across, up in surfaces]).reshape(-1, 3)
    # Pictures repeat as a whole, up also by halves.
    parts = np.array([1.0, 1.0, 2.0])
    return Boxes(
        center=np.array([box.center for box in scenery]).reshape(-1, 3),
        half=size / 2,
        axes=planar_pose(0.0, 0.0, np.array([box.yaw for box in scenery]))[..., :3, :3],
        color=np.array([box.color for box in scenery], dtype=np.float32).reshape(-1, 3),
        surface=np.array([_faces(*names) for names, _, _ in surfaces], dtype=np.int32).reshape(-1, 6),
        repeats=(np.maximum(np.round(parts * size / covered), 1.0) / parts).astype(np.float32),
        lit=np.ones(len(size), dtype=bool),
    )


def _faces(front: str, rear: str, side: str, top: str) -> list[int]:
    below = "lamp" if top == "lamp" else "plain"
    return [SURFACE_INDEX[name] for name in (front, rear, side, side, top, below)]


class Paint(NamedTuple):
    """What rays (n,) see of boxes: colour (n, 3) without light, light (n,) of the day, and the surface and texel there.

    `surface` (n,) is -1 where lamps are off, and `texture` (n, 4) as of `surfaces.sample_surfaces`.
    """

    color: FloatImage
    light: FloatImage
    surface: NDArray[np.int32]
    texture: Image


def paint_boxes(boxes: Boxes, box: NDArray[np.intp], offset: FloatImage, pixel_size: FloatImage, sun: Array) -> Paint:
    """What is seen where rays from the origin meet boxes, lit by a sun in direction (3,).

    The rays meet the boxes of index `box` (n,) at `offset` (3, n), where a pixel covers `pixel_size` (n,) metres.
    """
    # In the box's own axes, where it reaches from -1 to 1: the face, and the coordinates across and up that face.
    to_box = (boxes.axes / boxes.half[:, None]).astype(np.float32)
    origin = np.einsum("nij,ni->nj", boxes.axes, boxes.center) / boxes.half
    columns = [_into_box(to_box[:, :, axis], origin[:, axis].astype(np.float32), box, offset) for axis in range(3)]
    x, y, z = columns
    ax, ay, az = np.abs(x), np.abs(y), np.abs(z)
    front, top = (ax >= ay) & (ax >= az), (az > ax) & (az > ay)
    behind = np.where(front, x, np.where(top, z, y)) < 0.0
    across, up = np.where(front, y, x), np.where(top, y, z)
    entry = box * 6 + 2 * np.where(front, 0, np.where(top, 2, 1)) + behind
    repeats_across, repeats_up, density, light = _face_tables(boxes, sun)
    u = (across * np.float32(0.5) + np.float32(0.5)) * repeats_across.take(entry)
    v = (np.float32(0.5) - up * np.float32(0.5)) * repeats_up.take(entry)
    texels = pixel_size * density.take(entry)
    surface = boxes.surface.take(entry)
    texture = sample_surfaces(surface, u - np.floor(u), v - np.floor(v), texels)
    gain = texture[:, 3] * np.float32(1.0 / 128.0)
    color = boxes.color.take(box, axis=0)
    color *= gain[:, None]
    color += texture[:, :3]
    return Paint(color, light.take(entry), np.where(boxes.lit.take(box), surface, -1), texture)


def _into_box(axis: FloatImage, origin: FloatImage, box: NDArray[np.intp], offset: FloatImage) -> FloatImage:
    """Places (n,) along one axis of the boxes, scaled (boxes, 3), of points (3, n) in the boxes of index (n,)."""
    place = axis[:, 0].take(box) * offset[0]
    place += axis[:, 1].take(box) * offset[1]
    if axis[:, 2].any():
        place += axis[:, 2].take(box) * offset[2]
    return np.subtract(place, origin.take(box), out=place)


def _face_tables(boxes: Boxes, sun: Array) -> list[FloatImage]:
    """Of every face (6 n,) each: repeats of its surface across and up, texels of that per metre, and light."""
    across, up = boxes.repeats[:, FACE_ACROSS], boxes.repeats[:, FACE_UP]
    area = 4.0 * boxes.half[:, FACE_ACROSS] * boxes.half[:, FACE_UP]
    density = TILE * np.sqrt(across * up / area)
    towards = sun @ boxes.axes
    facing = np.stack([towards, -towards], axis=-1).reshape(-1, 6)
    light = _AMBIENT + (1.0 - _AMBIENT) * np.maximum(facing, 0.0) * 1.3
    return [values.astype(np.float32).ravel() for values in (across, up, density, light)]
