"""Views of cameras that were not there, from the front camera's frames: warp what they saw, invent the rest, say so.

What the front camera sees at the same moment comes first: it is right for moving objects too. Behind it comes what it
saw at other moments, of things that stand still, and then smooth colours.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera
from olt_generator.distance.depth import FAR_DISTANCE
from olt_generator.poses import Array, invert
from olt_generator.progress import Progress, silent
from olt_generator.views.aggregate import SourceFrame, gather
from olt_generator.views.brightness import Brightness
from olt_generator.views.coherence import make_coherent
from olt_generator.views.fill import fill_holes
from olt_generator.views.front_view import FrontView
from olt_generator.views.panorama import Panorama
from olt_generator.views.pixel_origin import PixelOrigin
from olt_generator.views.source_frames import SourceChooser
from olt_generator.views.surface_mesh import SurfaceMesh, build_mesh

# Columns to which the same frame is reduced for its mesh: finer than distances by parallax are.
_SAME_COLUMNS = 320
# Columns to which other frames are reduced: as fine as distances by parallax are (`depth.SweepSettings`), or nearly.
_MESH_COLUMNS = 208
# Meshes of other frames that are kept for the next images.
_KEPT_MESHES = 32
# Source pixels for each target pixel from which on an image is blurred before it is looked up, and by how much: the
# blur that takes a pixel to one `shrink` times as wide.
_LEAST_SHRINK, _BLUR = 1.2, 0.4


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
    least_confidence: float = 0.15


@dataclass(frozen=True)
class SynthesizedView:
    """Images of a camera that was not there.

    Attributes:
        images: (m, h, w, 3) uint8.
        origin: (m, h, w) uint8, a `PixelOrigin` per pixel. A pixel is invented where no source pixel lands on any part
            of it.
        drawn_on: for each image the other frames that it was made from.
        notes: a sentence for everything about the view that its name does not promise.
    """

    images: NDArray[np.uint8]
    origin: NDArray[np.uint8]
    drawn_on: tuple[tuple[int, ...], ...]
    notes: tuple[str, ...] = ()

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


class _Synthesis:
    """Everything that stays the same from image to image of one view."""

    def __init__(self, front: FrontView, target: Camera, T_rig_target: Array, settings: SynthesisSettings) -> None:
        self._front, self._settings = front, settings
        self._T_target_rig = invert(T_rig_target)
        self._target, self._T_rig_target = target, T_rig_target
        self._panorama = Panorama(target, T_rig_target, front.camera, front.T_rig_camera)
        self._chooser = SourceChooser(front, target, T_rig_target, settings.other_frames)
        self._brightness = Brightness(front)
        self._standing = lru_cache(_KEPT_MESHES)(self._find_standing)

    def other_frames(self, index: int) -> tuple[int, ...]:
        """The other frames that the image of a frame is made from."""
        lookback = self._settings.lookback
        looked_back_to = () if lookback is None else tuple({self._front.look_back(index, lookback)} - {index})
        return self._chooser.choose(index, looked_back_to)

    def make(self, index: int, others: tuple[int, ...]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """The image (h, w, 3) of one frame, and a `PixelOrigin` for each of its pixels (h, w)."""
        front, distance = self._front, self._front.distance[index]
        others_shown = [self._other_source(index, other) for other in others]
        seen = gather(self._same_source(index), others_shown, front.camera, self._target, self._T_rig_target)
        visible = np.isfinite(seen.distance)
        origin = np.where(visible, PixelOrigin.OTHER_FRAME, PixelOrigin.INVENTED).astype(np.uint8)
        origin[seen.from_same] = PixelOrigin.SAME_FRAME
        far = visible & (seen.distance > 0.9 * FAR_DISTANCE)
        background = self._panorama.background(
            seen.image, visible, far, front.frames[index], ~np.isnan(distance), distance >= FAR_DISTANCE
        )
        return fill_holes(seen.image, visible, background), origin

    def _same_source(self, index: int) -> SourceFrame:
        """All of the frame of that moment, blurred as far as the lost resolution asks."""
        front, image = self._front, self._front.frames[index]
        distance = np.minimum(front.distance[index], np.float32(FAR_DISTANCE))
        trust = front.trust(index)
        if trust is not None:
            distance = make_coherent(image, distance, trust)
        shrink = front.camera.pixels_per_radian[0] / self._target.pixels_per_radian[0]
        if shrink > _LEAST_SHRINK:
            image = np.asarray(cv2.GaussianBlur(image, (0, 0), _BLUR * np.sqrt(shrink**2 - 1.0)), np.uint8)
        mesh = build_mesh(distance, front.camera, max(1, round(front.camera.width / _SAME_COLUMNS)))
        return SourceFrame(image, distance, mesh, self._T_target_rig @ front.T_rig_camera)

    def _other_source(self, index: int, other: int) -> SourceFrame:
        """What may be taken from another frame."""
        front = self._front
        T_target_world = self._T_target_rig @ invert(front.trajectory.T_world_rig[index])
        distance, mesh = self._standing(other)
        T_target_camera = T_target_world @ front.camera_poses[other]
        return SourceFrame(front.frames[other], distance, mesh, T_target_camera, self._brightness.ratio(index, other))

    def _find_standing(self, other: int) -> tuple[NDArray[np.float32], SurfaceMesh]:
        """Distance (H, W) in another frame, NaN where it moves or is not trusted, and the mesh of it."""
        front = self._front
        known = front.distance[other]
        distance = np.where(known < FAR_DISTANCE, known, np.where(np.isnan(known), known, np.float32(np.inf)))
        if front.moving is not None:
            distance[front.moving[other]] = np.nan
        if front.confidence is not None:
            distance[front.confidence[other] < self._settings.least_confidence] = np.nan
        return distance, build_mesh(distance, front.camera, max(1, round(front.camera.width / _MESH_COLUMNS)))
