"""Where the distances of a clip come from: geometry alone, or a network's relative depth made metric by geometry."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera, pixel_rays
from olt_generator.distance.background import FAR_DISTANCE
from olt_generator.distance.depth import (
    DistanceEstimate,
    DistanceOrigin,
    SweepSettings,
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

FrameIndices = Sequence[int] | NDArray[np.integer] | None


class DepthSource(Protocol):
    """What gives the distances of a clip."""

    def estimate(
        self,
        frames: NDArray[np.uint8],
        camera: Camera,
        trajectory: Trajectory,
        T_rig_camera: Array,
        on_progress: Progress = silent,
        frame_indices: FrameIndices = None,
    ) -> DistanceEstimate:
        """Distances of the frames that are asked for; arguments and errors are those of `depth.estimate_distance`."""
        ...


@dataclass(frozen=True)
class GeometricDepth:
    """Distances without learned weights."""

    settings: SweepSettings = field(default_factory=SweepSettings)

    def estimate(
        self,
        frames: NDArray[np.uint8],
        camera: Camera,
        trajectory: Trajectory,
        T_rig_camera: Array,
        on_progress: Progress = silent,
        frame_indices: FrameIndices = None,
    ) -> DistanceEstimate:
        """See `DepthSource.estimate`."""
        return estimate_distance(frames, camera, trajectory, T_rig_camera, on_progress, frame_indices, self.settings)


def make_metric(
    relative: Callable[[NDArray[np.int64]], list[NDArray[np.float32]]],
    frames: NDArray[np.uint8],
    camera: Camera,
    trajectory: Trajectory,
    T_rig_camera: Array,
    on_progress: Progress,
    frame_indices: FrameIndices,
) -> DistanceEstimate:
    """Distances from a network's inverse depth, with the scale and shift that fit road and parallax of the same clip.

    Args:
        relative: gives the network's maps, each (h, w), of the frames with the given numbers (m,); nearer is larger.
        frames, camera, trajectory, T_rig_camera, on_progress, frame_indices: see `depth.estimate_distance`.

    Returns:
        The network's distances, with the moving objects of the geometry and its ego vehicle left out. The confidence
        is the share of the anchors that the fit meets within a tenth.

    Raises:
        InputError: as `depth.estimate_distance` and `metric_alignment.align_affine`.
    """
    wanted = check_frame_indices(frame_indices, len(frames))
    known = estimate_distance(frames, camera, trajectory, T_rig_camera, lambda share: on_progress(0.5 * share), wanted)
    size = (camera.width, camera.height)
    values = np.stack([cv2.resize(each, size) for each in relative(wanted)]).astype(np.float32)
    cosine = np.maximum(pixel_rays(camera)[..., 2], LEAST_COSINE).astype(np.float32)
    anchors = (known.confidence >= ANCHOR_CONFIDENCE) & (known.distance < FARTHEST_ANCHOR) & (cosine > LEAST_COSINE)
    anchors &= ~known.moving
    inverse_depth = 1.0 / (known.distance * cosine)[anchors].astype(np.float64)
    alignment = align_affine(values[anchors].astype(np.float64), inverse_depth)
    distance = np.minimum(alignment.metric_depth(values, FAR_DISTANCE) / cosine, np.float32(FAR_DISTANCE))
    vehicle = known.origin == DistanceOrigin.VEHICLE
    on_progress(1.0)
    return DistanceEstimate(
        distance=np.where(vehicle, np.float32(np.nan), distance).astype(np.float32),
        origin=np.where(vehicle, DistanceOrigin.VEHICLE, DistanceOrigin.LEARNED).astype(np.uint8),
        confidence=np.where(vehicle, 0.0, alignment.agreement).astype(np.float32),
        moving=known.moving,
        alignment=alignment,
    )
