"""The front camera's recording with its geometry: what other views are made from."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera
from olt_generator.errors import InputError
from olt_generator.poses import Array
from olt_generator.trajectory import Trajectory


@dataclass(frozen=True)
class FrontView:
    """Frames of the front camera, how far away everything in them is, and where the camera was.

    Attributes:
        frames: (n, H, W, 3) uint8.
        distance: (n, H, W) metres along the rays, inf for sky, NaN where nothing is known (the own vehicle).
        trajectory: n rig poses, one per frame.
        camera: front camera at the size of `frames`.
        T_rig_camera: (4, 4) its mounting.
        confidence: (n, H, W) trust in the distance, 0 to 1; None where it is not known.
        moving: (n, H, W) bool, pixels that show moving objects; None where it is not known.

    Raises:
        InputError: lengths or sizes do not agree.
    """

    frames: NDArray[np.uint8]
    distance: NDArray[np.float32]
    trajectory: Trajectory
    camera: Camera
    T_rig_camera: Array
    confidence: NDArray[np.float32] | None = None
    moving: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        if self.frames.shape[1:] != (*size, 3):
            raise InputError(
                f"frames of shape {self.frames.shape[1:]} for a front camera of {size[1]} x {size[0]}; give the camera "
                "at the size of the frames"
            )
        for what, maps in (("distance", self.distance), ("confidence", self.confidence), ("moving", self.moving)):
            if maps is not None and maps.shape != (len(self.frames), *size):
                raise InputError(f"{what} of shape {maps.shape} for {len(self.frames)} frames of {size[1]} x {size[0]}")
        if len(self.trajectory) != len(self.frames):
            raise InputError(f"{len(self.trajectory)} poses for {len(self.frames)} frames; give one pose per frame")

    def __len__(self) -> int:
        return len(self.frames)

    @cached_property
    def camera_poses(self) -> Array:
        """Poses T_world_camera (n, 4, 4)."""
        return self.trajectory.T_world_rig @ self.T_rig_camera

    @cached_property
    def path_position(self) -> Array:
        """Metres (n,) driven up to each frame."""
        steps = np.linalg.norm(np.diff(self.trajectory.positions, axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)])
