"""The front camera's recording with its geometry: what other views are made from."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera
from olt_generator.errors import InputError
from olt_generator.poses import Array
from olt_generator.trajectory import Trajectory
from olt_generator.views.lookback import lookback_frame


@dataclass(frozen=True)
class FrontView:
    """Frames of the front camera, how far away everything in them is, and where the camera was.

    Attributes:
        frames: (n, H, W, 3) uint8.
        distance: (n, H, W) metres along the rays, inf for sky, NaN where nothing is known (the ego vehicle).
        trajectory: n rig poses, one per frame.
        camera: front camera at the size of `frames`.
        T_rig_camera: (4, 4) its mounting.
        confidence: (n, H, W) trust in the distance, 0 to 1; None where it is not known.
        moving: (n, H, W) bool, pixels that show moving objects; None where it is not known.
        sources: (s,) int, increasing, the frames that views of other moments may draw on; None for all.
        numbers: (n,) int, increasing, which frame of the video each of them is; None where they are all of it.

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
    sources: NDArray[np.int64] | None = None
    numbers: NDArray[np.int64] | None = None

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

    def trust(self, index: int) -> NDArray[np.float32] | None:
        """Confidence (H, W) in the distances of a frame, 0 where something moves; None where it is not known."""
        if self.confidence is None or self.moving is None:
            return self.confidence if self.confidence is None else self.confidence[index]
        return np.where(self.moving[index], np.float32(0.0), self.confidence[index])

    @cached_property
    def camera_poses(self) -> Array:
        """Poses T_world_camera (n, 4, 4)."""
        return self.trajectory.T_world_rig @ self.T_rig_camera

    @cached_property
    def drawn_on(self) -> NDArray[np.int64]:
        """Numbers (s,) of the frames that views of other moments may draw on."""
        return np.arange(len(self)) if self.sources is None else self.sources

    def look_back(self, index: int, offset: int) -> int:
        """The frame `offset` latent frames of the video before frame `index` (`lookback`).

        Raises:
            InputError: it is not among the frames.
        """
        numbers = np.arange(len(self)) if self.numbers is None else self.numbers
        wanted = lookback_frame(int(numbers[index]), offset)
        found = int(np.searchsorted(numbers, wanted))
        if found == len(numbers) or numbers[found] != wanted:
            raise InputError(f"frame {wanted} of the video, to which frame {numbers[index]} looks back, is not there")
        return found

    @cached_property
    def path_position(self) -> Array:
        """Metres (n,) driven up to each frame, along straight lines between the frames drawn on."""
        steps = np.linalg.norm(np.diff(self.trajectory.positions[self.drawn_on], axis=0), axis=1)
        driven = np.concatenate([[0.0], np.cumsum(steps)])
        return np.interp(self.trajectory.times, self.trajectory.times[self.drawn_on], driven)
