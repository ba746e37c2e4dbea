"""Multi-view stereo by plane sweep: which distance makes the other frames of a moving camera agree with this one.

Every hypothesis is a distance, the same along all rays. Frame by frame the picture that a partner should show if a
hypothesis were true is compared with what it shows (Collins, A space-sweep approach to true multi-image matching,
1996). The background, which is the road and beyond it the far, is the first hypothesis.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from olt_generator.cameras import Camera, pixel_rays
from olt_generator.distance.background import FAR_DISTANCE, background_distance, road_distance
from olt_generator.poses import Array, invert, transform

# Metres from the farthest to the nearest hypothesis; the ratio of two that follow each other is constant.
FARTHEST, NEAREST = 120.0, 3.5
# Metres at which the sky is judged.
WITHOUT_PARALLAX = np.float32(1e6)

# Metres between a frame and its partners that are aimed at. A hypothesis is judged by the baseline closest to this
# share of its distance: so all are told apart equally well, and near things are not lost from view.
BASELINES = (1.2, 3.0, 8.0)
BASELINE_SHARE = 0.15
MIDDLE_BASELINE = 1
# Least motion in metres that gives parallax.
SHORTEST_BASELINE = 0.3
MOST_FRAMES_APART = 40

# Pictures are compared after their local mean is taken away and their local contrast is made alike: what the camera's
# exposure changes cancels. Grey levels of noise that are not amplified, and of contrast in what is compared.
NORMALIZING_WINDOW = (9, 9)
NOISE = 6.0
GAIN = 40.0

# Pixels over which differences are summed, and where a difference stops to grow.
WINDOW = (5, 5)
LARGEST_DIFFERENCE = np.uint8(80)
NEUTRAL_DIFFERENCE = np.uint8(25)
# Differences are kept in these fractions of a grey level.
COST_SCALE = WINDOW[0] * WINDOW[1]

# Grey levels by which the background may match worse than something in front of it: it is what most pixels show.
ROAD_BONUS, FAR_BONUS = 5.0, 2.0

# Pixels between the rays whose warp is computed; the warp of the others is interpolated, which it is smooth enough for.
SPHERE_CELL = 16
BACKGROUND_CELL = 8


@dataclass(frozen=True)
class Match:
    """What the sweep says about the pixels of some rows of a frame; differences are grey levels after normalising.

    Attributes:
        distance: (rows, w) float32 metres of the best hypothesis, interpolated between hypotheses.
        mismatch: (rows, w) float32 mean difference of the best hypothesis.
        runner_up: (rows, w) float32 mean difference of the best of those that say something clearly different.
        mismatch_still: (rows, w) float32 mean difference of what keeps its place in the picture: it is far away or
            goes with the camera.
    """

    distance: NDArray[np.float32]
    mismatch: NDArray[np.float32]
    runner_up: NDArray[np.float32]
    mismatch_still: NDArray[np.float32]


def choose_partners(positions: Array, index: int, neighbours: int) -> list[list[int]]:
    """Frames to compare frame `index` with, up to `neighbours` for each of `BASELINES`, from positions (n, 3).

    One is taken from before and one from after: what one of them does not see, the other may. The better fit comes
    first; frames closer than `SHORTEST_BASELINE` are left out.
    """
    first = max(0, index - MOST_FRAMES_APART)
    moved = np.linalg.norm(positions[first : index + MOST_FRAMES_APART + 1] - positions[index], axis=1)
    here = index - first
    usable = np.flatnonzero(moved >= SHORTEST_BASELINE)
    partners = []
    for baseline in BASELINES:
        misfit = np.abs(np.log(np.maximum(moved, 1e-9) / baseline))
        sides = [side[np.argmin(misfit[side])] for side in (usable[usable < here], usable[usable > here]) if len(side)]
        partners.append([first + int(side) for side in sorted(sides, key=misfit.__getitem__)][:neighbours])
    return partners


class PlaneSweep:
    """Compares the frames of one clip under hypotheses of distance.

    Args:
        grey: n pictures (h, w) uint8.
        camera: the camera at their size.
        T_world_camera, T_rig_camera: (n, 4, 4) its poses, and (4, 4) its pose in the rig.
        planes: number of hypotheses besides the background.
        neighbours: 1 or 2 frames with which each hypothesis is judged.
    """

    def __init__(
        self,
        grey: list[NDArray[np.uint8]],
        camera: Camera,
        T_world_camera: Array,
        T_rig_camera: Array,
        planes: int,
        neighbours: int,
    ) -> None:
        self._pictures = [normalize_contrast(picture) for picture in grey]
        self.camera, self.T_rig_camera = camera, T_rig_camera
        self._T_world_camera, self._neighbours = T_world_camera, neighbours
        self.background = background_distance(camera, T_rig_camera)
        self._distances = np.geomspace(FARTHEST, NEAREST, planes)
        self._baseline_of = _suitable_baseline(self._distances)
        self._background_baseline = _suitable_baseline(self.background)

    def background_mismatch(self, index: int) -> NDArray[np.float32] | None:
        """Mean difference (h, w) in normalised grey levels if all is background; None where the camera hardly moved."""
        partners = self._partners(index)
        if not partners[0]:
            return None
        return _grey_levels(self._background_cost(index, partners, 0, self.camera.height))

    def match(self, index: int, top: int, bottom: int) -> Match | None:
        """The best hypothesis for the pixels in rows `top` to `bottom`; None where the camera hardly moved."""
        partners = self._partners(index)
        if not partners[0]:
            return None
        costs = self._costs(index, partners, top, bottom)
        far = pixel_rays(self._grid(top, bottom, SPHERE_CELL)) * WITHOUT_PARALLAX
        still = next(self._compare(index, partners[MIDDLE_BASELINE], far[None], SPHERE_CELL, top, [bottom - top]))
        road = self.background[top:bottom] < FAR_DISTANCE
        bonus = (np.where(road, ROAD_BONUS, FAR_BONUS) * COST_SCALE).astype(np.uint16)
        costs[0] -= np.minimum(costs[0], bonus)
        best, label = _least(costs)
        step = np.log(self._distances[0] / self._distances[1])
        # Between the labels beside it the least cost lies where a parabola through the three costs has it.
        inner = np.clip(label, 2, len(costs) - 2)[None].astype(np.intp)
        before, here, after = (np.take_along_axis(costs, inner + k, axis=0)[0].astype(np.float32) for k in (-1, 0, 1))
        bend = before - 2.0 * here + after
        offset = np.divide(before - after, 2.0 * bend, out=np.zeros_like(bend), where=bend > 0.0)
        offset = np.where(inner[0] == label, np.clip(offset, -0.5, 0.5), 0.0).astype(np.float32)
        distance = self._distances[np.maximum(label, 1) - 1] * np.exp(-step * offset)
        background = self.background[top:bottom]
        return Match(
            distance=np.where(label == 0, background, np.minimum(distance, background)).astype(np.float32),
            mismatch=_grey_levels(best),
            runner_up=_grey_levels(_runner_up(costs, label)),
            mismatch_still=_grey_levels(still),
        )

    def _partners(self, index: int) -> list[list[int]]:
        return choose_partners(self._T_world_camera[:, :3, 3], index, self._neighbours)

    def _costs(self, index: int, partners: list[list[int]], top: int, bottom: int) -> NDArray[np.uint16]:
        """Summed differences (1 + planes, rows, w): of the background, then of the distances from far to near."""
        costs = np.empty((1 + len(self._distances), bottom - top, self.camera.width), np.uint16)
        costs[0] = self._background_cost(index, partners, top, bottom)
        sphere = pixel_rays(self._grid(top, bottom, SPHERE_CELL))
        # Nothing that stands still is seen through the road: a distance is tried only where the road is not nearer.
        possible = self.background[top:bottom] >= self._distances[:, None, None]
        rows = possible.shape[1] - np.any(possible[:, ::-1], axis=2).argmax(axis=1)
        for baseline, judges in enumerate(partners):
            planes = np.flatnonzero(self._baseline_of == baseline)
            points = sphere * self._distances[planes, None, None, None]
            found = self._compare(index, judges, points, SPHERE_CELL, top, rows[planes])
            for plane, cost in zip(planes, found, strict=True):
                costs[1 + plane, : len(cost)] = cost
        costs[1:][~possible] = int(LARGEST_DIFFERENCE) * COST_SCALE
        return costs

    def _background_cost(self, index: int, partners: list[list[int]], top: int, bottom: int) -> NDArray[np.uint16]:
        """Summed differences (rows, w) of the background, each pixel at the baseline that suits its distance."""
        grid = self._grid(top, bottom, BACKGROUND_CELL)
        distance = np.minimum(road_distance(grid, self.T_rig_camera), WITHOUT_PARALLAX)
        points = (pixel_rays(grid) * distance[..., None])[None]
        costs = [next(self._compare(index, each, points, BACKGROUND_CELL, top, [bottom - top])) for each in partners]
        return np.choose(self._background_baseline[top:bottom], costs).astype(np.uint16)

    def _grid(self, top: int, bottom: int, cell: int) -> Camera:
        """The camera whose pixels are the centres of cells of these rows, with one more cell on every side."""
        width, height = self.camera.width, bottom - top
        columns, rows = -(-width // cell), -(-height // cell)
        cells = self.camera.cropped(0, top, width, height).cropped(0, 0, columns * cell, rows * cell)
        return cells.resized(columns, rows).cropped(-1, -1, columns + 2, rows + 2)

    def _compare(
        self, index: int, judges: list[int], points: Array, cell: int, top: int, rows: Iterable[int]
    ) -> Iterator[NDArray[np.uint16]]:
        """Mean over the judging frames of the differences (rows, w) from `top` on if the surface is at `points`.

        Of each of several surfaces, given as points (k, ..., 3) of a `_grid`, for so many rows.
        """
        grids = []
        for judge in judges:
            T_judge_frame = invert(self._T_world_camera[judge]) @ self._T_world_camera[index]
            pixels, _ = self.camera.project(transform(T_judge_frame, points.reshape(-1, 3)))
            grids.append(pixels.astype(np.float32).reshape(*points.shape[:-1], 2))
        for surface, count in enumerate(rows):
            picture = self._pictures[index][top : top + count]
            (difference, unseen), *others = [
                _difference(picture, self._pictures[judge], grid[surface], cell)
                for judge, grid in zip(judges, grids, strict=True)
            ]
            for other, other_unseen in others:
                # The mean of both; the one of them that is seen where the other is not.
                np.copyto(difference, other, where=unseen)
                np.copyto(other, difference, where=other_unseen)
                difference = np.add(difference >> 1, other >> 1, dtype=np.uint16)
            yield difference


def _grey_levels(cost: NDArray[np.uint16]) -> NDArray[np.float32]:
    return np.divide(cost, COST_SCALE, dtype=np.float32)


def _suitable_baseline(distance: Array | NDArray[np.float32]) -> NDArray[np.int64]:
    """Which of `BASELINES` (...) comes closest to its share of a distance (...)."""
    return np.abs(np.log(np.array(BASELINES) / (BASELINE_SHARE * distance[..., None]))).argmin(axis=-1)


def _difference(
    picture: NDArray[np.uint8], other: NDArray[np.uint8], grid: NDArray[np.float32], cell: int
) -> tuple[NDArray[np.uint16], NDArray[np.bool_]]:
    """Summed differences (h, w) between a picture and what another one shows of it, and where that is unseen.

    The pixels of the other one are given on the grid (rows, columns, 2) of a `_grid` and interpolated.
    """
    places = cv2.resize(grid, (grid.shape[1] * cell, grid.shape[0] * cell), interpolation=cv2.INTER_LINEAR)
    table = places[cell : cell + picture.shape[0], cell : cell + picture.shape[1]]
    # Zero is what no normalised picture contains.
    found = np.asarray(cv2.remap(other, table, None, cv2.INTER_LINEAR, borderValue=0), np.uint8)  # pyright: ignore
    unseen = found == 0
    difference = np.minimum(cv2.absdiff(found, picture), LARGEST_DIFFERENCE)
    difference[unseen] = NEUTRAL_DIFFERENCE
    return np.asarray(cv2.boxFilter(difference, cv2.CV_16U, WINDOW, normalize=False), np.uint16), unseen


def normalize_contrast(grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The picture (h, w) less its local mean and over its local contrast, from 1 to 255."""
    mean, deviation = local_contrast(grey, NORMALIZING_WINDOW)
    return np.clip(128.0 + GAIN * (grey - mean) / (deviation + NOISE), 1.0, 255.0).astype(np.uint8)


def local_contrast(grey: NDArray[np.uint8], window: tuple[int, int]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Mean and standard deviation (h, w) of the grey levels in a window around each pixel."""
    # Sums of whole numbers are exact in float32, so that they do not depend on how threads share the picture.
    values = grey.astype(np.float32)
    mean = np.asarray(cv2.blur(values, window), np.float32)
    return mean, np.sqrt(np.maximum(cv2.blur(values**2, window) - mean**2, 0.0))


def _least(costs: NDArray[np.uint16]) -> tuple[NDArray[np.uint16], NDArray[np.uint8]]:
    """The least cost (h, w) and its label; of equal ones the first, so that the background wins."""
    # Ten times as fast as argmin along the first axis.
    least, label = costs[0].copy(), np.zeros(costs.shape[1:], np.uint8)
    for index, cost in enumerate(costs[1:], start=1):
        better = cost < least
        np.copyto(least, cost, where=better)
        label[better] = index
    return least, label


def _runner_up(costs: NDArray[np.uint16], label: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """The least cost (h, w) of labels that are not next to `label` nor next but one."""
    runner_up = np.full(label.shape, np.iinfo(np.uint16).max, np.uint16)
    signed = label.astype(np.int16)
    for index, cost in enumerate(costs):
        elsewhere = np.abs(signed - index) > 2
        np.minimum(runner_up, cost, out=runner_up, where=elsewhere)
    return runner_up
