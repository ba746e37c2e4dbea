"""Where the distances of a clip come from: geometry alone, or a network's relative depth made metric by geometry."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera, pixel_rays
from olt_generator.distance.background import FAR_DISTANCE
from olt_generator.distance.depth import (
    DistanceEstimate,
    DistanceOrigin,
    FrameIndices,
    check_frame_indices,
    estimate_distance,
)
from olt_generator.distance.metric_alignment import align_affine
from olt_generator.poses import Array
from olt_generator.progress import Progress, silent
from olt_generator.trajectory import Trajectory

# Pixels that anchor the scale: distances of geometry at least this likely to be right, and not too far to tell.
ANCHOR_CONFIDENCE = 0.5
FARTHEST_ANCHOR = 60.0
# Cosine of the angle to the optical axis below which depth along that axis says nothing about distance.
LEAST_COSINE = 0.05

DepthSource = Callable[[NDArray[np.uint8], Camera, Trajectory, Array, Progress, FrameIndices], DistanceEstimate]
"""What gives the distances of a clip; arguments and errors are those of `depth.estimate_distance`, which is one."""


class RelativeDepth(ABC):
    """A `DepthSource` by a network of relative inverse depth.

    Scale and shift are those that fit road and parallax of the same clip; the moving objects and the ego vehicle are
    those of the geometry. The confidence is the share of the anchors that the fit meets within a tenth.
    """

    @abstractmethod
    def relative_inverse_depth(
        self, frames: NDArray[np.uint8], wanted: NDArray[np.int64]
    ) -> Iterable[NDArray[np.float32]]:
        """The network's maps, each (h, w), of the wanted (m,) of the frames (n, H, W, 3); nearer is larger."""

    def __call__(
        self,
        frames: NDArray[np.uint8],
        camera: Camera,
        trajectory: Trajectory,
        T_rig_camera: Array,
        on_progress: Progress = silent,
        frame_indices: FrameIndices = None,
    ) -> DistanceEstimate:
        """See `DepthSource`; also an `InputError` where geometry and network do not agree (`align_affine`)."""
        wanted = check_frame_indices(frame_indices, len(frames))
        known = estimate_distance(
            frames, camera, trajectory, T_rig_camera, lambda share: on_progress(0.5 * share), wanted
        )
        size = (camera.width, camera.height)
        maps = self.relative_inverse_depth(frames, wanted)
        values = np.stack([cv2.resize(each, size) for each in maps]).astype(np.float32)
        cosine = np.maximum(pixel_rays(camera)[..., 2], LEAST_COSINE).astype(np.float32)
        anchors = (known.confidence >= ANCHOR_CONFIDENCE) & (known.distance < FARTHEST_ANCHOR) & (cosine > LEAST_COSINE)
        anchors &= ~known.moving
        inverse_depth = 1.0 / (known.distance * cosine)[anchors].astype(np.float64)
        alignment = align_affine(values[anchors].astype(np.float64), inverse_depth)
        depth = 1.0 / np.maximum(alignment.scale * values + alignment.shift, 1.0 / FAR_DISTANCE)
        distance = np.minimum(depth / cosine, np.float32(FAR_DISTANCE))
        vehicle = known.origin == DistanceOrigin.VEHICLE
        on_progress(1.0)
        return DistanceEstimate(
            distance=np.where(vehicle, np.float32(np.nan), distance).astype(np.float32),
            origin=np.where(vehicle, DistanceOrigin.VEHICLE, DistanceOrigin.LEARNED).astype(np.uint8),
            confidence=np.where(vehicle, 0.0, alignment.agreement).astype(np.float32),
            moving=known.moving,
            alignment=alignment,
        )
