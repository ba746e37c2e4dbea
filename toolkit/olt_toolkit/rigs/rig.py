"""Camera rigs as data: which cameras a vehicle carries, where, with which lenses.

Rig frame: x forward, y left, z up, origin on the ground under the middle of the rear axle.
"""

from dataclasses import dataclass

from olt_generator.cameras import Camera, fit_camera
from olt_generator.errors import InputError
from olt_generator.poses import Array

# Index of each camera in the policy's input (docs/formats/alpamayo.md).
CAMERA_INDEX: dict[str, int] = {
    "camera_cross_left_120fov": 0,
    "camera_front_wide_120fov": 1,
    "camera_cross_right_120fov": 2,
    "camera_rear_left_70fov": 3,
    "camera_rear_tele_30fov": 4,
    "camera_rear_right_70fov": 5,
    "camera_front_tele_30fov": 6,
}
FRONT_WIDE = "camera_front_wide_120fov"
FRONT_TELE = "camera_front_tele_30fov"
CROSS_LEFT = "camera_cross_left_120fov"
CROSS_RIGHT = "camera_cross_right_120fov"
REAR_LEFT = "camera_rear_left_70fov"
REAR_TELE = "camera_rear_tele_30fov"
REAR_RIGHT = "camera_rear_right_70fov"

# The four cameras that Alpamayo eats, in the order of their indices.
POLICY_CAMERAS: tuple[str, ...] = (CROSS_LEFT, FRONT_WIDE, CROSS_RIGHT, FRONT_TELE)


def short_name(camera: str) -> str:
    """What people call a camera: `camera_cross_left_120fov` is `cross_left`."""
    return camera.removeprefix("camera_").rpartition("_")[0]


@dataclass(frozen=True)
class VehicleDimensions:
    """Size of a vehicle in metres; the names are those of the PhysicalAI-AV table `vehicle_dimensions`."""

    length: float
    width: float
    height: float
    rear_axle_to_bbox_center: float
    wheelbase: float
    track_width: float


@dataclass(frozen=True)
class MountedCamera:
    """A camera and its pose `T_rig_camera` (4, 4) on the vehicle."""

    camera: Camera
    T_rig_camera: Array


@dataclass(frozen=True)
class Rig:
    """The cameras of a vehicle by name, its size, and a sentence for everything about them that is assumed."""

    name: str
    cameras: dict[str, MountedCamera]
    vehicle: VehicleDimensions
    assumptions: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> MountedCamera:
        """The named camera; an `InputError` where the rig has no such camera."""
        if name not in self.cameras:
            raise InputError(f"rig {self.name} has no camera {name!r}; it has {', '.join(self.cameras)}")
        return self.cameras[name]

    def fitted(self, width: int, height: int) -> "Rig":
        """The same rig with images of another size (scaled by one factor, cropped about the centre)."""
        cameras = {
            name: MountedCamera(fit_camera(mounted.camera, width, height), mounted.T_rig_camera)
            for name, mounted in self.cameras.items()
        }
        return Rig(self.name, cameras, self.vehicle, self.assumptions)


# AlpaSim's default ego box (docs/formats/alpasim.md) on the hyperion wheelbase.
DEFAULT_VEHICLE = VehicleDimensions(
    length=5.393, width=2.109, height=1.503, rear_axle_to_bbox_center=1.3965, wheelbase=2.85, track_width=1.62
)
