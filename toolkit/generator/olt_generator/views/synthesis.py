"""Views of cameras that were not there, from the front camera's frames: warp what they saw, invent the rest, say so.

What the front camera sees at the same moment comes first: it is right for moving objects too. Behind it comes what it
saw at other moments, of things that stand still, and then smooth colours.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera
from olt_generator.distance.depth import FAR_DISTANCE
from olt_generator.poses import Array, invert
from olt_generator.progress import Progress, silent
from olt_generator.views.aggregate import SourceFrame, gather
from olt_generator.views.brightness import brightened, relative_brightness
from olt_generator.views.fill import fill_holes
from olt_generator.views.front_view import FrontView
from olt_generator.views.panorama import Panorama
from olt_generator.views.pixel_origin import PixelOrigin
from olt_generator.views.road_view import RoadView
from olt_generator.views.source_frames import SourceChooser, may_be_seen
from olt_generator.views.splat import splat

# Splats of the same moment land in an image this many times as large, which is then averaged down: sub-pixel positions
# and edges are kept (PSNR on a made-up street: 10 dB above none, 4 dB above 2), and the 3 x 3 footprint is one pixel.
SUPERSAMPLING = 3
# Other frames saw things from farther away, so their splats must be larger to close up.
OTHER_FRAMES_SUPERSAMPLING = 2


@dataclass(frozen=True)
class SynthesisSettings:
    """How a view is made.

    Attributes:
        other_frames: how many other frames an image may draw on; 0 for what the same frame shows alone.
        lookback: take the frame so many latent frames back first (`lookback.LOOKBACK_LATENTS`); None for no such frame.
        least_confidence: pixels of other frames whose distance is trusted less are not used.
    """

    other_frames: int = 4
    lookback: int | None = None
    least_confidence: float = 0.4


@dataclass(frozen=True)
class SynthesizedView:
    """Images of a camera that was not there.

    Attributes:
        images: (m, h, w, 3) uint8.
        origin: (m, h, w) uint8, a `PixelOrigin` per pixel. A pixel is invented where no source pixel lands on any part
            of it.
        drawn_on: for each image the other frames that it was made from.
    """

    images: NDArray[np.uint8]
    origin: NDArray[np.uint8]
    drawn_on: tuple[tuple[int, ...], ...]

    @property
    def observed(self) -> NDArray[np.bool_]:
        """Pixels (m, h, w) that the front camera saw at some time; the rest is invented."""
        return self.origin != PixelOrigin.INVENTED


def synthesize_view(
    front: FrontView,
    target: Camera,
    T_rig_target: Array,
    indices: Sequence[int] | None = None,
    settings: SynthesisSettings | None = None,
    on_progress: Progress = silent,
) -> SynthesizedView:
    """Make the view of a camera mounted beside the front camera.

    A front pixel of frame s lands in the view at frame k by T = inv(T_rig_target) inv(T_world_rig[k])
    T_world_camera[s]; with s = k that is the same-frame warp inv(E_target) E_front.

    Args:
        front: the front camera's frames. Nothing of the frame itself is taken to be farther than `FAR_DISTANCE`; what
            is that far in other frames is only turned, not moved. Where `front.moving` is None, nothing moves.
        target, T_rig_target: camera of the wanted view, and its mounting (4, 4).
        indices: the m frames to make; all by default. Others are still drawn on.
        on_progress: told the share of images that are done.
    """
    synthesis = _Synthesis(front, target, T_rig_target, settings or SynthesisSettings())
    wanted = range(len(front)) if indices is None else indices
    size = (len(wanted), target.height, target.width)
    images, origin, drawn_on = np.empty((*size, 3), np.uint8), np.empty(size, np.uint8), []
    for done, index in enumerate(wanted):
        drawn_on.append(synthesis.other_frames(index))
        images[done], origin[done] = synthesis.make(index, drawn_on[-1])
        on_progress((done + 1) / len(wanted))
    return SynthesizedView(images, origin, tuple(drawn_on))


class _Layer(NamedTuple):
    """Part of one image: colours (h, w, 3), where they are known (h, w), and where that is far away (h, w)."""

    image: NDArray[np.uint8]
    visible: NDArray[np.bool_]
    far: NDArray[np.bool_]


class _Synthesis:
    """Everything that stays the same from image to image of one view."""

    def __init__(self, front: FrontView, target: Camera, T_rig_target: Array, settings: SynthesisSettings) -> None:
        self._front, self._settings = front, settings
        self._T_target_rig = invert(T_rig_target)
        self._same_frame_target, self._other_frames_target = (
            target.resized(target.width * factor, target.height * factor)
            for factor in (SUPERSAMPLING, OTHER_FRAMES_SUPERSAMPLING)
        )
        self._panorama = Panorama(target, T_rig_target, front.camera, front.T_rig_camera)
        self._road = RoadView(front.camera, target, T_rig_target)
        self._chooser = SourceChooser(front, target, T_rig_target, settings.other_frames)

    def other_frames(self, index: int) -> tuple[int, ...]:
        """The other frames that the image of a frame is made from."""
        lookback = self._settings.lookback
        looked_back_to = () if lookback is None else tuple({self._front.look_back(index, lookback)} - {index})
        return self._chooser.choose(index, looked_back_to)

    def make(self, index: int, others: tuple[int, ...]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """The image (h, w, 3) of one frame, and a `PixelOrigin` for each of its pixels (h, w)."""
        front = self._front
        distance = front.distance[index]
        within_reach = np.minimum(distance, np.float32(FAR_DISTANCE))
        T_target_camera = self._T_target_rig @ front.T_rig_camera
        warp = splat(front.frames[index], within_reach, front.camera, self._same_frame_target, T_target_camera)
        is_far = warp.distance > 0.9 * FAR_DISTANCE
        known = _averaged_down(warp.image, warp.visible, is_far, SUPERSAMPLING)
        origin = np.where(known.visible, PixelOrigin.SAME_FRAME, PixelOrigin.INVENTED).astype(np.uint8)
        if others:
            sources = [self._source(index, other) for other in others]
            image, source, far = gather(sources, front.camera, self._other_frames_target)
            warped = _averaged_down(image, source < len(sources), far, OTHER_FRAMES_SUPERSAMPLING)
            image, visible = self._road.look_up(sources)
            other = _laid_over(warped, _Layer(image, visible, np.zeros_like(visible)))
            origin[other.visible & ~known.visible] = PixelOrigin.OTHER_FRAME
            known = _laid_over(known, other)
        background = self._panorama.background(
            *known, front.frames[index], ~np.isnan(distance), distance >= FAR_DISTANCE
        )
        return fill_holes(known.image, known.visible, background), origin

    def _source(self, index: int, other: int) -> SourceFrame:
        """What may be taken from another frame."""
        front = self._front
        T_target_world = self._T_target_rig @ invert(front.trajectory.T_world_rig[index])
        T_target_camera = T_target_world @ front.camera_poses[other]
        distance = np.where(front.distance[other] < FAR_DISTANCE, front.distance[other], np.float32(np.inf))
        distance[np.isnan(front.distance[other])] = np.nan
        usable = may_be_seen(distance, front.camera, self._other_frames_target, T_target_camera)
        if front.moving is not None:
            usable &= ~front.moving[other]
        if front.confidence is not None:
            usable &= front.confidence[other] >= self._settings.least_confidence
        image = brightened(front.frames[other], relative_brightness(front, index, other))
        return SourceFrame(image, np.where(usable, distance, np.float32(np.nan)), T_target_camera)


def _laid_over(front: _Layer, behind: _Layer) -> _Layer:
    return _Layer(
        np.where(front.visible[..., None], front.image, behind.image),
        front.visible | behind.visible,
        np.where(front.visible, front.far, behind.far),
    )


def _averaged_down(image: NDArray[np.uint8], visible: NDArray[np.bool_], far: NDArray[np.bool_], factor: int) -> _Layer:
    """Mean of the visible parts of each pixel, and where there are any; far is what is so for the most part."""
    size = (image.shape[1] // factor, image.shape[0] // factor)
    share = cv2.resize(visible.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    # Parts where nothing landed are black and add nothing to the mean.
    mean = cv2.resize(image.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    mean /= np.maximum(share, 1e-6)[..., None]
    far_share = cv2.resize((visible & far).astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return _Layer(np.rint(mean).astype(np.uint8), share > 0.0, far_share > 0.5 * share)
