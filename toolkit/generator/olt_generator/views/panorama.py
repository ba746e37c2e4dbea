"""What the surroundings look like in every direction, at a coarse scale: the last resort for pixels no frame shows.

Road, roofs and sky run on along the horizon far more than up and down. So colours are gathered by direction in cells
that are wide in azimuth and narrow in elevation, and what is missing comes from its neighbours.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera, pixel_rays
from olt_generator.poses import Array
from olt_generator.views.fill import interpolate

# Cells around the whole horizon, and between the elevations of +- 60 degrees; what is steeper falls in the last row.
_COLUMNS, _ROWS = 48, 120
_CELL_WIDTH, _CELL_HEIGHT = 2.0 * np.pi / _COLUMNS, np.radians(120.0) / _ROWS

# What no frame shows is as its neighbours are, and by this share as all that is known at about its elevation, within a
# Gaussian of so many rows. Without that, a cloud or a house at the edge of the known would be drawn out far beyond it.
# Far from all that is known, from the first to the second angle, only the mean is left.
_SHARE_OF_MEAN, _ROW_SIGMA = 0.3, 2.0
_NEAR, _FAR = np.radians(60.0), np.radians(120.0)
# Known cells around a row that make a good mean.
_ENOUGH = 4.0

# Of images, which are only averaged, one pixel in so many is enough, along rows and along columns; of the view as many
# as leave this number to each cell's height.
_FRONT_STEP, _PIXELS_A_CELL = 4, 2.0


class DirectionCells:
    """Pixels sorted into cells by their direction in the rig.

    Attributes:
        above_horizon: (H, W) bool, pixels whose rays rise.
    """

    def __init__(self, rays_rig: Array, middle: Array) -> None:
        """Cells of pixels with rays (H, W, 3) in the rig; the panorama's middle lies in direction (3,) `middle`."""
        x, y, z = np.moveaxis(rays_rig, -1, 0)
        azimuth = np.arctan2(middle[0] * y - middle[1] * x, middle[0] * x + middle[1] * y)
        elevation = np.arctan2(z, np.hypot(x, y))
        self.above_horizon = z > 0.0
        self._column = (0.5 * (_COLUMNS - 1) - azimuth / _CELL_WIDTH).clip(0, _COLUMNS - 1).astype(np.float32)
        self._row = (0.5 * (_ROWS - 1) - elevation / _CELL_HEIGHT).clip(0, _ROWS - 1).astype(np.float32)
        self._cell = np.rint(self._row).astype(np.int64) * _COLUMNS + np.rint(self._column).astype(np.int64)

    def mean(self, image: NDArray[np.uint8], known: NDArray[np.bool_]) -> tuple[Array, NDArray[np.bool_]]:
        """Mean colour (rows, columns, 3) of the known (H, W) pixels of an image by cell, and which cells have any."""
        cell, colours = self._cell[known], image[known]
        count = np.bincount(cell, minlength=_ROWS * _COLUMNS)
        total = np.stack([np.bincount(cell, channel, _ROWS * _COLUMNS) for channel in colours.T], axis=-1)
        mean = total / np.maximum(count, 1)[:, None]
        return mean.reshape(_ROWS, _COLUMNS, 3), (count > 0).reshape(_ROWS, _COLUMNS)

    def look_up(self, cells: NDArray[np.float32]) -> NDArray[np.float32]:
        """The colours (H, W, 3) of a panorama (rows, columns, 3) as the camera sees it."""
        smooth = cv2.remap(cells, self._column, self._row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(smooth, np.float32)


class Panorama:
    """The surroundings of a camera that was not there, from what is known of its image and from the front image."""

    def __init__(self, target: Camera, T_rig_target: Array, front: Camera, T_rig_front: Array) -> None:
        """Cameras and their mountings (4, 4)."""
        target_rays = pixel_rays(target) @ T_rig_target[:3, :3].T
        front_rays = pixel_rays(front)[::_FRONT_STEP, ::_FRONT_STEP] @ T_rig_front[:3, :3].T
        self._target = DirectionCells(target_rays, T_rig_target[:3, 2])
        step = max(1, int(target.pixels_per_radian[1] * _CELL_HEIGHT / _PIXELS_A_CELL))
        self._few = np.s_[::step, ::step]
        self._few_target = DirectionCells(target_rays[self._few], T_rig_target[:3, 2])
        self._front = DirectionCells(front_rays, T_rig_target[:3, 2])

    def background(
        self,
        image: NDArray[np.uint8],
        visible: NDArray[np.bool_],
        far: NDArray[np.bool_],
        front_image: NDArray[np.uint8],
        front_visible: NDArray[np.bool_],
        front_far: NDArray[np.bool_],
    ) -> NDArray[np.float32] | None:
        """Smooth colours (h, w, 3) for the whole target image; None where nothing is known.

        What no frame shows above the horizon is taken to be sky, so there only what is far away lends its colours.
        Given are the target image (h, w, 3) and its pixels (h, w) that are known and that show far things, and the
        same of the front camera (H, W).
        """
        few = self._few
        mean, known = self._few_target.mean(image[few], visible[few] & (far[few] | ~self._few_target.above_horizon))
        few = np.s_[::_FRONT_STEP, ::_FRONT_STEP]
        lends = front_visible[few] & (front_far[few] | ~self._front.above_horizon)
        front_mean, front_known = self._front.mean(front_image[few], lends)
        if not (known | front_known).any():
            return None
        cells, filled = np.where(known[..., None], mean, front_mean), known | front_known
        return self._target.look_up(_towards_mean(interpolate(cells, filled), cells, filled))


def _towards_mean(smooth: NDArray[np.float32], cells: Array, known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Smooth colours (rows, columns, 3), where unknown moved towards the mean of the known cells around each row."""
    total = np.where(known[..., None], cells, 0.0).sum(axis=1)
    values = cv2.GaussianBlur(np.column_stack([total, known.sum(axis=1)]), (1, 0), sigmaX=1.0, sigmaY=_ROW_SIGMA)
    count = values[:, 3:]
    mean = values[:, :3] / np.maximum(count, 1e-6)
    columns = np.arange(_COLUMNS)
    away = _CELL_WIDTH * np.abs(columns[:, None] - np.flatnonzero(known.any(axis=0))).min(axis=1)
    share = _SHARE_OF_MEAN + (1.0 - _SHARE_OF_MEAN) * np.clip((away - _NEAR) / (_FAR - _NEAR), 0.0, 1.0)
    share = np.where(known, 0.0, share * np.minimum(count / _ENOUGH, 1.0))[..., None]
    return ((1.0 - share) * smooth + share * mean[:, None]).astype(np.float32)
