"""Camera rigs as data: which cameras a vehicle carries, where, with which lenses.

Rig frame: x forward, y left, z up, origin on the ground under the middle of the rear axle.
"""

from dataclasses import dataclass

import numpy as np

from olt_generator.cameras import Camera, FthetaCamera, fit_camera
from olt_generator.errors import InputError
from olt_generator.poses import Array, camera_pose_in_rig

# Index of each camera in the policy's input (facts sheet alpamayo_interface, section 1).
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

# The four cameras that Alpamayo eats, in the order of their indices.
POLICY_CAMERAS: tuple[str, ...] = (CROSS_LEFT, FRONT_WIDE, CROSS_RIGHT, FRONT_TELE)


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
    """The cameras of a vehicle by name, and the vehicle itself."""

    name: str
    cameras: dict[str, MountedCamera]
    vehicle: VehicleDimensions

    def __getitem__(self, name: str) -> MountedCamera:
        """The named camera.

        Raises:
            InputError: the rig has no such camera.
        """
        if name not in self.cameras:
            raise InputError(f"rig {self.name} has no camera {name!r}; it has {', '.join(self.cameras)}")
        return self.cameras[name]

    def fitted(self, width: int, height: int) -> "Rig":
        """The same rig with images of another size (scaled by one factor, cropped about the centre)."""
        cameras = {
            name: MountedCamera(fit_camera(mounted.camera, width, height), mounted.T_rig_camera)
            for name, mounted in self.cameras.items()
        }
        return Rig(self.name, cameras, self.vehicle)


# AlpaSim's default ego box (facts sheet alpasim, section 1) on the hyperion wheelbase.
DEFAULT_VEHICLE = VehicleDimensions(
    length=5.393, width=2.109, height=1.503, rear_axle_to_bbox_center=1.3965, wheelbase=2.85, track_width=1.62
)

# name: position in the rig (m); roll, pitch, yaw (deg); principal point and pixels per radian at 1920 x 1080.
# Mounting and lens figures: facts sheet source_datasets, section 1. The lens is taken as equidistant with the listed
# linear term, so that both polynomials are exact inverses of each other.
_PAV_CAMERAS: dict[str, tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float], float]] = {
    CROSS_LEFT: ((2.473, 0.938, 0.918), (-0.17, 0.44, 66.41), (964.9, 744.4), 1 / 1.065514e-3),
    FRONT_WIDE: ((1.697, -0.010, 1.443), (0.13, 0.47, -0.71), (954.2, 757.2), 1 / 1.057586e-3),
    CROSS_RIGHT: ((2.478, -0.955, 0.929), (-0.19, -1.38, -66.81), (958.4, 744.3), 1 / 1.067041e-3),
    "camera_rear_left_70fov": ((2.029, 1.039, 0.885), (0.63, 3.26, 151.40), (933.8, 557.2), 1571.28),
    "camera_rear_tele_30fov": ((0.383, 0.300, 1.434), (-0.25, 0.58, 179.19), (1032.5, 514.1), 3680.58),
    "camera_rear_right_70fov": ((2.008, -1.005, 0.896), (-0.28, 0.87, -154.69), (968.9, 553.9), 1564.08),
    FRONT_TELE: ((1.646, -0.141, 1.449), (-0.33, -0.72, -0.73), (978.4, 597.7), 3675.75),
}


def pav_rig() -> Rig:
    """The nominal seven-camera PhysicalAI-AV rig, 1920 x 1080; real clips carry their own calibration."""
    cameras = {
        name: MountedCamera(
            FthetaCamera.equidistant(1920, 1080, cx, cy, pixels_per_radian),
            camera_pose_in_rig(position, *np.radians(angles)),
        )
        for name, (position, angles, (cx, cy), pixels_per_radian) in _PAV_CAMERAS.items()
    }
    return Rig("pav", cameras, DEFAULT_VEHICLE)
