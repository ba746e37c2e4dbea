"""Distance from the parallax between two frames of a moving camera: dense optical flow, then triangulation."""

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera, pixel_rays
from olt_generator.poses import Array, invert, transform

# Metres between the frames of a pair that are aimed at, and that are needed: 1.2 m give 2 pixels of flow at half of
# 832 columns for a point 50 m away, 30 degrees off the direction of travel.
BASELINE = 1.2
SHORTEST_BASELINE = 0.3
MOST_FRAMES_APART = 15

# Flow is taken at half size: a quarter of the time, and larger motions are followed.
FLOW_SCALE = 0.5

# Where two rays are believed: pixels between a point and where flow there and back takes it; radians by which the
# rays may pass each other; radians between them, below which their crossing only says that the point is far; grey
# levels of contrast without which there is nothing to follow.
ROUND_TRIP_TOLERANCE = 1.0
EPIPOLAR_TOLERANCE = 0.004
LEAST_PARALLAX = 0.004
LEAST_CONTRAST = 2.0

# Rows and columns over which contrast and mismatch are taken, and the share of the contrast by which a background may
# miss the picture.
WINDOW = (7, 7)
LARGEST_MISMATCH = 0.4

# Share by which a distance may differ from the median of its 5 x 5 neighbours.
SPECKLE_TOLERANCE = 0.15


def choose_partners(positions: Array) -> list[int | None]:
    """The frame that each frame is matched with, from camera positions (n, 3); None where the camera hardly moved.

    The baseline comes close to `BASELINE`. Earlier frames are preferred: driving forward, what is seen now was in view
    before, while much of it leaves the view soon.
    """
    partners: list[int | None] = []
    for index, position in enumerate(positions):
        first = max(0, index - MOST_FRAMES_APART)
        baselines = np.linalg.norm(positions[first : index + MOST_FRAMES_APART + 1] - position, axis=1)
        misfit = np.abs(baselines - BASELINE)
        misfit[index - first :] += 0.5 * BASELINE
        best = int(np.argmin(np.where(baselines < SHORTEST_BASELINE, np.inf, misfit)))
        partners.append(first + best if baselines[best] >= SHORTEST_BASELINE else None)
    return partners


class ParallaxMatcher:
    """Triangulates the pixels of pairs of frames of one clip, at reduced size.

    Attributes:
        camera: the camera of the reduced frames, (h, w) pixels.
    """

    def __init__(self, frames: NDArray[np.uint8], camera: Camera) -> None:
        self.camera = camera.resized(round(FLOW_SCALE * camera.width), round(FLOW_SCALE * camera.height))
        size = (self.camera.width, self.camera.height)
        self._grey = [
            cv2.cvtColor(cv2.resize(frame, size, interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2GRAY) for frame in frames
        ]
        self._flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)

    def nearness(
        self, index: int, partner: int, T_frame_partner: Array, background: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """One over the distance (h, w) along the rays of frame `index`, 1/m, from its parallax to `partner`.

        0 where there is nothing in front of the `background` at these distances (h, w) or only plain sky; NaN where
        the picture does not tell.
        """
        grey, partner_grey = self._grey[index], self._grey[partner]
        matched, round_trip = self._match(grey, partner_grey)
        contrast = _contrast(grey)
        plain = contrast < LEAST_CONTRAST
        followed = ~plain & (round_trip < ROUND_TRIP_TOLERANCE)
        rays = pixel_rays(self.camera)[followed]
        partner_rays = self.camera.rays(matched[followed].astype(np.float64)) @ T_frame_partner[:3, :3].T
        nearness = np.full(grey.shape, np.nan, np.float32)
        nearness[followed] = _triangulate(rays, partner_rays, T_frame_partner[:3, 3])
        nearness[_is_speckle(nearness)] = np.nan
        # Road close to the vehicle runs too fast for optical flow, but it can be foretold.
        mismatch = self._mismatch(grey, partner_grey, T_frame_partner, background)
        nearness[np.isnan(nearness) & ~plain & (mismatch < LARGEST_MISMATCH * contrast)] = 0.0
        open_sky = np.logical_and.accumulate(plain, axis=0)
        nearness[open_sky] = 0.0
        return nearness

    def _mismatch(
        self,
        grey: NDArray[np.uint8],
        partner_grey: NDArray[np.uint8],
        T_frame_partner: Array,
        distance: NDArray[np.float32],
    ) -> NDArray[np.float32]:
        """Mean difference in grey levels (h, w) around each pixel if it lies at `distance` (h, w); inf if unseen."""
        points = pixel_rays(self.camera) * distance[..., None]
        pixels, seen = self.camera.project(transform(invert(T_frame_partner), points))
        columns, rows = np.moveaxis(pixels.astype(np.float32), -1, 0)
        difference = cv2.absdiff(grey, cv2.remap(partner_grey, columns, rows, cv2.INTER_LINEAR)).astype(np.float32)
        return np.where(seen, cv2.blur(difference, WINDOW), np.float32(np.inf))

    def _match(
        self, grey: NDArray[np.uint8], partner_grey: NDArray[np.uint8]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Where each pixel is found in the partner (h, w, 2), and how far flow there and back takes it (h, w)."""
        there, back = self._flow_between(grey, partner_grey), self._flow_between(partner_grey, grey)
        rows, columns = np.indices(grey.shape, dtype=np.float32)
        columns, rows = columns + there[..., 0], rows + there[..., 1]
        outside = (1e4, 1e4, 0.0, 0.0)
        back_there = cv2.remap(
            back, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=outside
        )
        return np.stack([columns, rows], axis=-1), np.linalg.norm(there + back_there, axis=-1)

    def _flow_between(self, grey: NDArray[np.uint8], other_grey: NDArray[np.uint8]) -> NDArray[np.float32]:
        # The stubs of OpenCV do not know that the flow to start from may be left out.
        return self._flow.calc(grey, other_grey, None)  # pyright: ignore


def _triangulate(rays: Array, partner_rays: Array, baseline: Array) -> Array:
    """Nearness (k,), one over the distance along unit rays (k, 3) to where they meet rays (k, 3) from `baseline` (3,).

    0 where the rays are as good as parallel, NaN where they pass too far from each other or meet behind a camera.
    """
    between = np.cross(rays, partner_rays)
    epipolar_normal = np.cross(baseline, rays)
    # From s r = b + u p: the cross product with p gives s, that with r gives u, both times the squared sine.
    along = (np.cross(baseline, partner_rays) * between).sum(axis=1)
    partner_along = (epipolar_normal * between).sum(axis=1)
    off_plane = np.abs((epipolar_normal * partner_rays).sum(axis=1)) / np.linalg.norm(epipolar_normal, axis=1)
    met = (off_plane < EPIPOLAR_TOLERANCE) & (along > 0.0) & (partner_along > 0.0)
    squared_sine = (between**2).sum(axis=1)
    nearness = np.divide(squared_sine, along, out=np.full(len(rays), np.nan), where=met)
    return np.where(squared_sine < LEAST_PARALLAX**2, 0.0, nearness)


def _contrast(grey: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Standard deviation (h, w) of the grey levels around each pixel."""
    values = grey.astype(np.float32)
    mean = cv2.blur(values, WINDOW)
    return np.sqrt(np.maximum(cv2.blur(values**2, WINDOW) - mean**2, 0.0))


def _is_speckle(nearness: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Pixels (h, w) that do not share the nearness of their 5 x 5 neighbourhood; unknown neighbours count as far."""
    known = np.nan_to_num(nearness, nan=0.0)
    return np.abs(cv2.medianBlur(known, 5) - known) > SPECKLE_TOLERANCE * known
