"""One camera's view put together from several real cameras of the same vehicle.

Every pixel is taken from the camera that sees it closest to its axis, where lenses are best. Cameras do not share one
centre, so the view is exact only for what lies at one distance, which is infinitely far unless it is given: nearer
things are cut or doubled at the seams. Pixels that no camera sees stay black and are marked.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Mask, pixel_rays
from olt_generator.errors import InputError
from olt_generator.lenses.remap import Remapper
from olt_generator.poses import Array
from olt_toolkit.rigs.rig import MountedCamera

Image = NDArray[np.uint8]

NOBODY = -1
# Sides in pixels of the coarse image on which coverage is measured.
_COVERAGE_SIZE = (96, 54)


class Mosaic:
    """A view of several cameras; the geometry is worked out once.

    Attributes:
        target: the camera whose view is wanted.
        observed: (height, width) pixels that some camera sees.
        cameras: names of the cameras that pixels are taken from.
    """

    def __init__(
        self, target: MountedCamera, sources: Mapping[str, MountedCamera], distance: float = float("inf")
    ) -> None:
        """Work out where the pixels come from.

        Args:
            target: camera whose view is wanted.
            sources: the real cameras by name, on the same vehicle as the target.
            distance: metres from the target at which everything is taken to be.

        Raises:
            InputError: the distance is not positive.
        """
        chosen = choose_cameras(target, sources, distance)
        self.target = target
        self.observed: Mask = chosen != NOBODY
        self._parts = {
            name: _Part(target, source, chosen == number, distance)
            for number, (name, source) in enumerate(sorted(sources.items()))
            if (chosen == number).any()
        }
        self.cameras = tuple(self._parts)

    @property
    def coverage(self) -> float:
        """Share of the view's pixels that some camera sees."""
        return float(self.observed.mean())

    def compose(self, images: Mapping[str, Image]) -> Image:
        """The view (height, width, 3) of one image (h, w, 3) of each of `cameras`.

        Raises:
            InputError: an image has not the size of its camera.
        """
        view = np.zeros((*self.observed.shape, 3), np.uint8)
        for name, part in self._parts.items():
            part.draw(view, images[name])
        return view


class _Part:
    """What one camera gives: its pixels of the view, and a box of the view that holds them and their neighbours."""

    def __init__(self, target: MountedCamera, source: MountedCamera, mask: Mask, distance: float) -> None:
        rows, columns = np.nonzero(mask)
        top, bottom = _span_with_neighbours(rows, mask.shape[0])
        left, right = _span_with_neighbours(columns, mask.shape[1])
        self._box = slice(top, bottom), slice(left, right)
        self._mask = mask[self._box]
        camera = target.camera.cropped(left, top, right - left, bottom - top)
        rotation, shift = _to_source(target, source, distance)
        self._remapper = Remapper(source.camera, camera, rotation, shift=shift)

    def draw(self, view: Image, image: Image) -> None:
        """Put the camera's pixels into the view."""
        view[self._box][self._mask] = self._remapper.remap(image)[self._mask]


def _span_with_neighbours(places: NDArray[np.int64], count: int) -> tuple[int, int]:
    """The range from one before the first to one behind the last of some places, within `count`."""
    return max(0, int(places.min()) - 1), min(count, int(places.max()) + 2)


def choose_cameras(
    target: MountedCamera, sources: Mapping[str, MountedCamera], distance: float = float("inf")
) -> NDArray[np.int8]:
    """The camera that each pixel of the target is taken from.

    Args:
        target: camera whose view is wanted.
        sources: the real cameras by name.
        distance: metres from the target at which everything is taken to be.

    Returns:
        (height, width) number of the camera among the sorted names, the first where two see a pixel at equal angles
        from their axes; `NOBODY` where none sees it.

    Raises:
        InputError: the distance is not positive.
    """
    if not distance > 0.0:
        raise InputError(f"mosaic: a distance of {distance} m; it must be above 0, or infinite")
    best = np.full((target.camera.height, target.camera.width), -np.inf)
    chosen = np.full(best.shape, NOBODY, np.int8)
    for number, (_, source) in enumerate(sorted(sources.items())):
        rotation, shift = _to_source(target, source, distance)
        points = pixel_rays(target.camera) @ rotation.T + shift
        _, seen = source.camera.project(points)
        cosine = points[..., 2] / np.linalg.norm(points, axis=-1)
        better = seen & (cosine > best)
        best[better], chosen[better] = cosine[better], number
    return chosen


def coverage(target: MountedCamera, sources: Mapping[str, MountedCamera], distance: float = float("inf")) -> float:
    """Share of the target's view that some camera sees, from a coarse grid of its pixels."""
    coarse = MountedCamera(target.camera.resized(*_COVERAGE_SIZE), target.T_rig_camera)
    return float((choose_cameras(coarse, sources, distance) != NOBODY).mean())


def _to_source(target: MountedCamera, source: MountedCamera, distance: float) -> tuple[Array, Array]:
    """Rotation from target to source axes, and the target's place there in units of the distance."""
    R_source_rig = source.T_rig_camera[:3, :3].T
    offset = target.T_rig_camera[:3, 3] - source.T_rig_camera[:3, 3]
    return R_source_rig @ target.T_rig_camera[:3, :3], R_source_rig @ offset / distance
