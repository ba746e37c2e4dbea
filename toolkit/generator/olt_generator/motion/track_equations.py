"""Normal equations of camera poses and of the distances of points that they have seen, in dense blocks.

A point is followed over a few keyframes, so that it links those alone: all that is known of the poses stands in a band
of blocks (6, 6) beside the diagonal. Observations are kept in the order of the two keyframes that they link, and
points in that of their anchors, so that each block is a product of dense matrices.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from olt_generator.poses import Array
from olt_generator.twists import cross_rows, dot_rows

# A prior of 1/m keeps points without parallax solvable and says nothing about all others.
INVERSE_DISTANCE_SIGMA = 1.0


@dataclass(frozen=True)
class FeatureTracks:
    """Observations of points from several keyframes.

    Attributes:
        anchor: (points,) keyframe in which each point was found.
        anchor_ray: (points, 3) unit ray to the point there.
        point: (m,) point of each further observation.
        frame: (m,) keyframe of each further observation, after the anchor.
        ray: (m, 3) unit ray of each further observation.
    """

    anchor: NDArray[np.int64]
    anchor_ray: Array
    point: NDArray[np.int64]
    frame: NDArray[np.int64]
    ray: Array

    @property
    def span(self) -> int:
        """Keyframes that a point links at most, its anchor among them; at least 2."""
        return max(2, int((self.frame - self.anchor[self.point]).max(initial=0)) + 1)


def sort_tracks(tracks: FeatureTracks) -> tuple[FeatureTracks, NDArray[np.int64]]:
    """The same tracks in the order of their keyframes, and the number (points,) that each of their points had."""
    order = np.argsort(tracks.anchor, kind="stable")
    number = np.empty_like(order)
    number[order] = np.arange(len(order))
    by_pair = np.lexsort((tracks.frame, tracks.anchor[tracks.point]))
    point, frame, ray = number[tracks.point[by_pair]], tracks.frame[by_pair], tracks.ray[by_pair]
    return FeatureTracks(tracks.anchor[order], tracks.anchor_ray[order], point, frame, ray), order


@dataclass(frozen=True)
class PoseEquations:
    """Information about n poses: of their errors, rotation vectors and positions in world axes.

    Attributes:
        blocks: (n, span, 6, 6); block (a, k) has the rows of pose a + k and the columns of pose a.
        gradient: (n, 6).
    """

    blocks: Array
    gradient: Array


@dataclass(frozen=True)
class DistanceEquations:
    """How the inverse distances follow from a step of the poses.

    Attributes:
        mixed: (points, 6 span) with the poses from each point's anchor on.
        gradient: (points,).
        information: (points,).
    """

    mixed: Array
    gradient: Array
    information: Array

    def solve(self, step: Array, anchor: NDArray[np.int64]) -> Array:
        """Changes (points,) of inverse distance that go with a step (n, 6) of the poses."""
        beyond = np.zeros((self.mixed.shape[1] // 6 - 1, 6))
        windows = np.lib.stride_tricks.sliding_window_view(np.concatenate([step, beyond]).ravel(), self.mixed.shape[1])
        return -(self.gradient + np.einsum("ps,ps->p", self.mixed, windows[6 * anchor])) / self.information


def see_from(poses: Array, tracks: FeatureTracks) -> tuple[Array, Array, Array]:
    """Anchor ray, displacement to the anchor camera and observed ray, each (3, m) in world axes."""
    anchor_ray = np.matmul(poses[tracks.anchor, :3, :3], tracks.anchor_ray[..., None])[tracks.point, :, 0]
    baseline = poses[tracks.anchor, :3, 3][tracks.point] - poses[tracks.frame, :3, 3]
    ray = np.matmul(poses[tracks.frame, :3, :3], tracks.ray[..., None])[..., 0]
    return np.ascontiguousarray(anchor_ray.T), np.ascontiguousarray(baseline.T), np.ascontiguousarray(ray.T)


def linearise(
    poses: Array, inverse_distance: Array, tracks: FeatureTracks, ray_sigma: float
) -> tuple[Array, Array, Array]:
    """Residuals (2, m) in sigmas, and their derivatives by both poses (2, 12, m) and the inverse distance (2, m).

    A point at inverse distance s along the ray r of camera a lies, seen from camera k, along p = R_a r + s (c_a - c_k).
    The residual is p / |p| in the plane that touches the unit sphere at the observed ray. With q the part of an axis of
    this plane that is square to p, over |p|, it changes by q x p with a turn of camera k and by r x q with one of
    camera a, by s q with c_a, by -s q with c_k, and by q . (c_a - c_k) with s. The pose of k comes first.
    """
    anchor_ray, baseline, ray = see_from(poses, tracks)
    s = inverse_distance[tracks.point]
    p = anchor_ray + s * baseline
    length = np.sqrt(dot_rows(p, p))
    u = p / length
    first, second = _axes_across(ray)
    residual = np.empty((2, len(s)))
    derivative = np.empty((2, 12, len(s)))
    by_distance = np.empty((2, len(s)))
    for component, axis in enumerate((first, second)):
        along = dot_rows(axis, u)
        q = (axis - along * u) / (length * ray_sigma)
        residual[component] = along / ray_sigma
        derivative[component, :3] = cross_rows(q, p)
        derivative[component, 6:9] = cross_rows(anchor_ray, q)
        derivative[component, 9:] = s * q
        by_distance[component] = dot_rows(q, baseline)
    derivative[:, 3:6] = -derivative[:, 9:]
    return residual, derivative, by_distance


def form_equations(
    poses: Array, inverse_distance: Array, tracks: FeatureTracks, ray_sigma: float
) -> tuple[PoseEquations, DistanceEquations]:
    """What sorted tracks say about n poses once the distances are eliminated, and what the distances follow from."""
    residual, derivative, by_distance = linearise(poses, inverse_distance, tracks, ray_sigma)
    # Geman-McClure: what moves by itself, and what was lost by its track, has no say.
    weight = 1.0 / (1.0 + (residual**2).sum(axis=0))
    residual *= weight
    derivative *= weight
    by_distance *= weight
    information = INVERSE_DISTANCE_SIGMA**-2 + _sum_by_point((by_distance**2).sum(axis=0), tracks)
    gradient = _sum_by_point((by_distance * residual).sum(axis=0), tracks)
    mixed = _mix(derivative[0] * by_distance[0] + derivative[1] * by_distance[1], tracks)
    distances = DistanceEquations(mixed, gradient, information)
    equations = _sum_pairs(residual, derivative, tracks, len(poses))
    _eliminate(equations, distances, tracks)
    return equations, distances


def _mix(products: Array, tracks: FeatureTracks) -> Array:
    """Products (12, m) of the derivatives by pose and by distance, summed up for each point (points, 6 span)."""
    points, span = len(tracks.anchor), tracks.span
    mixed = np.zeros((points, span, 6))
    # A point is seen once from each keyframe, but its anchor has a part in each of its observations.
    mixed[tracks.point, tracks.frame - tracks.anchor[tracks.point]] = products[:6].T
    for parameter, row in enumerate(products[6:]):
        mixed[:, 0, parameter] = _sum_by_point(row, tracks)
    return mixed.reshape(points, 6 * span)


def _sum_pairs(residual: Array, derivative: Array, tracks: FeatureTracks, n: int) -> PoseEquations:
    """Normal equations of the poses alone: observations that link the same two keyframes are summed up together."""
    span = tracks.span
    blocks, gradient = np.zeros((n, span, 6, 6)), np.zeros((n, 6))
    anchor = tracks.anchor[tracks.point]
    pair = anchor * n + tracks.frame
    for start, end in pairwise(np.flatnonzero(np.diff(pair, prepend=-1, append=-1)).tolist()):
        J, r = derivative[:, :, start:end], residual[:, start:end]
        information = J[0] @ J[0].T + J[1] @ J[1].T
        slope = J[0] @ r[0] + J[1] @ r[1]
        key, frame = anchor[start], tracks.frame[start]
        blocks[frame, 0] += information[:6, :6]
        blocks[key, 0] += information[6:, 6:]
        blocks[key, frame - key] += information[:6, 6:]
        gradient[frame] += slope[:6]
        gradient[key] += slope[6:]
    return PoseEquations(blocks, gradient)


def _eliminate(equations: PoseEquations, distances: DistanceEquations, tracks: FeatureTracks) -> None:
    """Take from the equations of the poses what the distances leave open (Schur complement), anchor by anchor."""
    n = len(equations.blocks)
    scaled = distances.mixed / np.sqrt(distances.information)[:, None]
    target = distances.gradient / np.sqrt(distances.information)
    starts = np.searchsorted(tracks.anchor, np.arange(n + 1))
    for key, (start, end) in enumerate(pairwise(starts)):
        W = scaled[start:end, : 6 * (n - key)]
        linked = W.shape[1] // 6
        information = (W.T @ W).reshape(linked, 6, linked, 6).swapaxes(1, 2)
        equations.gradient[key : key + linked] -= (W.T @ target[start:end]).reshape(linked, 6)
        for column in range(linked):
            equations.blocks[key + column, : linked - column] -= information[column:, column]


def _sum_by_point(values: Array, tracks: FeatureTracks) -> Array:
    """Sums (points,) of the values (m,) of all observations of each point."""
    return np.bincount(tracks.point, values, len(tracks.anchor)).astype(np.float64)


def _axes_across(ray: Array) -> tuple[Array, Array]:
    """Two unit vectors (3, m) at right angles to each ray (3, m) and to each other."""
    away = np.where(np.abs(ray[0]) < 0.7, np.eye(3)[:, :1], np.eye(3)[:, 1:2])
    first = cross_rows(ray, away)
    first /= np.sqrt(dot_rows(first, first))
    return first, cross_rows(ray, first)
