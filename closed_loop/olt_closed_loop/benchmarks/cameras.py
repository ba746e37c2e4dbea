"""Pictures of a busy junction: error against sixteen rays a pixel, and run time, by how they are taken."""

from collections.abc import Callable
from functools import lru_cache, partial

import cv2
import numpy as np

from olt_closed_loop.benchmarks.busy_junction import busy_junction
from olt_closed_loop.sensors.ray_casting import rig_sensors
from olt_closed_loop.sensors.textures import Image
from olt_generator.poses import Array
from olt_toolkit.bench.benchmark import Benchmark, Setting
from olt_toolkit.rigs.contracts import find_contract

SIZE, TOY_SIZE = (320, 576), (64, 112)
CAMERAS = find_contract("alpamayo-r1").cameras
_TIMES_US = (2_000_000, 5_000_000, 7_500_000, 9_000_000)


@lru_cache(maxsize=1)
def _junction() -> tuple:
    scene = busy_junction()
    return scene, rig_sensors(scene)


@lru_cache(maxsize=len(_TIMES_US))
def _pose(time_us: int) -> Array:
    """Where the rig is (4, 4), which a drive knows before it takes pictures."""
    scene, _ = _junction()
    return scene.ego.interpolate(np.array([time_us]))[0]


def _take(time_us: int, size: tuple[int, int], scale: float) -> Image:
    """The four views (4, H, W, 3) at a time, filmed at `scale` times the size and brought to the size."""
    _, sensors = _junction()
    height, width = size
    pictures = sensors(CAMERAS, (round(scale * height), round(scale * width)), _pose(time_us), time_us)
    pictures = pictures.transpose(0, 2, 3, 1)
    if scale == 1.0:
        return pictures
    method = cv2.INTER_AREA if scale > 1.0 else cv2.INTER_LINEAR
    return np.stack([cv2.resize(picture, (width, height), interpolation=method) for picture in pictures])


@lru_cache(maxsize=4)
def _reference(size: tuple[int, int]) -> tuple[Image, ...]:
    return tuple(_take(time_us, size, 4.0) for time_us in _TIMES_US)


def _prepare(size: tuple[int, int], scale: float) -> Callable[[], Image]:
    for time_us in _TIMES_US:
        _take(time_us, size, scale)
    turn = iter(range(10**9))

    def take() -> Image:
        # Another moment every time, as in a drive.
        return _take(_TIMES_US[next(turn) % len(_TIMES_US)], size, scale)

    return take


def _measure_error(size: tuple[int, int], pictures: Image) -> float:
    """Root mean square difference of grey levels; what is judged is the first picture."""
    return float(np.sqrt(np.mean((pictures.astype(np.float64) - _reference(size)[0]) ** 2)))


def _figures(size: tuple[int, int], pictures: Image) -> dict[str, float]:
    off = np.abs(pictures.astype(np.int64) - _reference(size)[0]).max(axis=-1)
    return {"pixels off by more than 32 grey levels (%)": 100.0 * float((off > 32).mean())}


def _benchmark(size: tuple[int, int]) -> Benchmark:
    height, width = size
    scales = {"one ray a pixel": 1.0, "four rays a pixel": 2.0, "half the size, enlarged": 0.5}
    return Benchmark(
        title=f"Four views of {height} x {width} pixels of a junction with 60 road users",
        error_name="root mean square error",
        error_unit="grey levels",
        reference="the same views with 16 rays a pixel, averaged",
        settings=lambda: [
            Setting(name, partial(_prepare, size, scale), default=scale == 1.0) for name, scale in scales.items()
        ],
        measure_error=partial(_measure_error, size),
        figures=partial(_figures, size),
    )


BENCHMARK = _benchmark(SIZE)
TOY = _benchmark(TOY_SIZE)
