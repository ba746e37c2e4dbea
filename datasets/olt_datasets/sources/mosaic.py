"""One camera's view put together from several real cameras of the same vehicle.

Every pixel is taken from the camera that sees it closest to its axis, where lenses are best. Cameras do not share one
centre, so the view is exact only for what is infinitely far: nearer things are cut or doubled at the seams. Pixels
that no camera sees stay black and are marked.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Mask, pixel_rays
from olt_generator.lenses.remap import Remapper
from olt_generator.poses import Array
from olt_toolkit.rigs.rig import MountedCamera

Image = NDArray[np.uint8]

NOBODY = -1
# Sides in pixels of the coarse image on which coverage is measured.
_COVERAGE_SIZE = (96, 54)


class Mosaic:
    """The view that a target has of several cameras of the same vehicle; the geometry is worked out once.

    Attributes:
        observed: (height, width) pixels that some camera sees.
        cameras: names of the cameras that pixels are taken from.
    """

    def __init__(self, target: MountedCamera, sources: Mapping[str, MountedCamera]) -> None:
        chosen = choose_cameras(target, sources)
        self.target = target
        self.observed: Mask = chosen != NOBODY
        # The box of the view that holds a camera's pixels and their neighbours, these pixels, and how the box is made.
        self._parts: dict[str, tuple[tuple[slice, slice], Mask, Remapper]] = {}
        for number, (name, source) in enumerate(sorted(sources.items())):
            if (chosen == number).any():
                rows, columns = (
                    slice(max(0, int(places.min()) - 1), min(count, int(places.max()) + 2))
                    for places, count in zip(np.nonzero(chosen == number), chosen.shape, strict=True)
                )
                size = columns.stop - columns.start, rows.stop - rows.start
                camera = target.camera.cropped(columns.start, rows.start, *size)
                box = rows, columns
                remapper = Remapper(source.camera, camera, _to_source(target, source))
                self._parts[name] = box, chosen[box] == number, remapper
        self.cameras = tuple(self._parts)

    @property
    def coverage(self) -> float:
        """Share of the view's pixels that some camera sees."""
        return float(self.observed.mean())

    def compose(self, images: Mapping[str, Image]) -> Image:
        """The view (height, width, 3) of one image (h, w, 3) of each of `cameras`, as large as theirs or InputError."""
        view = np.zeros((*self.observed.shape, 3), np.uint8)
        for name, (box, mask, remapper) in self._parts.items():
            view[box][mask] = remapper.remap(images[name])[mask]
        return view


def choose_cameras(target: MountedCamera, sources: Mapping[str, MountedCamera]) -> NDArray[np.int8]:
    """The camera that each pixel (height, width) of the target is taken from, by its number among the sorted names.

    It is the first where two see a pixel at equal angles from their axes, and `NOBODY` where none sees it.
    """
    best = np.full((target.camera.height, target.camera.width), -np.inf)
    chosen = np.full(best.shape, NOBODY, np.int8)
    for number, (_, source) in enumerate(sorted(sources.items())):
        rays = pixel_rays(target.camera) @ _to_source(target, source).T
        _, seen = source.camera.project(rays)
        cosine = rays[..., 2] / np.linalg.norm(rays, axis=-1)
        better = seen & (cosine > best)
        best[better], chosen[better] = cosine[better], number
    return chosen


def coverage(target: MountedCamera, sources: Mapping[str, MountedCamera]) -> float:
    """Share of the target's view that some camera sees, from a coarse grid of its pixels."""
    coarse = MountedCamera(target.camera.resized(*_COVERAGE_SIZE), target.T_rig_camera)
    return float((choose_cameras(coarse, sources) != NOBODY).mean())


def _to_source(target: MountedCamera, source: MountedCamera) -> Array:
    """Rotation (3, 3) from target to source axes."""
    return source.T_rig_camera[:3, :3].T @ target.T_rig_camera[:3, :3]
