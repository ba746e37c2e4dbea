"""What other frames say about the distances of a frame: what moves, and what none of them confirms.

A surface that stands still is seen again, or hidden by a nearer one, wherever another frame looks at its place. Where
the other frame sees something farther away instead, the surface was not there at that time: it moves. Where several
frames look and none finds it at its distance, it is hardly ever there: on drives of the synthetic world, distances of
surfaces that no frame confirms are right within a tenth in 7 to 24 % of the pixels for confidences up to 0.8, those
that two of four confirm in 46 to 82 %.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import pixel_rays
from olt_generator.distance.depth import FAR_DISTANCE
from olt_generator.poses import invert
from olt_generator.views.front_view import FrontView

# Seconds to the frames that are asked: an object must have left the line of sight, and the place be still in view.
_GAPS = (-1.0, -0.4, 0.4, 1.0)
# The other frame must see at least this many times as far as the surface, or as far but for this factor.
_SEEN_THROUGH, _SAME = 1.25, 1.1
# One pixel in so many, along rows and along columns, is tried; its whole block is marked.
_BLOCK = 4
# So many frames must have looked for what none confirms to be dropped, and the confidence that is enough where fewer
# have.
_LEAST_LOOKS, _CONFIDENT = 2, 0.15


def find_moving(front: FrontView) -> NDArray[np.bool_]:
    """Pixels (n, H, W) of `front` that show something that moves, with a margin; `front.moving` is not read."""
    return np.stack([_moving(front, list(looks)) for looks in _look_again(front)])


def check_distances(front: FrontView) -> FrontView:
    """The front view with what its frames say about one another.

    To `front.moving` is added what they find to move. Confidence, where it is known, is 0 where at least two of them
    look and none confirms the distance, and where it is low and fewer look.
    """
    moving = np.empty(front.distance.shape, np.bool_)
    confidence = None if front.confidence is None else front.confidence.copy()
    for index, looks in enumerate(_look_again(front)):
        found = list(looks)
        moving[index] = _moving(front, found)
        if confidence is not None:
            confirmed = np.logical_or.reduce([look.confirmed for look in found] or [np.zeros(_size(front), np.bool_)])
            count = sum((look.tried.astype(np.uint8) for look in found), np.zeros(_size(front), np.uint8))
            unsure = confidence[index] < _CONFIDENT
            confidence[index][_enlarged(~confirmed & (count >= _LEAST_LOOKS), front)] = 0.0
            confidence[index][_enlarged(~confirmed & (count < _LEAST_LOOKS), front) & unsure] = 0.0
    if front.moving is not None:
        moving |= front.moving
    return replace(front, moving=moving, confidence=confidence)


class _Look(NamedTuple):
    """What another frame finds at the blocks (h, w) of a frame: whether it looks there, sees through, or confirms."""

    tried: NDArray[np.bool_]
    seen_through: NDArray[np.bool_]
    confirmed: NDArray[np.bool_]


def _look_again(front: FrontView) -> Iterator[Iterator[_Look]]:
    """For each frame, the looks of the others that are asked."""
    blocks = np.minimum(front.distance[:, _BLOCK // 2 :: _BLOCK, _BLOCK // 2 :: _BLOCK], np.float32(FAR_DISTANCE))
    # An edge may lie a block aside: only what lies behind all neighbours is surely looked at. On the ego vehicle
    # nothing is looked through.
    kernel = np.ones((3, 3), np.uint8)
    nearest = np.stack([cv2.erode(np.nan_to_num(each, nan=0.0), kernel) for each in blocks])
    rays, times = pixel_rays(front.camera)[_BLOCK // 2 :: _BLOCK, _BLOCK // 2 :: _BLOCK], front.trajectory.times
    offered = times[front.drawn_on]

    def look(index: int, other: int) -> _Look:
        T_other_index = invert(front.camera_poses[other]) @ front.camera_poses[index]
        points = rays * blocks[index][..., None] @ T_other_index[:3, :3].T + T_other_index[:3, 3]
        pixels, tried = front.camera.project(points)
        column, row = np.rint(pixels[tried] / _BLOCK - 0.5).astype(np.int64).clip(0).T
        row, column = np.minimum(row, rays.shape[0] - 1), np.minimum(column, rays.shape[1] - 1)
        expected = np.linalg.norm(points[tried], axis=-1)
        through, confirmed = np.zeros_like(tried), np.zeros_like(tried)
        through[tried] = nearest[other][row, column] > _SEEN_THROUGH * expected
        through &= blocks[index] < FAR_DISTANCE
        ratio = blocks[other][row, column] / np.minimum(expected, FAR_DISTANCE)
        confirmed[tried] = (ratio < _SAME) & (ratio > 1.0 / _SAME)
        return _Look(tried, through, confirmed)

    for index, time in enumerate(times):
        # Frames drawn on that are the wanted gaps away, where the clip has them.
        wanted = time + np.array(_GAPS)
        within = wanted[(wanted >= offered[0]) & (wanted <= offered[-1])]
        others = sorted(set(front.drawn_on[np.searchsorted(offered, within)].tolist()) - {index})
        yield (look(index, other) for other in others)


def _moving(front: FrontView, looks: list[_Look]) -> NDArray[np.bool_]:
    """Pixels (H, W) around the blocks that any look has seen through."""
    if not looks:
        return np.zeros(front.distance.shape[1:], np.bool_)
    kernel = np.ones((3, 3), np.uint8)
    # Single blocks are errors of distance. The middle of an object that moved by less than its size was not looked
    # through, so gaps between its parts are closed, and its outline lies around what was found.
    seen_through = np.logical_or.reduce([look.seen_through for look in looks]).astype(np.uint8)
    parts = cv2.morphologyEx(seen_through, cv2.MORPH_OPEN, kernel)
    found = cv2.dilate(cv2.morphologyEx(parts, cv2.MORPH_CLOSE, kernel, iterations=3), kernel, iterations=2)
    return _enlarged(found > 0, front)


def _size(front: FrontView) -> tuple[int, int]:
    """Rows and columns of blocks."""
    height, width = front.distance.shape[1:]
    return len(range(_BLOCK // 2, height, _BLOCK)), len(range(_BLOCK // 2, width, _BLOCK))


def _enlarged(blocks: NDArray[np.bool_], front: FrontView) -> NDArray[np.bool_]:
    """A mask of blocks (h, w) as one of pixels (H, W)."""
    size = (front.camera.width, front.camera.height)
    return cv2.resize(blocks.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
