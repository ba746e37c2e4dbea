"""How probable what a camera shows is if it moved as it is said to.

A point that does not move lies somewhere along its ray. A step of the camera takes it to a place on a curve in the next
image, from where a point infinitely far away would be seen (the rotation alone) towards where the camera comes from:
on which side is told by the direction of travel, and how far by the distance. Of distances little is known beforehand;
below the horizon most points lie on the road, or between it and the camera. The probability of a point is the mean over
distances of that of the error of its place; or else that of a thing on the lens, which stays, or that of any place near
by, where it moves by itself or was followed badly.
"""

import numpy as np
from numpy.typing import NDArray

from olt_generator.poses import Array

Weights = NDArray[np.float32]

# Inverse distances that are tried, 1/m: the first one is infinitely far away.
NEAREST, FARTHEST, RATIO = 1.5, 200.0, 1.12
INVERSE_DISTANCES: Array = np.concatenate(
    [[0.0], np.exp(np.arange(-np.log(FARTHEST), -np.log(NEAREST), np.log(RATIO)))]
)
# Spread of a place: pixels, a share of the way, and radians by which a vehicle shakes over a step.
PIXEL_SPREAD, WAY_SPREAD, SHAKE = 0.7, 0.07, 2e-3
# Shares of points that stay on the lens, with their spread in pixels, and that say nothing, with the radius in pixels
# of the area over which they lie.
ON_LENS, ON_LENS_SPREAD = 0.1, 0.3
OUTLIERS, OUTLIER_RADIUS = 0.2, 40.0
# Share of the points below the horizon that lie on the road, and how well its distance is known: a share of it, and the
# slope of the road beside the vehicle's.
ON_ROAD = 0.65
ROAD_SPREAD, HORIZON_SPREAD = 0.12, 0.012
# Share of the points above the horizon that are too far away to tell.
FAR_AWAY = 0.2


def log_likelihood(rays: Array, moved: Array, steps: Array, weights: Weights, spread: Array, stays: Array) -> Array:
    """Log (n,) of how much more probable each point's way is than any other within the area of outliers.

    Args:
        rays, moved: (n, 3) unit rays to the point before and after the step, in camera axes.
        steps: (n, 4, 4) pose of the camera after the step in its axes before, metres.
        weights: (n, k) float32 probability of each of `INVERSE_DISTANCES` (`distance_weights`).
        spread: (n, 2) standard deviation of the place, in radians and in pixels.
        stays: (n,) odds that the point lies on the lens (`odds_on_lens`).
    """
    rotation, translation = steps[:, :3, :3], steps[:, :3, 3]
    turned = np.einsum("nji,nj->ni", rotation, rays)
    shifted = np.einsum("nji,nj->ni", rotation, translation)
    along, across = np.sum(moved * turned, axis=1)[:, None], np.sum(moved * shifted, axis=1)[:, None]
    mixed, square = np.sum(turned * shifted, axis=1)[:, None], np.sum(shifted**2, axis=1)[:, None]
    inverse = INVERSE_DISTANCES
    length = np.sqrt(np.maximum(1.0 - 2.0 * inverse * mixed + inverse**2 * square, 1e-12))
    # One minus the cosine is half the square of a small angle.
    error = (1.0 - (along - inverse * across) / length) / -(spread[:, :1] ** 2)
    exponent = np.minimum(error, 0.0).astype(np.float32)
    fits = np.einsum("nk,nk->n", weights, np.exp(exponent)) * _density(spread[:, 1])
    # Rays beyond the range of a lens say nothing.
    return np.log((1.0 - OUTLIERS - ON_LENS) * np.nan_to_num(fits) + stays + OUTLIERS)


def odds_on_lens(way: Array) -> Array:
    """Odds (n,) that points which moved by `way` (n,) pixels lie on the lens, against that they lie anywhere."""
    return ON_LENS * np.exp(-0.5 * (way / ON_LENS_SPREAD) ** 2) * _density(np.array(ON_LENS_SPREAD))


def distance_weights(rays_rig: Array, height: float) -> Weights:
    """Probability (n, k) of each of `INVERSE_DISTANCES` along rays (n, 3) in rig axes, `height` metres above ground."""
    log_inverse = np.log(INVERSE_DISTANCES[1:])
    down = -rays_rig[:, 2:]
    falls = np.maximum(down, 1e-6)
    road, spread = np.log(falls / max(height, 0.3)), np.hypot(ROAD_SPREAD, HORIZON_SPREAD / falls)
    off = (log_inverse - road) / spread
    on_road = _normalized(np.exp(-0.5 * off**2))
    before_road = _normalized(1.0 / (1.0 + np.exp(-np.clip(off, -50.0, 50.0))))
    anywhere = np.full_like(before_road, 1.0 / len(log_inverse))
    # Rays near the horizon may or may not meet the road.
    below = 1.0 / (1.0 + np.exp(-np.clip((down - 0.03) / 0.01, -50.0, 50.0)))
    near = below * (ON_ROAD * on_road + (1.0 - ON_ROAD) * before_road) + (1.0 - below) * (1.0 - FAR_AWAY) * anywhere
    return np.concatenate([(1.0 - below) * FAR_AWAY, near], axis=1).astype(np.float32)


def place_spread(way: Array, pixels_per_radian: float) -> Array:
    """Standard deviation (n,) in pixels of the place of points that moved by `way` (n,) pixels over a step."""
    return np.sqrt(PIXEL_SPREAD**2 + (SHAKE * pixels_per_radian) ** 2 + (WAY_SPREAD * way) ** 2)


def _density(spread: Array) -> Array:
    """How many times the density in the middle of a normal distribution is that of the area of outliers."""
    return 0.5 * (OUTLIER_RADIUS / spread) ** 2


def _normalized(weights: Array) -> Array:
    return weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-300)
