"""Four views of 576 x 320 from one 1920 x 1080 fisheye image: time against the error of the pixels."""

from collections.abc import Callable
from functools import lru_cache, partial

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from olt_generator.cameras import Camera, PinholeCamera, remap_table
from olt_generator.lenses.remap import Remapper
from olt_generator.poses import Array
from olt_generator.seeds import make_generator
from olt_toolkit.bench.benchmark import Benchmark, Setting
from olt_toolkit.rigs.rig import FRONT_WIDE
from olt_toolkit.rigs.rig_files import pav_rig

WIDTH, HEIGHT = 576, 320
REFERENCE_SAMPLES = 8

Images = NDArray[np.uint8]


@lru_cache(maxsize=1)
def scene() -> tuple[Images, Camera, list[tuple[Camera, Array]]]:
    """Image (H, W, 3), its camera, and the wanted cameras with R_source_target (3, 3).

    One keeps the lens, one enlarges, one turns aside, and one of 150 degrees shrinks 13-fold in the middle and hardly
    at its edge.
    """
    front = pav_rig()[FRONT_WIDE].camera
    targets = [
        (front.resized(WIDTH, HEIGHT), 0.0),
        (PinholeCamera.from_field_of_view(WIDTH, HEIGHT, float(np.radians(30.0))), 0.0),
        (PinholeCamera.from_field_of_view(WIDTH, HEIGHT, float(np.radians(70.0))), 20.0),
        (PinholeCamera.from_field_of_view(WIDTH, HEIGHT, float(np.radians(150.0))), 0.0),
    ]
    views = [(target, Rotation.from_euler("y", yaw, degrees=True).as_matrix()) for target, yaw in targets]
    return make_image(front.width, front.height), front, views


def make_image(width: int, height: int) -> Images:
    """Noise with as much contrast in every octave of size, as in photographs, down to single pixels."""
    random = make_generator("remap benchmark")
    image = np.full((height, width, 3), 128.0, np.float32)
    for octave in range(8):
        grid = random.normal(0.0, 10.0, ((height >> octave) + 1, (width >> octave) + 1, 3)).astype(np.float32)
        image += np.asarray(cv2.resize(grid, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@lru_cache(maxsize=1)
def reference() -> list[tuple[NDArray[np.float32], NDArray[np.bool_]]]:
    """Every view (h, w, 3) as the mean of 64 samples a pixel, and which pixels (h, w) the source sees whole."""
    image, source, views = scene()
    result = []
    for target, R_source_target in views:
        fine = target.resized(WIDTH * REFERENCE_SAMPLES, HEIGHT * REFERENCE_SAMPLES)
        table, seen = remap_table(source, fine, R_source_target)
        sampled = cv2.remap(image, table[..., 0].copy(), table[..., 1].copy(), cv2.INTER_LINEAR)
        mean = cv2.resize(sampled.astype(np.float32), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
        whole = seen.reshape(HEIGHT, REFERENCE_SAMPLES, WIDTH, REFERENCE_SAMPLES).all(axis=(1, 3))
        result.append((np.asarray(mean, np.float32), whole))
    return result


def prepare_plain(interpolation: int) -> Callable[[], Images]:
    """One look-up a pixel in the full image, as most code does it."""
    image, source, views = scene()
    tables = [remap_table(source, target, R_source_target)[0] for target, R_source_target in views]
    maps = [cv2.convertMaps(table[..., 0], table[..., 1], cv2.CV_16SC2) for table in tables]
    return lambda: np.stack([np.asarray(cv2.remap(image, *pair, interpolation), np.uint8) for pair in maps])


def prepare_remapper(samples: int) -> Callable[[], Images]:
    """The project's own, with so many samples along each side of a pixel."""
    image, source, views = scene()
    remappers = [Remapper(source, target, R_source_target, samples) for target, R_source_target in views]
    return lambda: np.stack([remapper.remap(image) for remapper in remappers])


def measure_error(images: Images) -> float:
    """Root mean square difference in grey levels from the reference, over the pixels that the source sees whole."""
    pairs = zip(images, reference(), strict=True)
    differences = [(image[whole] - mean[whole]).ravel() for image, (mean, whole) in pairs]
    return float(np.sqrt(np.mean(np.concatenate(differences) ** 2)))


BENCHMARK = Benchmark(
    title=f"four views of {WIDTH} x {HEIGHT} from one fisheye image of 1920 x 1080, one thread",
    error_name="rms error",
    error_unit="grey levels",
    reference=f"{REFERENCE_SAMPLES**2} bilinear samples of the full image averaged in every pixel",
    settings=lambda: [
        Setting("nearest", partial(prepare_plain, cv2.INTER_NEAREST)),
        Setting("bilinear", partial(prepare_plain, cv2.INTER_LINEAR)),
        Setting("bicubic", partial(prepare_plain, cv2.INTER_CUBIC)),
        Setting("mip map", partial(prepare_remapper, 1), default=True),
        Setting("mip map, 2 x 2 samples", partial(prepare_remapper, 2)),
        Setting("mip map, 4 x 4 samples", partial(prepare_remapper, 4)),
    ],
    measure_error=measure_error,
)
