"""How coherent a made-up view is, without its truth: held against the front view of the same moments.

GeoKPM counts matches, and matches are found between specks too. Here four things are measured on a view as on the front
view, which is a real video of the same scene, light and lens noise, at the same pixels per radian:

- detail: of blocks with texture, the mean difference from the median over 5 x 5 pixels, as share of the contrast. The
  median keeps edges and takes specks away, so specks and shreds have more of it than the front view, and what is
  smeared has less. Smooth blocks do not count: what is invented is told elsewhere.
- flicker: the mean difference of an image from the one before, moved by dense optical flow (Kroeger et al., Fast
  Optical Flow using Dense Inverse Search, 2016).
- agreement: of textured blocks of the front image, turned into the view, the best correlation with the view near their
  place (things are nearer than infinity), and the gap: how much brighter or darker the view is there. Both only where
  both cameras look, so they may not be known.

Each gives a penalty in powers of two, and coherence is 100 %, halved by each weighted unit of them. It ranks more and
less of one fault well, and faults of different kinds poorly (`olt bench coherence`), because there is no one scale for
them: look at the penalties too. True views do not reach 100 %, because a side view is not like a front view: compare
values of one clip, or of one kind of view.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera
from olt_generator.errors import InputError
from olt_generator.lenses.remap import Remapper
from olt_generator.metrics.cross_view_consistency import PosedView
from olt_generator.poses import invert
from olt_generator.progress import Progress, silent

# Powers of two for each unit of a penalty: near the best of a coarse grid for the rank correlation with rms and SSIM
# over faults of five kinds in four films of the synthetic world; more for specks and flicker, which no single image
# shows well.
WEIGHTS = {"specks": 0.5, "blur": 1.0, "flicker": 0.25, "agreement": 0.5, "gap": 0.5}
# Side of the median, and the difference in grey levels that noise makes.
_MEDIAN, _NOISE = 5, 0.5
# Side of the blocks that are compared, how far each is searched in the view, as shares of its width, and the contrast
# in grey levels from which on a block has texture.
_BLOCK, _SEARCH = 1.0 / 24.0, 1.0 / 24.0
_LEAST_CONTRAST = 6.0
_LEAST_BLOCKS = 3
# Grey levels of a gap that count as one.
_GAP = 16.0
# Agreement below which nothing gets worse.
_LEAST_AGREEMENT = 0.05


@dataclass(frozen=True)
class Coherence:
    """Means over the moments, in grey levels of 255.

    Attributes:
        detail, front_detail: fine detail of the view and of the front view, as share of contrast; None without texture.
        flicker, front_flicker: what motion does not explain; None where there is one moment.
        agreement: correlation with the front view where both look; None where they do not, or see no texture.
        gap: difference in brightness there.
    """

    detail: float | None
    front_detail: float | None
    flicker: float | None
    front_flicker: float | None
    agreement: float | None
    gap: float | None

    @property
    def penalties(self) -> dict[str, float | None]:
        """What is wrong, in powers of two, by the names of `WEIGHTS`; None for what is not known."""
        detail, flicker = None, None
        if self.detail is not None and self.front_detail is not None:
            detail = float(np.log2(self.detail / self.front_detail))
        if self.flicker is not None and self.front_flicker is not None:
            flicker = max(0.0, _log_ratio(self.flicker, self.front_flicker))
        return {
            "specks": None if detail is None else max(0.0, detail),
            "blur": None if detail is None else max(0.0, -detail),
            "flicker": flicker,
            "agreement": None if self.agreement is None else -float(np.log2(max(self.agreement, _LEAST_AGREEMENT))),
            "gap": None if self.gap is None else float(np.log2(1.0 + self.gap / _GAP)),
        }

    @property
    def percent(self) -> float:
        """Coherence: 100 where a view is in all that was measured as the front view is."""
        return 100.0 * 2.0 ** -sum(WEIGHTS[name] * value for name, value in self.penalties.items() if value is not None)


def join_coherence(parts: Sequence[Coherence]) -> Coherence:
    """The mean of several measurements, at least one, of each value over those that have it."""

    def mean(name: str) -> float | None:
        values = [value for part in parts if (value := getattr(part, name)) is not None]
        return float(np.mean(values)) if values else None

    return Coherence(**{field.name: mean(field.name) for field in fields(Coherence)})  # pyright: ignore[reportArgumentType]


def measure_coherence(view: PosedView, front: PosedView, on_progress: Progress = silent) -> Coherence:
    """Measure a view against the front view; image k of one belongs to image k of the other, in order of time.

    Raises:
        InputError: the numbers of images differ, or there is none.
    """
    if len(view.images) != len(front.images) or len(view.images) == 0:
        counts = f"{len(view.images)} and {len(front.images)}"
        raise InputError(f"coherence: views of {counts} images; give one image of each per moment")
    scaled = _at_scale(front.camera, view.camera)
    T_front_view = invert(front.T_world_camera) @ view.T_world_camera
    greys, front_greys, agreements = [], [], []
    for moment, (image, front_image) in enumerate(zip(view.images, front.images, strict=True)):
        greys.append(_grey(image))
        small = cv2.resize(front_image, (scaled.width, scaled.height), interpolation=cv2.INTER_AREA)
        front_greys.append(_grey(np.asarray(small, np.uint8)))
        turned = Remapper(front.camera, view.camera, T_front_view[moment, :3, :3])
        agreements += _agreements(_grey(turned.remap(front_image)), np.asarray(turned.seen), greys[-1])
        on_progress((moment + 1) / len(view.images))
    enough = len(agreements) >= _LEAST_BLOCKS
    agreement, gap = np.mean(agreements, axis=0).tolist() if enough else (None, None)
    return Coherence(
        detail=_detail(greys),
        front_detail=_detail(front_greys),
        flicker=_flicker(greys),
        front_flicker=_flicker(front_greys),
        agreement=agreement,
        gap=gap,
    )


def _log_ratio(value: float, reference: float) -> float:
    return float(np.log2((value + _NOISE) / (reference + _NOISE)))


def _at_scale(camera: Camera, other: Camera) -> Camera:
    """The camera resized to the pixels per radian of the other."""
    scale = other.pixels_per_radian[0] / camera.pixels_per_radian[0]
    return camera.resized(max(16, round(camera.width * scale)), max(16, round(camera.height * scale)))


def _grey(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)


def _detail(greys: list[NDArray[np.uint8]]) -> float | None:
    """Mean over all textured blocks of the difference from the median, by the block's standard deviation."""
    height, width = greys[0].shape
    side = max(8, round(_BLOCK * width))
    size, shares = (width // side, height // side), []
    for grey in greys:
        values = grey.astype(np.float32)
        difference = cv2.absdiff(grey, cv2.medianBlur(grey, _MEDIAN)).astype(np.float32)
        mean, square, rough = (
            np.asarray(cv2.resize(each, size, interpolation=cv2.INTER_AREA), np.float64)
            for each in (values, values * values, difference)
        )
        contrast = np.sqrt(np.maximum(square - mean**2, 0.0))
        shares.append((rough / np.maximum(contrast, _LEAST_CONTRAST))[contrast >= _LEAST_CONTRAST])
    share = np.concatenate(shares)
    return float(share.mean()) if len(share) >= _LEAST_BLOCKS else None


def _flicker(greys: list[NDArray[np.uint8]]) -> float | None:
    if len(greys) < 2:
        return None
    flow_of = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    height, width = greys[0].shape
    place = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(np.float32)
    left = []
    for before, after in pairwise(greys):
        source = place + flow_of.calc(after, before, np.zeros((height, width, 2), np.float32))
        inside = (source >= 0).all(axis=-1) & (source <= (width - 1, height - 1)).all(axis=-1)
        moved = cv2.remap(before, source[..., 0], source[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        difference = cv2.absdiff(after, np.asarray(moved, np.uint8))
        if inside.any():
            left.append(float(difference[inside].mean()))
    return float(np.mean(left)) if left else None


def _agreements(
    turned: NDArray[np.uint8], seen: NDArray[np.bool_], grey: NDArray[np.uint8]
) -> list[tuple[float, float]]:
    """Of each textured block that the front camera sees, the best correlation with the view around it, and the gap."""
    height, width = grey.shape
    side, reach = max(8, round(_BLOCK * width)), max(2, round(_SEARCH * width))
    found = []
    for top in range(reach, height - side - reach + 1, side):
        for left in range(reach, width - side - reach + 1, side):
            rows, columns = slice(top, top + side), slice(left, left + side)
            block = turned[rows, columns]
            if not seen[rows, columns].all() or block.std() < _LEAST_CONTRAST:
                continue
            around = grey[top - reach : top + side + reach, left - reach : left + side + reach]
            match = np.nan_to_num(cv2.matchTemplate(around, block, cv2.TM_CCOEFF_NORMED), posinf=0.0, neginf=0.0)
            down, right = np.unravel_index(int(match.argmax()), match.shape)
            gap = abs(float(around[down : down + side, right : right + side].mean()) - float(block.mean()))
            found.append((max(0.0, float(match.max())), gap))
    return found
