"""The Fréchet distance between two sets of features: the number behind FID and FVD."""

import numpy as np

from olt_generator.errors import InputError
from olt_generator.poses import Array


def frechet_distance(a: Array, b: Array) -> float:
    """Squared 2-Wasserstein distance between Gaussians that have the mean and sample covariance of two feature sets.

    Equation (Dowson and Landau 1982): |m_a - m_b|^2 + tr(S_a) + tr(S_b) - 2 tr((S_a S_b)^(1/2)). With centred features
    A, B and S = A^T A / (n - 1), the last trace is the sum of the singular values of A B^T over
    sqrt((n_a - 1)(n_b - 1)). No matrix root is taken, so fewer samples than dimensions are no special case.

    Args:
        a: (n_a, d) features, one row per image or clip.
        b: (n_b, d) features of the other set.

    Raises:
        InputError: the sets have different dimensions, fewer than two samples, or numbers that are not finite.
    """
    for name, features in (("first", a), ("second", b)):
        if features.ndim != 2 or len(features) < 2 or not np.isfinite(features).all():
            raise InputError(
                f"Fréchet distance: the {name} set has shape {features.shape}; give finite features (n, d) of at least "
                "2 samples"
            )
    if a.shape[1] != b.shape[1]:
        raise InputError(f"Fréchet distance: features of {a.shape[1]} and {b.shape[1]} dimensions; use one network")
    (mean_a, root_a), (mean_b, root_b) = _moments(a), _moments(b)
    shared = np.linalg.svd(root_a @ root_b.T, compute_uv=False).sum()
    distance = np.sum((mean_a - mean_b) ** 2) + np.sum(root_a**2) + np.sum(root_b**2) - 2.0 * shared
    return max(0.0, float(distance))  # rounding alone can take it below 0


def _moments(features: Array) -> tuple[Array, Array]:
    """Mean (d,) and a root R (min(n, d), d) of the covariance: S = R^T R."""
    features = features.astype(np.float64)
    mean = features.mean(axis=0)
    return mean, np.asarray(np.linalg.qr((features - mean) / np.sqrt(len(features) - 1), mode="r"))
