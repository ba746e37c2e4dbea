"""Images of one camera seen through another that shares its centre, or is so near that the difference may be fixed.

Where the view shrinks, one source pixel in many would be picked and the rest lost, which flickers. So the image is
first halved again and again by means of 2 x 2 pixels (a mip map: Williams, "Pyramidal parametrics", SIGGRAPH 1983),
and every target pixel is interpolated bilinearly in the level whose pixels come close to its own size. Where that is
not fine enough, each target pixel is the mean of several samples, each taken in that way.
"""

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from olt_generator.errors import InputError
from olt_generator.lenses.camera_model import Camera, Mask, pixel_rays
from olt_generator.poses import Array

Images = NDArray[np.uint8]

# Far outside of every image: OpenCV paints such pixels black.
_NOWHERE = -1e4
# A level is used from where the view shrinks this many times more than the level itself: finer levels flicker, coarser
# ones blur (`olt bench remap`).
_LEVEL_SWITCH = 2.0**-0.25


def remap_table(source: Camera, target: Camera, R_source_target: Array) -> tuple[NDArray[np.float32], Mask]:
    """Where each pixel of `target` is found in `source` when both share one centre; arguments as of `Remapper`.

    Returns:
        A table (height, width, 2) of source pixels as `cv2.remap` takes it, and the mask (height, width) of target
        pixels that the source sees.
    """
    pixels, seen = _source_pixels(source, target, R_source_target)
    return np.where(seen[..., None], pixels, _NOWHERE).astype(np.float32), seen


class Remapper:
    """Turns images of one camera into images of another, again and again; the geometry is worked out once.

    Attributes:
        source, target: cameras that take the images, and whose images are wanted.
        seen: (height, width) target pixels of which the source sees every sample; the others come out black.
    """

    def __init__(
        self,
        source: Camera,
        target: Camera,
        R_source_target: Array,
        samples: int = 1,
        shift: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        """Work out where the pixels come from.

        Args:
            source, target: see the attributes.
            R_source_target: (3, 3) rotation from target axes to source axes.
            samples: samples along each side of a target pixel; their square multiplies the run time.
            shift: (3,) place of the target in source axes, in units of the distance at which everything is taken to
                be from it; 0 where both share one centre, or everything is taken to be infinitely far.
        """
        self.source, self.target = source, target
        self._sampled = target.resized(target.width * samples, target.height * samples)
        pixels, seen = _source_pixels(source, self._sampled, R_source_target, shift)
        self.seen = seen.reshape(target.height, samples, target.width, samples).all(axis=(1, 3))
        complete = self.seen.repeat(samples, axis=0).repeat(samples, axis=1)
        levels = np.minimum(_mip_levels(pixels), int(np.log2(min(source.width, source.height))))
        self._levels: list[int] = np.unique(levels[complete]).tolist()
        table = np.full((*complete.shape, 2), _NOWHERE, np.float32)
        top = 0
        for level in self._levels:
            chosen = complete & (levels == level)
            width, height = self._level_size(level)
            inside = (pixels[chosen] + 0.5) * [width / source.width, height / source.height] - 0.5
            # The outer half of the border pixels shows the border, and none of the level below it in the atlas.
            table[chosen] = np.clip(inside, 0.0, [width - 1, height - 1])
            table[chosen, 1] += top
            top += height
        # Two maps, because `cv2.remap` of OpenCV 5 takes an empty second one for something else and says nothing.
        self._maps = cv2.convertMaps(table[..., 0], table[..., 1], cv2.CV_16SC2)

    def remap(self, images: Images) -> Images:
        """Images (n, H, W, 3) or one image (H, W, 3) of the source as the target sees them.

        Raises:
            InputError: the images have not the size of the source camera.
        """
        size = (self.source.height, self.source.width, 3)
        if images.shape[-3:] != size or images.ndim > 4:
            raise InputError(f"remap: images {images.shape} for a camera of {size}; give the camera at their size")
        if images.ndim == 3:
            return self._remap_one(images)
        remapped = np.empty((len(images), self.target.height, self.target.width, 3), np.uint8)
        for image, result in zip(images, remapped, strict=True):
            result[:] = self._remap_one(image)
        return remapped

    def _remap_one(self, image: Images) -> Images:
        if not self._levels:
            return np.zeros((self.target.height, self.target.width, 3), np.uint8)
        sampled = cv2.remap(self._atlas(image), *self._maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        if self._sampled.width == self.target.width:
            return np.asarray(sampled, np.uint8)
        size = (self.target.width, self.target.height)
        return np.asarray(cv2.resize(sampled, size, interpolation=cv2.INTER_AREA), np.uint8)

    def _atlas(self, image: Images) -> Images:
        """The levels that are needed, one below the other."""
        levels, halved = [], image
        for level in range(self._levels[-1] + 1):
            if level > 0:
                halved = np.asarray(cv2.resize(halved, self._level_size(level), interpolation=cv2.INTER_AREA), np.uint8)
            if level in self._levels:
                levels.append(halved)
        if len(levels) == 1:
            return levels[0]
        atlas = np.empty((sum(len(level) for level in levels), levels[0].shape[1], 3), np.uint8)
        top = 0
        for level in levels:
            atlas[top : top + len(level), : level.shape[1]] = level
            top += len(level)
        return atlas

    def _level_size(self, level: int) -> tuple[int, int]:
        """Width and height of the source halved `level` times."""
        return max(1, self.source.width >> level), max(1, self.source.height >> level)


def _source_pixels(
    source: Camera, target: Camera, R_source_target: Array, shift: ArrayLike = (0.0, 0.0, 0.0)
) -> tuple[Array, Mask]:
    return source.project(pixel_rays(target) @ R_source_target.T + np.asarray(shift))


def _mip_levels(pixels: Array) -> NDArray[np.int64]:
    """How often (h, w) the source is halved; 0 where it is enlarged or the neighbours (h, w, 2) are unknown."""
    down, right = (np.gradient(pixels, axis=axis) for axis in (0, 1))
    # Side in source pixels of the square as large as a target pixel.
    side = np.sqrt(np.abs(right[..., 0] * down[..., 1] - right[..., 1] * down[..., 0]))
    known = np.nan_to_num(_LEVEL_SWITCH * side, nan=1.0, posinf=1.0)
    return np.rint(np.log2(np.maximum(known, 1.0))).astype(np.int64)
