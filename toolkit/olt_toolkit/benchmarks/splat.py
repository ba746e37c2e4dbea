"""Forward splat of a street scene into a camera two metres to the side: time against wrong surfaces."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera, PinholeCamera
from olt_generator.poses import Array, camera_pose_in_rig, invert
from olt_generator.views.splat import Warp, land, splat, splat_reference
from olt_toolkit.bench.benchmark import Benchmark, list_settings
from olt_toolkit.benchmarks.street import render_street

WIDTH, HEIGHT = 832, 480

# Two distances that differ by less than this share belong to one surface: neighbouring pixels of the road differ less.
SAME_SURFACE = 0.05


def overwrite() -> Warp:
    """Warp the image as the released generator does (docs/formats/generator.md), without a depth test.

    Points are sorted from far to near and written once for each of the nine offsets of the footprint, so that a
    later offset of a far point overwrites an earlier one of a near point.
    """
    image, distance, source, target, T_target_source = _scene()
    landings = list(land(distance, source, target, T_target_source))
    pixel, row, column, depth = (
        np.concatenate([getattr(landing, name) for landing in landings])
        for name in ("source", "row", "column", "distance")
    )
    far_to_near = np.argsort(-depth, kind="stable")
    warp = Warp(
        np.zeros((target.height, target.width, 3), np.uint8),
        np.zeros((target.height, target.width), bool),
        np.full((target.height, target.width), np.inf, np.float32),
    )
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            rows, columns = row[far_to_near] + down, column[far_to_near] + right
            inside = (rows >= 0) & (rows < target.height) & (columns >= 0) & (columns < target.width)
            written = far_to_near[inside]
            warp.image[rows[inside], columns[inside]] = image.reshape(-1, 3)[pixel[written]]
            warp.visible[rows[inside], columns[inside]] = True
            warp.distance[rows[inside], columns[inside]] = depth[written]
    return warp


def at_reduced_size(factor: int) -> Warp:
    """Splat every `factor`-th pixel of the image into one smaller by `factor` and enlarge the result."""
    image, distance, source, target, T_target_source = _scene()
    height, width = distance.shape
    small = splat(
        np.ascontiguousarray(image[::factor, ::factor]),
        np.ascontiguousarray(distance[::factor, ::factor]),
        source.resized(width // factor, height // factor),
        target.resized(target.width // factor, target.height // factor),
        T_target_source,
    )
    return Warp(*(np.repeat(np.repeat(part, factor, axis=0), factor, axis=1) for part in vars(small).values()))


@lru_cache(maxsize=1)
def _scene() -> tuple[NDArray[np.uint8], NDArray[np.float32], Camera, Camera, Array]:
    """Image, distance, source camera, target camera and T_target_source of the street."""
    camera = PinholeCamera.from_field_of_view(WIDTH, HEIGHT, float(np.radians(90.0)))
    T_world_source = camera_pose_in_rig([0.0, 0.0, 1.5], 0.0, 0.0, 0.0)
    T_world_target = camera_pose_in_rig([1.0, 2.0, 1.2], 0.0, 0.0, float(np.radians(20.0)))
    image, distance = render_street(camera, T_world_source)
    return image, distance, camera, camera, invert(T_world_target) @ T_world_source


@lru_cache(maxsize=1)
def _reference() -> Warp:
    image, distance, source, target, T_target_source = _scene()
    return splat_reference(image, land(distance, source, target, T_target_source), target)


def measure_error(distance: NDArray[np.float32]) -> float:
    """Percent of the target pixels (h, w) that show another surface than the reference, or one where it has none."""
    reference = _reference().distance
    with np.errstate(invalid="ignore"):
        right = (distance == reference) | (np.abs(distance - reference) < SAME_SURFACE * reference)
    return float(100.0 * (1.0 - right.mean()))


BENCHMARK = Benchmark(
    title=f"forward splat of {WIDTH} x {HEIGHT} pixels with a footprint of 3 x 3, one thread",
    error_name="wrong surface",
    error_unit="% of pixels",
    reference="the painter's algorithm in a plain loop (`splat_reference`); right is within 5 % of its distance",
    settings=lambda: list_settings(
        _scene,
        {
            "radius 1": lambda: splat(*_scene()).distance,
            "overwrite without depth test": lambda: overwrite().distance,
            "half size, enlarged": lambda: at_reduced_size(2).distance,
            "quarter size, enlarged": lambda: at_reduced_size(4).distance,
        },
        default="radius 1",
    ),
    measure_error=measure_error,
)
