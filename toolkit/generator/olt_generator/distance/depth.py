"""Distance to what the front camera sees, from the motion of the camera and the road plane; no learned weights.

The background is the road, the plane z = 0 of the rig, and beyond it everything at `FAR_DISTANCE`. What stands in
front of it is found in `surfaces` by a plane sweep over several frames of the clip.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera
from olt_generator.distance.background import FAR_DISTANCE, road_distance
from olt_generator.distance.ego_vehicle import find_ego_vehicle
from olt_generator.distance.metric_alignment import AffineAlignment
from olt_generator.distance.plane_sweep import PlaneSweep
from olt_generator.distance.surfaces import SurfaceFinder, Surfaces
from olt_generator.errors import InputError
from olt_generator.poses import Array
from olt_generator.progress import Progress, silent
from olt_generator.trajectory import Trajectory

__all__ = ["FAR_DISTANCE", "DistanceEstimate", "DistanceOrigin", "SweepSettings", "estimate_distance", "road_distance"]

# Share of pixels whose distance is right within a tenth, by the weight of what speaks for it (`Surfaces.knowledge`):
# measured on drives of the synthetic world, for surfaces in front of the background and for the background.
KNOWLEDGE = (0.0, 0.02, 0.05, 0.12, 0.3, 0.6, 1.0)
SURFACE_CONFIDENCE = (0.0, 0.12, 0.22, 0.42, 0.55, 0.78, 0.85)
BACKGROUND_CONFIDENCE = (0.0, 0.4, 0.6, 0.85, 0.97, 0.99, 0.99)

# Numbers (m,) of frames; None for all.
FrameIndices = Sequence[int] | NDArray[np.integer] | None


class DistanceOrigin(IntEnum):
    """Which rule gave the distance of a pixel."""

    FAR = 0
    PLANE = 1
    PARALLAX = 2
    INTERPOLATED = 3
    VEHICLE = 4
    LEARNED = 5


@dataclass(frozen=True)
class DistanceEstimate:
    """Distance along the rays of the m frames of a clip that were asked for.

    Attributes:
        distance: (m, H, W) float32 metres along each pixel's ray, NaN on the ego vehicle. Never inf: sky is not told
            from other far things.
        origin: (m, H, W) uint8, an `DistanceOrigin` per pixel.
        confidence: (m, H, W) float32, 0 to 1: about the share of such pixels whose distance is right within a tenth.
            0 where only the assumption of a background speaks for the distance, and on the ego vehicle.
        moving: (m, H, W) bool, pixels of moving objects, as far as they are noticed.
        alignment: how a network's depth was made metric; None for distances by geometry alone.
    """

    distance: NDArray[np.float32]
    origin: NDArray[np.uint8]
    confidence: NDArray[np.float32]
    moving: NDArray[np.bool_]
    alignment: AffineAlignment | None = None


@dataclass(frozen=True)
class SweepSettings:
    """How much work goes into the plane sweep.

    Attributes:
        planes: distances that are tried besides the background.
        neighbours: frames, 1 or 2, that judge each of them.
        width: columns to which wider frames are reduced.

    Raises:
        InputError: a setting is out of range.
    """

    planes: int = 24
    neighbours: int = 2
    width: int = 256

    def __post_init__(self) -> None:
        if not (4 <= self.planes <= 200 and self.neighbours in (1, 2) and self.width >= 32):
            raise InputError(f"{self}: give 4 to 200 planes, 1 or 2 neighbours and a width of at least 32")


def estimate_distance(
    frames: NDArray[np.uint8],
    camera: Camera,
    trajectory: Trajectory,
    T_rig_camera: Array,
    on_progress: Progress = silent,
    frame_indices: FrameIndices = None,
    settings: SweepSettings | None = None,
) -> DistanceEstimate:
    """Estimate the distance of every pixel of a clip.

    Close to the direction of travel, and everywhere at standstill, there is no parallax: there the background is
    assumed, with little or no confidence.

    Args:
        frames: (n, H, W, 3) uint8.
        camera, trajectory: camera of the frames at their size, and n rig poses, one per frame.
        T_rig_camera: (4, 4) pose of the camera in the rig; its height above the road scales the plane.
        on_progress: told the share of frames that are done.
        frame_indices: numbers (m,) of the frames whose distance is wanted; the others only help with them. None: all.
        settings: how much work goes into it.

    Raises:
        InputError: frames, camera and trajectory do not belong together, a frame that is not there is asked for, or
            the camera is not above the road.
    """
    if frames.shape[1:] != (camera.height, camera.width, 3):
        raise InputError(
            f"frames of shape {frames.shape[1:]} for a camera of {camera.width} x {camera.height}; resize the camera"
        )
    if len(frames) != len(trajectory):
        raise InputError(f"{len(frames)} frames for {len(trajectory)} poses; give one pose per frame")
    wanted = check_frame_indices(frame_indices, len(frames))
    settings = settings or SweepSettings()
    T_world_camera = trajectory.T_world_rig @ T_rig_camera
    road = road_distance(camera, T_rig_camera)
    vehicle = find_ego_vehicle(frames, camera, T_rig_camera, T_world_camera[:, :3, 3], road)
    factor = min(1.0, settings.width / camera.width)
    small = camera.resized(round(factor * camera.width), round(factor * camera.height))
    images = [cv2.resize(frame, (small.width, small.height), interpolation=cv2.INTER_AREA) for frame in frames]
    grey = [np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8) for image in images]
    sweep = PlaneSweep(grey, small, T_world_camera, T_rig_camera, settings.planes, settings.neighbours)
    finder = SurfaceFinder(images, grey, sweep)
    shape = (len(wanted), camera.height, camera.width)
    estimate = DistanceEstimate(
        np.empty(shape, np.float32), np.empty(shape, np.uint8), np.empty(shape, np.float32), np.empty(shape, np.bool_)
    )
    for place, index in enumerate(wanted):
        _insert(estimate, place, finder.find(int(index)), sweep.background, road)
        on_progress((place + 1) / len(wanted))
    estimate.distance[:, vehicle], estimate.origin[:, vehicle] = np.nan, DistanceOrigin.VEHICLE
    estimate.confidence[:, vehicle], estimate.moving[:, vehicle] = 0.0, False
    return estimate


def _insert(
    estimate: DistanceEstimate,
    place: int,
    surfaces: Surfaces,
    small_background: NDArray[np.float32],
    road: NDArray[np.float32],
) -> None:
    """Put the surfaces (h, w) of a frame into its place (H, W) before the background, which is taken at full size."""
    in_front = surfaces.ratio > 1.0
    confidence = np.where(
        in_front,
        np.interp(surfaces.knowledge, KNOWLEDGE, SURFACE_CONFIDENCE),
        np.interp(surfaces.knowledge, KNOWLEDGE, BACKGROUND_CONFIDENCE),
    ).astype(np.float32)
    small_origin = np.where(surfaces.measured, DistanceOrigin.PARALLAX, DistanceOrigin.INTERPOLATED).astype(np.uint8)
    in_front, distance, origin, estimate.confidence[place], moving = (
        cv2.resize(values, road.shape[::-1], interpolation=cv2.INTER_NEAREST)
        for values in (
            in_front.astype(np.uint8),
            small_background / surfaces.ratio,
            small_origin,
            confidence,
            surfaces.moving.astype(np.uint8),
        )
    )
    is_surface = in_front > 0
    estimate.distance[place] = np.where(is_surface, distance, np.minimum(road, np.float32(FAR_DISTANCE)))
    estimate.origin[place] = np.where(
        is_surface, origin, np.where(road < FAR_DISTANCE, DistanceOrigin.PLANE, DistanceOrigin.FAR)
    )
    estimate.moving[place] = moving > 0


def check_frame_indices(frame_indices: FrameIndices, count: int) -> NDArray[np.int64]:
    """Numbers (m,) of the frames that are wanted out of `count`; all where `frame_indices` is None.

    Raises:
        InputError: a number is not that of a frame.
    """
    wanted = np.arange(count) if frame_indices is None else np.asarray(frame_indices, np.int64)
    outside = (wanted < 0) | (wanted >= count)
    if outside.any():
        raise InputError(f"frame_indices: there is no frame {wanted[outside][0]} in a clip of {count}; count from 0")
    return wanted
