"""The ideal perspective camera."""

from dataclasses import dataclass

import numpy as np

from olt_generator.errors import InputError
from olt_generator.lenses.camera_model import FocalCamera, Mask, inside_image
from olt_generator.poses import Array

# Depth in metres from which a point lies in front of a camera whose image is flat.
NEAREST_DEPTH = 1e-9
# Perspective stretches without bound towards 180 degrees.
WIDEST_FIELD_OF_VIEW = np.radians(175.0)


@dataclass(frozen=True)
class PinholeCamera(FocalCamera):
    """An ideal perspective camera."""

    @classmethod
    def from_field_of_view(cls, width: int, height: int, horizontal_fov: float) -> "PinholeCamera":
        """A centred camera with square pixels and the given horizontal field of view in radians.

        Raises:
            InputError: the field of view is not between 0 and 175 degrees.
        """
        if not 0.0 < horizontal_fov < WIDEST_FIELD_OF_VIEW:
            raise InputError(
                f"field of view {np.degrees(horizontal_fov):.1f} degrees: a pinhole camera needs more than 0 and less "
                "than 175; use an f-theta camera for wider lenses"
            )
        focal = 0.5 * width / np.tan(0.5 * horizontal_fov)
        return cls(width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))

    def project(self, points_camera: Array) -> tuple[Array, Mask]:
        """See `Camera.project`."""
        z = points_camera[..., 2]
        in_front = z > NEAREST_DEPTH
        safe = np.where(in_front, z, 1.0)
        pixels = np.empty((*z.shape, 2))
        with np.errstate(invalid="ignore", over="ignore"):
            u = self.fx * points_camera[..., 0] / safe + self.cx
            v = self.fy * points_camera[..., 1] / safe + self.cy
        pixels[..., 0], pixels[..., 1] = u, v
        return pixels, in_front & inside_image(u, v, self.width, self.height)

    def rays(self, pixels: Array) -> Array:
        """See `Camera.rays`; every pixel has one."""
        x = (pixels[..., 0] - self.cx) / self.fx
        y = (pixels[..., 1] - self.cy) / self.fy
        ray = np.stack([x, y, np.ones_like(x)], axis=-1)
        return ray / np.linalg.norm(ray, axis=-1, keepdims=True)
