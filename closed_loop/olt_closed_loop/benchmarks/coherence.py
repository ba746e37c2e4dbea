"""Measures of coherence against truth: how well they rank faults that were planted in true views."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from olt_closed_loop.scenes.procedural import generate_scene
from olt_closed_loop.sensors.recorder import record_drive
from olt_generator.metrics.coherence import Coherence, measure_coherence
from olt_generator.metrics.cross_view_consistency import PosedView
from olt_generator.seeds import make_generator
from olt_generator.trajectory import Trajectory
from olt_generator.views.front_view import FrontView
from olt_generator.views.synthesis import synthesize_view
from olt_toolkit.bench.benchmark import Benchmark, list_settings
from olt_toolkit.rigs.rig import CROSS_LEFT
from olt_toolkit.rigs.rig_files import pav_rig

# Other scenes than those that the weights were fitted to.
SCENES = (("work_zone", 7), ("path_reassignment", 8))
FRONT_SIZE, VIEW_SIZE = (480, 270), (288, 160)
FRAME_RATE, SECONDS = 10.0, 2.0
# Images that are changed and compared.
MADE = (12, 13, 14)

Images = NDArray[np.uint8]


@lru_cache(maxsize=1)
def plant() -> list[tuple[str, PosedView, PosedView, float]]:
    """The kind of each fault, the faulty view, the front view, and the true error, rms."""
    cases = []
    for category, seed in SCENES:
        front, truth = _film(category, seed)
        mounted = pav_rig().fitted(*VIEW_SIZE)[CROSS_LEFT]
        T_world_rig = front.trajectory.T_world_rig[list(MADE)]
        seen = PosedView(front.frames[list(MADE)], front.camera, T_world_rig @ front.T_rig_camera)
        for kind, images in _faults(truth, front, make_generator("faults", category, seed)):
            view = PosedView(images, mounted.camera, T_world_rig @ mounted.T_rig_camera)
            error = float(np.sqrt(np.mean((images.astype(np.float64) - truth) ** 2)))
            cases.append((kind, view, seen, error))
    return cases


def _film(category: str, seed: int) -> tuple[FrontView, Images]:
    """The front view with its true distances and motion, and the true images of the left cross camera."""
    scene = generate_scene(category, seed)
    start = scene.ego.timestamps_us <= scene.ego.timestamps_us[0] + SECONDS * 1e6
    scene = replace(scene, ego=Trajectory(scene.ego.timestamps_us[start], scene.ego.T_world_rig[start]))
    front = record_drive(scene, *FRONT_SIZE, FRAME_RATE, with_distance=True)
    side = record_drive(scene, *VIEW_SIZE, FRAME_RATE, cameras=(CROSS_LEFT,)).views[CROSS_LEFT][list(MADE)]
    assert front.distance is not None and front.reference is not None
    return FrontView(front.frames, front.distance, front.reference, front.camera, front.T_rig_camera), side


def _faults(truth: Images, front: FrontView, random: np.random.Generator) -> Iterator[tuple[str, Images]]:
    """The true images (n, h, w, 3), and with specks, seams, blur, wrong distances and flicker, of several strengths."""
    count, height, width, _ = truth.shape
    yield "none", truth
    for number in (20, 80, 320, 1280):
        specked = truth.copy()
        for image in specked:
            for row, column in random.integers((height - 3, width - 3), size=(number, 2)):
                image[row : row + 3, column : column + 3] = image[random.integers(height), random.integers(width)]
        yield "specks", specked
    for step in (4, 10, 25, 50):
        seamed = truth.astype(np.int64)
        for left in (width // 4, 3 * width // 4):
            strip = np.s_[:, :, left : left + width // 4]
            seamed[strip] = np.roll(seamed[strip], step // 4, axis=1) + step
        yield "seams", np.clip(seamed, 0, 255).astype(np.uint8)
    for sigma in (0.7, 1.5, 3.0, 6.0):
        yield "blur", np.stack([np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), np.uint8) for image in truth])
    mounted = pav_rig().fitted(*VIEW_SIZE)[CROSS_LEFT]
    for factor in (0.25, 0.5, 0.8, 1.0, 1.25, 2.0):
        wrong = replace(front, distance=front.distance * np.float32(factor))
        yield "distances", synthesize_view(wrong, mounted.camera, mounted.T_rig_camera, MADE).images
    for sigma in (3.0, 8.0, 20.0, 40.0):
        change = random.normal(0.0, sigma, (count, 1, 1, 1))
        yield "flicker", np.clip(truth + change, 0, 255).astype(np.uint8)


def _ranked_by(value: Callable[[Coherence], float]) -> Callable[[], NDArray[np.float64]]:
    return lambda: np.array([value(measure_coherence(view, front)) for _, view, front, _ in plant()])


def rank_correlations(values: NDArray[np.float64]) -> dict[str, float]:
    """Rank correlation (Spearman) of a measure with the true error, by kind of fault and over all of them."""
    cases = plant()
    errors = np.array([error for *_, error in cases])
    found = {}
    for kind in ("specks", "seams", "blur", "distances", "flicker", "all"):
        some = np.array([kind == "all" or each in (kind, "none") for each, *_ in cases])
        found[kind] = float(np.corrcoef(rankdata(values[some]), rankdata(errors[some]))[0, 1])
    return found


def measure_error(values: NDArray[np.float64]) -> float:
    """1 less the mean over the kinds of fault of the rank correlation with the true error."""
    return 1.0 - float(np.mean([value for kind, value in rank_correlations(values).items() if kind != "all"]))


BENCHMARK = Benchmark(
    title=f"coherence of {len(SCENES) * 23} cross views of {len(MADE)} images with planted faults",
    error_name="1 - rank correlation",
    error_unit="with rms against truth, mean over five kinds",
    reference="the true images of that camera in the synthetic world",
    settings=lambda: list_settings(
        plant,
        {
            "coherence": _ranked_by(lambda found: -found.percent),
            "flicker alone": _ranked_by(lambda found: found.penalties["flicker"] or 0.0),
            "agreement alone": _ranked_by(lambda found: found.penalties["agreement"] or 0.0),
        },
        default="coherence",
    ),
    measure_error=measure_error,
)
