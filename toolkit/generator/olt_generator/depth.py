"""Distance to what the front camera sees, from the motion of the camera and the road plane; no learned weights.

The background is the road, the plane z = 0 of the rig, and beyond it everything at `FAR_DISTANCE`. Parallax between two
frames shows what stands nearer than that, and plain surfaces are interpolated from what is known around them.
"""

from dataclasses import dataclass
from enum import IntEnum

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera, pixel_rays
from olt_generator.errors import InputError
from olt_generator.fill import interpolate
from olt_generator.own_vehicle import find_own_vehicle
from olt_generator.parallax import ParallaxMatcher, choose_partners
from olt_generator.poses import Array, invert
from olt_generator.progress import Progress, silent
from olt_generator.trajectory import Trajectory

# Metres at which everything without parallax above the road is placed. Side cameras sit about 1.3 m from the front
# camera: half a degree at this distance, two pixels of a 120 degree view at 576 columns. So sky and the far end of
# the street are in effect warped by the rotation alone, and still lie within the limits of `splat`.
FAR_DISTANCE = 150.0

# How many times nearer than the background a point must be not to be taken for it: 25 cm of height over the road for a
# camera at 1.5 m.
LEAST_RATIO = 1.2


class Origin(IntEnum):
    """Which rule gave the distance of a pixel."""

    FAR = 0
    PLANE = 1
    PARALLAX = 2
    INTERPOLATED = 3
    VEHICLE = 4


@dataclass(frozen=True)
class DistanceEstimate:
    """Distance along the rays of a clip's frames.

    Attributes:
        distance: (n, H, W) float32 metres along each pixel's ray, NaN on the own vehicle. Never inf: sky is not told
            from other far things.
        origin: (n, H, W) uint8, an `Origin` per pixel.
    """

    distance: NDArray[np.float32]
    origin: NDArray[np.uint8]


def estimate_distance(
    frames: NDArray[np.uint8],
    camera: Camera,
    trajectory: Trajectory,
    T_rig_camera: Array,
    on_progress: Progress = silent,
) -> DistanceEstimate:
    """Estimate the distance of every pixel of a clip.

    Moving objects are triangulated as if they stood still: one that moves along its epipolar lines, as a car ahead
    does, comes out too near or too far; others mostly fall back to plane or far. Close to the direction of travel,
    and everywhere at standstill, there is no parallax.

    Args:
        frames: (n, H, W, 3) uint8.
        camera: camera of the frames at their size.
        trajectory: n rig poses, one per frame.
        T_rig_camera: (4, 4) pose of the camera in the rig; its height above the road scales the plane.
        on_progress: told the share of frames that are done.

    Raises:
        InputError: frames, camera and trajectory do not belong together, or the camera is not above the road.
    """
    _check_inputs(frames, camera, trajectory)
    T_world_camera = trajectory.T_world_rig @ T_rig_camera
    positions = T_world_camera[:, :3, 3]
    road = road_distance(camera, T_rig_camera)
    vehicle = find_own_vehicle(frames, camera, T_rig_camera, positions, road)

    background = np.minimum(road, np.float32(FAR_DISTANCE))
    distance = np.repeat(background[None], len(frames), axis=0)
    background_origin = np.where(road < FAR_DISTANCE, Origin.PLANE, Origin.FAR).astype(np.uint8)
    origin = np.repeat(background_origin[None], len(frames), axis=0)
    matcher = ParallaxMatcher(frames, camera)
    small_size = (matcher.camera.width, matcher.camera.height)
    small_background = np.asarray(cv2.resize(background, small_size, interpolation=cv2.INTER_NEAREST), np.float32)
    for index, partner in enumerate(choose_partners(positions)):
        if partner is not None:
            T_frame_partner = invert(T_world_camera[index]) @ T_world_camera[partner]
            nearness = matcher.nearness(index, partner, T_frame_partner, small_background)
            _insert_parallax(distance[index], origin[index], nearness, small_background)
        on_progress((index + 1) / len(frames))
    distance[:, vehicle] = np.nan
    origin[:, vehicle] = Origin.VEHICLE
    return DistanceEstimate(distance, origin)


def _insert_parallax(
    distance: NDArray[np.float32],
    origin: NDArray[np.uint8],
    nearness: NDArray[np.float32],
    background: NDArray[np.float32],
) -> None:
    """Put what parallax (h, w) says stands in front of the background (h, w) into `distance` and `origin` (H, W)."""
    # How many times nearer than the background. Unlike distance it is smooth where an object stands on the road, and
    # it is 1 all over a plain road.
    ratio = np.maximum(nearness * background, 1.0)
    known = np.isfinite(ratio)
    if not known.any():
        return
    ratio = interpolate(ratio[..., None], known)[..., 0]
    small_origin = np.where(known, Origin.PARALLAX, Origin.INTERPOLATED).astype(np.uint8)
    in_front, small_distance, small_origin = (
        cv2.resize(values, distance.shape[::-1], interpolation=cv2.INTER_NEAREST)
        for values in ((ratio > LEAST_RATIO).astype(np.uint8), background / ratio, small_origin)
    )
    np.copyto(distance, small_distance, where=in_front > 0)
    np.copyto(origin, small_origin, where=in_front > 0)


def road_distance(camera: Camera, T_rig_camera: Array) -> NDArray[np.float32]:
    """Distance (H, W) along each ray to the plane z = 0 of the rig, inf where the ray does not meet it.

    Raises:
        InputError: the camera is not above the plane.
    """
    height = float(T_rig_camera[2, 3])
    if not height > 0.0:
        raise InputError(f"camera height {height:.2f} m: the camera must be mounted above the road; check T_rig_camera")
    descent = -(pixel_rays(camera) @ T_rig_camera[2, :3])
    return np.divide(height, descent, out=np.full(descent.shape, np.inf), where=descent > 0.0).astype(np.float32)


def _check_inputs(frames: NDArray[np.uint8], camera: Camera, trajectory: Trajectory) -> None:
    if frames.shape[1:] != (camera.height, camera.width, 3):
        raise InputError(
            f"frames of shape {frames.shape[1:]} for a camera of {camera.width} x {camera.height}; resize the camera"
        )
    if len(frames) != len(trajectory):
        raise InputError(f"{len(frames)} frames for {len(trajectory)} poses; give one pose per frame")
