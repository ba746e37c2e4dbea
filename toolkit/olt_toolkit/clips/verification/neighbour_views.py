"""Whether two cameras that look over the same ground show the same there.

Both images are turned into the view of one camera that looks into the middle of what both see. Patches of the one are
looked for in the other near by: cameras sit apart, so near things are shifted a little, each by its own distance. How
well they are found is compared with what is wrong: the other camera's view at other times, and the mirrored view.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import FthetaCamera, remap_table
from olt_generator.poses import Array, camera_pose_in_rig
from olt_toolkit.clips.verification.image_steps import CameraImages
from olt_toolkit.clips.verification.shared_view import LONGEST_APART_US, SHIFTS, nearest_images, turned_detail

# Pairs of images that are compared, spread over the clip.
MOST_PAIRS = 10
# Pixels a degree of the common view, its height in degrees, and the overlap of two cameras that is worth a look.
PIXELS_PER_DEGREE, HEIGHT_DEGREES, LEAST_OVERLAP = 3.0, 24.0, 16.0
# Degrees that are left out at the borders of what both see.
BORDER = 3.0
# Side of a patch, and how far it is looked for to the side and up or down, pixels.
PATCH, ASIDE, UPWARD = 20, 12, 5
# Patches whose detail has a smaller standard deviation, grey levels, are left out.
LEAST_CONTRAST = 2.5
# A common view with fewer patches tells nothing.
LEAST_PATCHES = 4
# Of more patches than this, some that are spread over the view are looked for.
MOST_PATCHES = 12


@dataclass(frozen=True)
class NeighbourMatch:
    """Mean correlations of patches of one view in the other, for each of (p,) pairs of images; NaN where not compared.

    Attributes:
        as_said: at the same time.
        mirrored: of the mirrored view.
        shifted: (p, len(SHIFTS)) with the first view later by `SHIFTS` seconds.
    """

    as_said: Array
    mirrored: Array
    shifted: Array


def common_view(first: CameraImages, second: CameraImages) -> tuple[FthetaCamera, Array] | None:
    """A camera that sees what both see along the horizon, and its rotation (3, 3) in the rig; None if it is little."""
    spans = [_azimuths(images) for images in (first, second)]
    turn = 360.0 * round((spans[0].mean() - spans[1].mean()) / 360.0)
    low, high = max(spans[0][0], spans[1][0] + turn) + BORDER, min(spans[0][1], spans[1][1] + turn) - BORDER
    if high - low < LEAST_OVERLAP:
        return None
    width, height = round((high - low) * PIXELS_PER_DEGREE), round(HEIGHT_DEGREES * PIXELS_PER_DEGREE)
    scale = float(np.degrees(PIXELS_PER_DEGREE))
    lens = FthetaCamera.equidistant(width, height, 0.5 * (width - 1), 0.5 * (height - 1), scale)
    middle = float(np.radians(0.5 * (low + high)))
    return lens, camera_pose_in_rig([0.0, 0.0, 0.0], 0.0, 0.0, middle)[:3, :3]


def match_neighbours(first: CameraImages, second: CameraImages) -> NeighbourMatch | None:
    """Look for patches of the second camera's view in the first one's; None where they see nothing in common."""
    common = common_view(first, second)
    if common is None:
        return None
    lens, R_rig_view = common
    tables = [remap_table(seen.lens, lens, seen.T_rig_camera[:3, :3].T @ R_rig_view) for seen in (first, second)]
    both = tables[0][1] & tables[1][1]
    partners = nearest_images(first.times_us, second.times_us)
    together = np.flatnonzero(np.abs(first.times_us[partners] - second.times_us) <= LONGEST_APART_US)
    chosen = together[np.unique(np.linspace(0, len(together) - 1, min(MOST_PAIRS, len(together))).round().astype(int))]
    rows = []
    for index in chosen.tolist():
        wanted = second.times_us[index] + np.round(np.array(SHIFTS) * 1e6).astype(np.int64)
        found = nearest_images(first.times_us, wanted)
        near = np.abs(first.times_us[found] - wanted) <= LONGEST_APART_US
        frames = [int(partners[index]), *np.where(near, found, -1).tolist()]
        views = [None if frame < 0 else turned_detail(first, frame, tables[0]) for frame in frames]
        patch_view = turned_detail(second, index, tables[1])
        places = _patches(patch_view, both)
        rows.append(_correlate(views, patch_view, places))
    table = np.array(rows).reshape(len(rows), 2 + len(SHIFTS))
    return NeighbourMatch(table[:, 0], table[:, 1], table[:, 2:])


def _azimuths(images: CameraImages) -> Array:
    """Degrees to the left, from right to left, between which a camera sees the horizon."""
    middle = images.lens.cy
    edges = images.lens.rays(np.array([[images.lens.width - 1.0, middle], [images.lens.cx, middle], [0.0, middle]]))
    right, centre, left = np.degrees(np.arctan2(*(edges @ images.T_rig_camera[:3, :3].T).T[[1, 0]]))
    return np.array([centre - (centre - right) % 360.0, centre + (left - centre) % 360.0])


def _patches(view: NDArray[np.float32], both: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Corners (row, column) of the patches of a view that both cameras see and that show something."""
    height, width = view.shape
    rows = range(UPWARD, height - PATCH - UPWARD + 1, PATCH)
    columns = range(ASIDE, width - PATCH - ASIDE + 1, PATCH // 2)
    places = [
        (row, column)
        for row in rows
        for column in columns
        if both[row : row + PATCH, column : column + PATCH].all()
        and view[row : row + PATCH, column : column + PATCH].std() > LEAST_CONTRAST
    ]
    return places[:: -(-len(places) // MOST_PATCHES) or 1]


def _correlate(
    views: list[NDArray[np.float32] | None], patch_view: NDArray[np.float32], places: list[tuple[int, int]]
) -> list[float]:
    """As said, mirrored, and at other times."""
    if len(places) < LEAST_PATCHES:
        return [np.nan] * (1 + len(views))
    patches = [patch_view[row : row + PATCH, column : column + PATCH] for row, column in places]
    flipped = [np.ascontiguousarray(patch[:, ::-1]) for patch in patches]
    now = views[0]
    scores = [np.nan if view is None else _score(view, patches, places) for view in views]
    return [scores[0], np.nan if now is None else _score(now, flipped, places), *scores[1:]]


def _score(view: NDArray[np.float32], patches: list[NDArray[np.float32]], places: list[tuple[int, int]]) -> float:
    found = [
        cv2.matchTemplate(
            view[row - UPWARD : row + PATCH + UPWARD, column - ASIDE : column + PATCH + ASIDE],
            patch,
            cv2.TM_CCOEFF_NORMED,
        ).max()
        for patch, (row, column) in zip(patches, places, strict=True)
    ]
    return float(np.mean(np.nan_to_num(found)))
