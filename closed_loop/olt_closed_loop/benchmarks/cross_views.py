"""Cross views of drives through the synthetic world, all from their front videos: error against what they draw on."""

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
from olt_generator.views.moving_objects import check_distances
from olt_generator.views.synthesis import SynthesisSettings, synthesize_view
from olt_toolkit.bench.benchmark import Benchmark, Setting
from olt_toolkit.recordings.recording import Recording
from olt_toolkit.rigs.rig import CROSS_LEFT, CROSS_RIGHT
from olt_toolkit.rigs.rig_files import pav_rig

SCENES = (("nominal", 3), ("nominal", 5), ("work_zone", 2), ("uncommon_vehicle", 1))
FRONT_SIZE, VIEW_SIZE = (480, 270), (288, 160)
FRAME_RATE, SECONDS = 10.0, 4
# Images that are made and compared: in the middle of each drive, where there are frames before and after.
MADE = (18, 22, 26, 30)
VIEWS = (CROSS_LEFT, CROSS_RIGHT)


@lru_cache(maxsize=len(SCENES))
def record(category: str, seed: int) -> tuple[Recording, NDArray[np.uint8]]:
    """The front video, and the true images (views, m, h, w, 3) of the cross cameras at the moments that are made."""
    scene = generate_scene(category, seed)
    start = scene.ego.timestamps_us <= scene.ego.timestamps_us[0] + SECONDS * 1_000_000
    scene = replace(scene, ego=Trajectory(scene.ego.timestamps_us[start], scene.ego.T_world_rig[start]))
    front = record_drive(scene, *FRONT_SIZE, FRAME_RATE, with_distance=True)
    sides = record_drive(scene, *VIEW_SIZE, FRAME_RATE, cameras=VIEWS)
    return front, np.stack([sides.views[name][list(MADE)] for name in VIEWS])


@lru_cache(maxsize=2 * len(SCENES))
def look(category: str, seed: int, true_geometry: bool) -> FrontView:
    """The front view with the true motion and distance, or with what is found from the video alone."""
    recording, _ = record(category, seed)
    if true_geometry:
        assert recording.distance is not None and recording.reference is not None
        return check_distances(
            FrontView(
                recording.frames, recording.distance, recording.reference, recording.camera, recording.T_rig_camera
            )
        )
    odometry = estimate_odometry(recording.frames, recording.timestamps_us, recording.camera, recording.T_rig_camera)
    trajectory = smooth_trajectory(odometry.trajectory, ODOMETRY_SETTINGS).trajectory
    found = estimate_distance(recording.frames, recording.camera, trajectory, odometry.T_rig_camera)
    return check_distances(
        FrontView(
            recording.frames,
            found.distance,
            trajectory,
            recording.camera,
            odometry.T_rig_camera,
            found.confidence,
            found.moving,
        )
    )


def make_all(fronts: tuple[FrontView, ...], settings: SynthesisSettings) -> NDArray[np.uint8]:
    """Images (scenes, views, m, h, w, 3) of both cross views of every scene."""
    return np.stack([make_views(front, settings) for front in fronts])


def make_views(front: FrontView, settings: SynthesisSettings) -> NDArray[np.uint8]:
    """Images (views, m, h, w, 3) of both cross views."""
    rig = pav_rig().fitted(*VIEW_SIZE)
    made = [synthesize_view(front, rig[name].camera, rig[name].T_rig_camera, MADE, settings) for name in VIEWS]
    return np.stack([view.images for view in made])


def scene_errors(images: NDArray[np.uint8]) -> list[float]:
    """PSNR in dB of each scene's images (scenes, views, m, h, w, 3), invented pixels counted."""
    truth = [record(*scene)[1] for scene in SCENES]
    mean_squares = [np.mean((made.astype(np.float64) - true) ** 2) for made, true in zip(images, truth, strict=True)]
    return [float(10.0 * np.log10(255.0**2 / mean_square)) for mean_square in mean_squares]


def measure_error(images: NDArray[np.uint8]) -> float:
    """Root mean square difference whose PSNR, 20 log10(255 / this), is the mean over the scenes."""
    return float(255.0 * 10.0 ** (-np.mean(scene_errors(images)) / 20.0))


def _prepare(other_frames: int, true_geometry: bool = False) -> Callable[[], NDArray[np.uint8]]:
    fronts = tuple(look(*scene, true_geometry) for scene in SCENES)
    return partial(make_all, fronts, replace(SynthesisSettings(), other_frames=other_frames))


BENCHMARK = Benchmark(
    title=f"{len(SCENES) * len(VIEWS) * len(MADE)} cross images of {VIEW_SIZE[0]} x {VIEW_SIZE[1]} from front videos",
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
