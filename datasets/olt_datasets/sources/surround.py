"""Drives filmed by several cameras around the vehicle, none of them where the target rig has its own.

The front camera gives the recording. The views of the target rig are mosaics of all cameras, each at its own nearest
time: that is what is true in such data, with seams, and with a mask of what nobody saw.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from olt_datasets.sources.mosaic import Mosaic, coverage
from olt_datasets.sources.times import FARTHEST_US, farthest_apart, images_within, nearest_images, starting_at
from olt_generator import Camera, InputError, PinholeCamera, Trajectory
from olt_generator.files import read_bounded
from olt_generator.lenses.remap import Remapper
from olt_generator.video import shrink
from olt_toolkit import Drive, OpenOptions, Recording
from olt_toolkit.policy.window import Span
from olt_toolkit.recordings.labels import Split
from olt_toolkit.recordings.pictures import LARGEST_BYTES, REDUCTIONS, decode_picture
from olt_toolkit.rigs.rig import CAMERA_INDEX, FRONT_WIDE, MountedCamera, VehicleDimensions, short_name
from olt_toolkit.rigs.rig_files import pav_rig

Image = NDArray[np.uint8]

# A mosaic that shows less than this share of a view is not offered as one.
LEAST_COVERAGE = 0.5
# Shape of the views: that of the target rig's images.
_ASPECT = 9 / 16
# Side samples of each front pixel where distortion is taken out.
_SAMPLES = 2


class StoredImage(Protocol):
    """An image file, or an image inside another file; as text it is what errors call it."""

    def read_bytes(self) -> bytes:
        """The coded image; InputError where it is damaged."""
        ...


@dataclass(frozen=True)
class CameraImages:
    """The images of one camera over a drive: n files or parts of files at drive times (n,), strictly increasing.

    `mounted` is the lens, at the size of the stored images, and the mounting.
    """

    mounted: MountedCamera
    files: tuple[StoredImage, ...]
    times_us: NDArray[np.int64]


@dataclass(frozen=True)
class SurroundDrive:
    """A drive of a vehicle with several cameras, of which the front one begins at drive time 0.

    `scene` tells it from all others of its source. `ego` are measured rig poses over drive time, in a frame whose z is
    up; `assumptions` sentences for what is assumed.
    """

    source: str
    key: str
    scene: str
    front: str
    cameras: dict[str, CameraImages]
    ego: Trajectory
    vehicle: VehicleDimensions
    assumptions: tuple[str, ...]

    @cached_property
    def mosaics(self) -> dict[str, float]:
        """The target rig's cameras whose view can be put together, and the share of each that is seen."""
        rig, sources = pav_rig(), self._steady_cameras
        shares = {name: coverage(rig[name], sources) for name in CAMERA_INDEX}
        return {name: share for name, share in shares.items() if share >= LEAST_COVERAGE}

    @cached_property
    def _steady_cameras(self) -> dict[str, MountedCamera]:
        """The cameras that have an image near every front image."""
        front_us = self.cameras[self.front].times_us
        return {
            name: camera.mounted
            for name, camera in self.cameras.items()
            if farthest_apart(camera.times_us, front_us) <= FARTHEST_US
        }

    def describe(self, *, notes: tuple[str, ...] = (), country: str | None = None, split: Split | None = None) -> Drive:
        """The drive as data set readers tell it; the arguments are those of `Drive`."""
        mosaics = (
            f"The true {short_name(name)} view is a mosaic of several cameras, which shows {share:.0%} of it."
            for name, share in self.mosaics.items()
        )
        unsteady = (
            f"{name} lacks images near some front images and is left out of the mosaics."
            for name in self.cameras
            if name not in self._steady_cameras
        )
        return Drive(
            source=self.source,
            scene_id=f"{self.source}/{self.scene}",
            key=self.key,
            front_us=self.cameras[self.front].times_us,
            cameras=tuple(self.cameras),
            ego_span_us=(int(self.ego.timestamps_us[0]), int(self.ego.timestamps_us[-1])),
            true_views=tuple(name for name in CAMERA_INDEX if name == FRONT_WIDE or name in self.mosaics),
            country=country,
            split=split,
            notes=(*notes, *mosaics, *unsteady, *self.assumptions),
        )

    def peek(self, times_us: NDArray[np.int64], width: int) -> tuple[Image, NDArray[np.int64]]:
        """See `Dataset.peek`; images are decoded at reduced size and freed of their distortion."""
        front = self.cameras[self.front]
        numbers = nearest_images(front.times_us, times_us)
        distinct, places = np.unique(numbers, return_inverse=True)
        lens = front.mounted.camera
        reduction = max(each for each in REDUCTIONS if lens.width >= each * width or each == 1)
        reduced = lens.resized(-(-lens.width // reduction), -(-lens.height // reduction))
        _, straighten = straightened(reduced, width)
        images = np.stack([straighten(read_image(front.files[each], lens, reduction)) for each in distinct.tolist()])
        return images[places], front.times_us[numbers]

    def open(self, window_us: Span, options: OpenOptions) -> Recording:
        """See `Dataset.open`."""
        options.refuse_camera(f"{self.source}/{self.key}")
        front = self.cameras[self.front]
        indices = images_within(front.times_us, window_us, f"{self.source}/{self.key}")
        times_us = front.times_us[indices]
        rig = pav_rig().fitted(options.width, round(options.width * _ASPECT))
        mosaics = {name: Mosaic(rig[name], self._steady_cameras) for name in options.views if name in self.mosaics}
        used = {name: self.cameras[name] for name in sorted({each for m in mosaics.values() for each in m.cameras})}
        beside = {name: nearest_images(camera.times_us, times_us) for name, camera in used.items()}
        views = {
            name: np.empty((len(times_us), *mosaic.observed.shape, 3), np.uint8) for name, mosaic in mosaics.items()
        }
        camera, straighten = straightened(front.mounted.camera, options.width)
        frames = np.empty((len(indices), camera.height, camera.width, 3), np.uint8)
        # Image by image, so that only one stored image of each camera is in memory.
        for place, index in enumerate(indices.tolist()):
            image = read_image(front.files[index], front.mounted.camera)
            frames[place] = straighten(image)
            stored = {self.front: image} | {
                name: read_image(each.files[beside[name][place]], each.mounted.camera)
                for name, each in used.items()
                if name != self.front
            }
            for name, mosaic in mosaics.items():
                views[name][place] = mosaic.compose(stored)
        assumptions = list(self.assumptions)
        for name, mosaic in mosaics.items():
            apart = max(farthest_apart(used[each].times_us, times_us) for each in mosaic.cameras) / 1000
            assumptions.append(
                f"The true {short_name(name)} view is a mosaic of {', '.join(mosaic.cameras)}, as if everything were "
                f"infinitely far and nothing moved within {apart:.0f} ms; {mosaic.coverage:.0%} of it is seen, the "
                "rest is black."
            )
        return Recording(
            name=self.key,
            source=self.source,
            frames=frames,
            timestamps_us=times_us - times_us[0],
            camera=camera,
            T_rig_camera=front.mounted.T_rig_camera,
            vehicle=self.vehicle,
            assumptions=tuple(assumptions),
            reference=starting_at(self.ego, int(times_us[0])),
            views=views,
            mounted={name: mosaic.target for name, mosaic in mosaics.items()},
            observed={name: mosaic.observed for name, mosaic in mosaics.items()},
        )


def read_image(stored: StoredImage, camera: Camera, reduction: int = 1) -> Image:
    """A stored image as (H, W, 3) RGB; InputError where it is missing, damaged or not at the size of its camera.

    Each side of the image is divided by `reduction`, 1, 2, 4 or 8, and rounded up; little else is decoded.
    """
    if isinstance(stored, Path) and not stored.is_file():
        raise InputError(f"{stored}: no such image; copy the data set again")
    content = read_bounded(stored, "image", LARGEST_BYTES) if isinstance(stored, Path) else stored.read_bytes()
    image = decode_picture(content, str(stored), reduction)
    if image.shape[:2] != (-(-camera.height // reduction), -(-camera.width // reduction)):
        about = "about " if reduction > 1 else ""
        height, width = (reduction * side for side in image.shape[:2])
        has = f"{camera.width} x {camera.height}"
        raise InputError(f"{stored}: is {about}{width} x {height} pixels; its camera has {has}")
    return image


def straightened(camera: Camera, width: int) -> tuple[Camera, Callable[[Image], Image]]:
    """The camera without distortion, at most `width` pixels wide, and what makes its images of stored ones."""
    scale = min(1.0, width / camera.width)
    size = round(camera.width * scale), round(camera.height * scale)
    if isinstance(camera, PinholeCamera):
        return camera.resized(*size), lambda image: shrink(image, width)
    right, down = camera.pixels_per_radian
    straight = PinholeCamera(camera.width, camera.height, right, down, camera.cx, camera.cy).resized(*size)
    return straight, Remapper(camera, straight, np.eye(3), _SAMPLES).remap
