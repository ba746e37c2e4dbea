"""Cross views of a drive through the synthetic world, all from its front video: error against what they draw on."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scenes.procedural import generate_scene
from olt_closed_loop.sensors.recorder import record_drive
from olt_generator.distance.depth import estimate_distance
from olt_generator.motion.odometry import estimate_odometry
from olt_generator.motion.smoother import ODOMETRY_SETTINGS, smooth_trajectory
from olt_generator.trajectory import Trajectory
from olt_generator.views.front_view import FrontView
from olt_generator.views.moving_objects import find_moving
from olt_generator.views.synthesis import SynthesisSettings, synthesize_view
from olt_toolkit.bench.benchmark import Benchmark, Setting
from olt_toolkit.recordings.recording import Recording
from olt_toolkit.rigs.rig import CROSS_LEFT, CROSS_RIGHT
from olt_toolkit.rigs.rig_files import pav_rig

CATEGORY, SEED = "nominal", 3
FRONT_SIZE, VIEW_SIZE = (480, 270), (288, 160)
FRAME_RATE, SECONDS = 10.0, 4
# Images that are made and compared: in the middle of the drive, where there are frames before and after.
MADE = (18, 22, 26, 30)
VIEWS = (CROSS_LEFT, CROSS_RIGHT)


@lru_cache(maxsize=1)
def record() -> tuple[Recording, NDArray[np.uint8]]:
    """The front video, and the true images (views, m, h, w, 3) of the cross cameras at the moments that are made."""
    scene = generate_scene(CATEGORY, SEED)
    start = scene.ego.timestamps_us <= scene.ego.timestamps_us[0] + SECONDS * 1_000_000
    scene = replace(scene, ego=Trajectory(scene.ego.timestamps_us[start], scene.ego.T_world_rig[start]))
    front = record_drive(scene, *FRONT_SIZE, FRAME_RATE, with_distance=True)
    sides = record_drive(scene, *VIEW_SIZE, FRAME_RATE, cameras=VIEWS)
    return front, np.stack([sides.views[name][list(MADE)] for name in VIEWS])


@lru_cache(maxsize=2)
def look(true_geometry: bool) -> FrontView:
    """The front view with the true motion and distance, or with what is found from the video alone."""
    recording, _ = record()
    if true_geometry:
        assert recording.distance is not None and recording.reference is not None
        front = FrontView(
            recording.frames, recording.distance, recording.reference, recording.camera, recording.T_rig_camera
        )
        return replace(front, moving=find_moving(front))
    odometry = estimate_odometry(recording.frames, recording.timestamps_us, recording.camera, recording.T_rig_camera)
    trajectory = smooth_trajectory(odometry.trajectory, ODOMETRY_SETTINGS).trajectory
    found = estimate_distance(recording.frames, recording.camera, trajectory, odometry.T_rig_camera)
    front = FrontView(
        recording.frames, found.distance, trajectory, recording.camera, odometry.T_rig_camera, found.confidence
    )
    return replace(front, moving=found.moving | find_moving(front))


def make_views(front: FrontView, settings: SynthesisSettings) -> NDArray[np.uint8]:
    """Images (views, m, h, w, 3) of both cross views."""
    rig = pav_rig().fitted(*VIEW_SIZE)
    made = [synthesize_view(front, rig[name].camera, rig[name].T_rig_camera, MADE, settings) for name in VIEWS]
    return np.stack([view.images for view in made])


def measure_error(images: NDArray[np.uint8]) -> float:
    """Root mean square difference from the true views, invented pixels counted; PSNR is 20 log10(255 / this)."""
    return float(np.sqrt(np.mean((images.astype(np.float64) - record()[1]) ** 2)))


def _prepare(other_frames: int, true_geometry: bool = False) -> Callable[[], NDArray[np.uint8]]:
    return partial(make_views, look(true_geometry), replace(SynthesisSettings(), other_frames=other_frames))


BENCHMARK = Benchmark(
    title=f"{len(VIEWS) * len(MADE)} cross images of {VIEW_SIZE[0]} x {VIEW_SIZE[1]} from a front video",
    error_name="rms colour error",
    error_unit="of 255",
    reference="the true images of those cameras in the synthetic world, ray-cast",
    settings=lambda: [
        Setting("same frame only", partial(_prepare, 0)),
        Setting("4 other frames", partial(_prepare, 4), default=True),
        Setting("8 other frames", partial(_prepare, 8)),
        Setting("same frame only, true geometry", partial(_prepare, 0, True)),
        Setting("4 other frames, true geometry", partial(_prepare, 4, True)),
    ],
    measure_error=measure_error,
)
