"""Whether the front-tele view lies inside the front-wide view, where both cameras' calibration puts it.

Both cameras sit so close together that they see nearly the same; the front-wide image is turned into what the tele
camera should see and held against what it shows. So that neither light nor the general look of a road count, slow
changes of brightness are taken out first. What is found is compared with what is wrong: places in the front view where
the tele does not look, the mirrored tele image, and the front view at other times.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import remap_table
from olt_generator.poses import Array
from olt_toolkit.clips.verification.image_steps import CameraImages

Table = tuple[NDArray[np.float32], NDArray[np.bool_]]

# Pairs of images that are compared, spread over the clip.
MOST_PAIRS = 10
# Images of a pair are at most so far apart in time.
LONGEST_APART_US = 60_000
# Width of the compared tele image, and how far around its place the front view is searched, in its widths.
WIDTH, MARGIN = 120, 0.5
# Brightness is compared after changes slower than so many pixels have been taken out.
DETAIL_PIXELS = 6.0
# Pixels that are left out along the border of what was seen: twice as far as the border reaches.
_BORDER = 2 * int(DETAIL_PIXELS) + 1
# The tele image lies at its place if it is no farther away, pixels: near things are seen from the side.
AT_PLACE = 5
# An image whose detail has a smaller standard deviation, grey levels, shows nothing to compare.
LEAST_CONTRAST = 2.0
# How sure a difference of correlations must be, in standard errors over pairs of images, and how many it takes.
CERTAIN = 4.0
LEAST_PAIRS = 5
# Shifts in time that are tried, seconds.
SHIFTS = (-1.0, -0.7, -0.5, -0.3, -0.2, -0.1, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0)


@dataclass(frozen=True)
class TeleMatch:
    """Correlations of the tele image with the front view, for each of (p,) pairs of images; NaN where not compared.

    Attributes:
        at_place: where it should lie.
        elsewhere: the best one at any other place.
        mirrored: the best one of the mirrored image, anywhere.
        shifted: (p, len(SHIFTS)) where it should lie, with the front view later by `SHIFTS` seconds.
    """

    at_place: Array
    elsewhere: Array
    mirrored: Array
    shifted: Array


def match_tele(front: CameraImages, tele: CameraImages) -> TeleMatch:
    """Hold the tele images against the front view."""
    lens = tele.lens.resized(WIDTH, round(tele.lens.height * WIDTH / tele.lens.width))
    across, down = round(MARGIN * lens.width), round(MARGIN * lens.height)
    searched = lens.cropped(-across, -down, lens.width + 2 * across, lens.height + 2 * down)
    table = remap_table(front.lens, searched, front.T_rig_camera[:3, :3].T @ tele.T_rig_camera[:3, :3])
    partners = nearest_images(front.times_us, tele.times_us)
    together = np.flatnonzero(np.abs(front.times_us[partners] - tele.times_us) <= LONGEST_APART_US)
    chosen = together[np.unique(np.linspace(0, len(together) - 1, min(MOST_PAIRS, len(together))).round().astype(int))]

    def in_front(index: int) -> NDArray[np.float32]:
        return turned_detail(front, index, table)

    rows = [
        _match(
            _shrunk_detail(tele, index, (lens.width, lens.height)),
            [in_front(int(partners[index])), *(in_front(i) if i >= 0 else None for i in _shifted(front, tele, index))],
            (down, across),
        )
        for index in chosen.tolist()
    ]
    table_of = np.array(rows).reshape(len(rows), 3 + len(SHIFTS))
    return TeleMatch(table_of[:, 0], table_of[:, 1], table_of[:, 2], table_of[:, 3:])


def nearest_images(times_us: NDArray[np.int64], wanted_us: NDArray[np.int64]) -> NDArray[np.int64]:
    """Numbers (m,) of the images at times (n,) that are nearest to the wanted times (m,)."""
    after = np.clip(np.searchsorted(times_us, wanted_us), 1, max(len(times_us) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(times_us) - 1)
    return np.where(wanted_us - times_us[before] <= times_us[after] - wanted_us, before, after)


def surely_above(values: Array, least: float) -> bool:
    """Whether the mean of differences (p,) of correlations is above `least`, and clearly above 0 for its spread."""
    known = values[np.isfinite(values)]
    if len(known) < LEAST_PAIRS:
        return False
    error = max(float(known.std(ddof=1)) / np.sqrt(len(known)), 1e-6)
    return float(known.mean()) > least and float(known.mean()) > CERTAIN * error


def warp(image: NDArray[np.uint8], table: NDArray[np.float32]) -> NDArray[np.uint8]:
    """An image (h, w) as a `remap_table` says."""
    # Two maps, because `cv2.remap` of OpenCV 5 takes an empty second one for something else and says nothing.
    maps = cv2.convertMaps(table[..., 0], table[..., 1], cv2.CV_16SC2)
    return np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT), np.uint8)


def turned_detail(images: CameraImages, frame: int, table: Table) -> NDArray[np.float32]:
    """Detail of one image turned into another view by a `remap_table`; 0 where no camera saw anything."""
    maps, known = table
    observed = images.seen_in(frame)
    if observed is not None:
        known = known & (warp(observed.astype(np.uint8), maps) > 0)
    return _within(detail(warp(images.grays[frame], maps)), known)


def _shrunk_detail(images: CameraImages, frame: int, size: tuple[int, int]) -> NDArray[np.float32]:
    bright = detail(np.asarray(cv2.resize(images.grays[frame], size, interpolation=cv2.INTER_AREA), np.uint8))
    observed = images.seen_in(frame)
    if observed is None:
        return bright
    return _within(bright, cv2.resize(observed.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0)


def _within(bright: NDArray[np.float32], known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Detail (h, w) well inside of what was seen, whose border is none; 0 elsewhere."""
    inside = cv2.erode(known.astype(np.uint8), np.ones((_BORDER, _BORDER), np.uint8), borderValue=1) > 0
    return np.where(inside, bright, 0.0).astype(np.float32)


def detail(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """An image (h, w) without its slow changes of brightness."""
    bright = image.astype(np.float32)
    return bright - cv2.GaussianBlur(bright, (0, 0), DETAIL_PIXELS)


def _shifted(front: CameraImages, tele: CameraImages, index: int) -> list[int]:
    """The front images at each of `SHIFTS`, -1 where there is none."""
    wanted = tele.times_us[index] + np.round(np.array(SHIFTS) * 1e6).astype(np.int64)
    found = nearest_images(front.times_us, wanted)
    return np.where(np.abs(front.times_us[found] - wanted) <= LONGEST_APART_US, found, -1).tolist()


def _match(tele: NDArray[np.float32], fronts: list[NDArray[np.float32] | None], place: tuple[int, int]) -> list[float]:
    """At place, elsewhere, mirrored, and at place at other times."""
    now = fronts[0]
    assert now is not None
    if tele.std() < LEAST_CONTRAST or now.std() < LEAST_CONTRAST:
        return [np.nan] * (3 + len(SHIFTS))
    surface = cv2.matchTemplate(now, tele, cv2.TM_CCOEFF_NORMED)
    rows, columns = (slice(max(0, middle - AT_PLACE), middle + AT_PLACE + 1) for middle in place)
    around = surface.copy()
    rows_around, columns_around = (slice(max(0, middle - 2 * AT_PLACE), middle + 2 * AT_PLACE + 1) for middle in place)
    around[rows_around, columns_around] = -1.0
    mirrored = cv2.matchTemplate(now, np.ascontiguousarray(tele[:, ::-1]), cv2.TM_CCOEFF_NORMED)
    window = (slice(rows.start, rows.stop + tele.shape[0] - 1), slice(columns.start, columns.stop + tele.shape[1] - 1))
    shifted = [
        np.nan if other is None else float(cv2.matchTemplate(other[window], tele, cv2.TM_CCOEFF_NORMED).max())
        for other in fronts[1:]
    ]
    return [float(surface[rows, columns].max()), float(around.max()), float(mirrored.max()), *shifted]
