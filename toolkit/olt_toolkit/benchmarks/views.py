"""Cross views of a street from one front camera: how many other frames to draw on, against time."""

from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import FthetaCamera
from olt_generator.poses import camera_pose_in_rig, planar_pose
from olt_generator.trajectory import Trajectory
from olt_generator.views.front_view import FrontView
from olt_generator.views.synthesis import SynthesisSettings, synthesize_view
from olt_toolkit.bench.benchmark import Benchmark, list_settings
from olt_toolkit.benchmarks.street import render_street

FRONT = FthetaCamera.equidistant(576, 320, 286.0, 200.0, 280.0)
CROSS = FthetaCamera.equidistant(288, 160, 144.0, 100.0, 140.0)
T_RIG_FRONT = camera_pose_in_rig([1.7, 0.0, 1.45], 0.0, 0.01, -0.01)
T_RIG_CROSS = tuple(
    camera_pose_in_rig([2.5, side * 0.94, 0.92], 0.0, 0.01, float(np.radians(side * 66.0))) for side in (1.0, -1.0)
)
# Twenty frames, a metre and a half apart; the views of the last one are made.
FRAMES, STEP = 20, 1.5
OTHER_FRAMES = (0, 1, 2, 4, 8)


@lru_cache(maxsize=1)
def drive() -> FrontView:
    """The front view along the street with its true distance."""
    poses = planar_pose(STEP * (np.arange(FRAMES) - FRAMES + 1), 0.0, 0.0)
    pictures = [render_street(FRONT, pose @ T_RIG_FRONT) for pose in poses]
    frames, distance = (np.stack(part) for part in zip(*pictures, strict=True))
    return FrontView(frames, distance, Trajectory(100_000 * np.arange(FRAMES), poses), FRONT, T_RIG_FRONT)


def make_views(other_frames: int) -> NDArray[np.uint8]:
    """Images (2, h, w, 3) of the left and the right cross view at the last frame."""
    front, settings = drive(), SynthesisSettings(other_frames=other_frames)
    views = [synthesize_view(front, CROSS, T_RIG_CROSS[side], [FRAMES - 1], settings) for side in (0, 1)]
    return np.concatenate([view.images for view in views])


def measure_error(images: NDArray[np.uint8]) -> float:
    """Root mean square difference of images (2, h, w, 3) from the true views, invented pixels counted."""
    true = np.stack([render_street(CROSS, T_rig_camera)[0] for T_rig_camera in T_RIG_CROSS]).astype(np.float64)
    return float(np.sqrt(np.mean((images.astype(np.float64) - true) ** 2)))


BENCHMARK = Benchmark(
    title=f"two cross views of {CROSS.width} x {CROSS.height} pixels from frames of {FRONT.width} x {FRONT.height}",
    error_name="rms colour error",
    error_unit="of 255",
    reference="the true views of a made-up street, ray-cast; distances are true, so that the warp alone is measured",
    settings=lambda: list_settings(
        drive,
        {
            f"at most {count} other frames" if count else "same frame only": partial(make_views, count)
            for count in OTHER_FRAMES
        },
        default=f"at most {SynthesisSettings().other_frames} other frames",
    ),
    measure_error=measure_error,
)
