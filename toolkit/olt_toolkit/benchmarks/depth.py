"""Distances of a drive down the made-up street: time of the plane sweep against pixels that come out wrong."""

from functools import lru_cache, partial

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import PinholeCamera, pixel_rays
from olt_generator.distance.background import FAR_DISTANCE, background_distance
from olt_generator.distance.depth import SweepSettings, estimate_distance
from olt_generator.poses import camera_pose_in_rig, invert, planar_pose
from olt_generator.trajectory import Trajectory
from olt_toolkit.bench.benchmark import Benchmark, list_settings
from olt_toolkit.benchmarks.street import render_street

WIDTH, HEIGHT = 832, 480
FRAMES, METRES_PER_FRAME = 12, 1.2
SHOWN = (3, 6, 9)
T_RIG_CAMERA = camera_pose_in_rig([1.7, 0.0, 1.5], 0.0, 0.03, 0.0)
CAMERA = PinholeCamera.from_field_of_view(WIDTH, HEIGHT, float(np.radians(90.0)))

# A distance is right within this share of the truth.
RIGHT = 0.1

SETTINGS = {
    "24 planes, 2 neighbours, 256 columns": SweepSettings(),
    "12 planes": SweepSettings(planes=12),
    "16 planes": SweepSettings(planes=16),
    "48 planes": SweepSettings(planes=48),
    "1 neighbour": SweepSettings(neighbours=1),
    "128 columns": SweepSettings(width=128),
    "416 columns": SweepSettings(width=416),
}


@lru_cache(maxsize=1)
def _drive() -> tuple[NDArray[np.uint8], NDArray[np.float32], Trajectory]:
    """Frames (n, H, W, 3), true distances (m, H, W) of those shown, and the trajectory."""
    index = np.arange(FRAMES)
    trajectory = Trajectory(100_000 * index, planar_pose(METRES_PER_FRAME * index, 0.0, 0.0))
    rendered = [render_street(CAMERA, pose @ T_RIG_CAMERA) for pose in trajectory.T_world_rig]
    truth = np.stack([np.minimum(rendered[index][1], np.float32(FAR_DISTANCE)) for index in SHOWN])
    return np.stack([image for image, _ in rendered]), truth, trajectory


def flow_of_one_pair() -> NDArray[np.float32]:
    """Distances (m, H, W) by dense optical flow to the frame before, triangulated where it fits the motion."""
    frames, _, trajectory = _drive()
    T_world_camera = trajectory.T_world_rig @ T_RIG_CAMERA
    small, background = CAMERA.resized(WIDTH // 2, HEIGHT // 2), background_distance(CAMERA, T_RIG_CAMERA)
    grey = [cv2.cvtColor(cv2.resize(frame, (small.width, small.height)), cv2.COLOR_RGB2GRAY) for frame in frames]
    method, found = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM), []
    for index in SHOWN:
        T_frame_other = invert(T_world_camera[index]) @ T_world_camera[index - 1]
        flow = method.calc(grey[index], grey[index - 1], None)  # pyright: ignore
        rows, columns = np.indices((small.height, small.width))
        rays = pixel_rays(small)
        other_rays = small.rays(np.stack([columns, rows], axis=-1) + flow) @ T_frame_other[:3, :3].T
        between = np.cross(rays, other_rays)
        squared_sine = np.maximum((between**2).sum(axis=-1), 1e-12)
        # From s r = b + u p: the cross product with p gives s times the squared sine of the angle between the rays.
        distance = (np.cross(T_frame_other[:3, 3], other_rays) * between).sum(axis=-1) / squared_sine
        enlarged = cv2.resize(distance.astype(np.float32), (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST)
        found.append(np.where((enlarged > 0.0) & (enlarged < background), enlarged, background).astype(np.float32))
    return np.stack(found)


def _sweep(settings: SweepSettings) -> NDArray[np.float32]:
    frames, _, trajectory = _drive()
    return estimate_distance(frames, CAMERA, trajectory, T_RIG_CAMERA, frame_indices=SHOWN, settings=settings).distance


def measure_error(distance: NDArray[np.float32]) -> float:
    """Percent of pixels (m, H, W) that are off by more than a tenth."""
    _, truth, _ = _drive()
    return float(100.0 * np.mean(~(np.abs(distance - truth) < RIGHT * truth)))


BENCHMARK = Benchmark(
    title=f"distances of {len(SHOWN)} of {FRAMES} frames of {WIDTH} x {HEIGHT} pixels, {METRES_PER_FRAME} m apart",
    error_name="wrong by more than a tenth",
    error_unit="% of pixels",
    reference="the distances to which the made-up street is ray-cast, at most 150 m",
    settings=lambda: list_settings(
        _drive,
        {name: partial(_sweep, settings) for name, settings in SETTINGS.items()}
        | {"flow of one pair": flow_of_one_pair},
        default="24 planes, 2 neighbours, 256 columns",
    ),
    measure_error=measure_error,
)
