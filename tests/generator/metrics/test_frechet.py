import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_generator.errors import InputError
from olt_generator.metrics.frechet import frechet_distance
from olt_generator.seeds import make_generator

seeds = st.integers(0, 2**32 - 1)


def features(seed: int, samples: int, dimensions: int) -> np.ndarray:
    generator = make_generator("features", seed, samples, dimensions)
    mixing = generator.normal(size=(dimensions, dimensions))
    return generator.normal(size=(samples, dimensions)) @ mixing + generator.normal(size=dimensions)


def distance_by_symmetric_root(a: np.ndarray, b: np.ndarray) -> float:
    """The definition with tr((S_a S_b)^1/2) = tr((S_a^1/2 S_b S_a^1/2)^1/2), roots by eigenvalues."""
    covariance_a, covariance_b = np.cov(a, rowvar=False), np.cov(b, rowvar=False)
    values, vectors = np.linalg.eigh(covariance_a)
    root = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    shared = np.sqrt(np.maximum(np.linalg.eigvalsh(root @ covariance_b @ root), 0.0)).sum()
    return float(np.sum((a.mean(axis=0) - b.mean(axis=0)) ** 2) + np.trace(covariance_a + covariance_b) - 2.0 * shared)


@given(seeds, st.integers(2, 40), st.integers(2, 40), st.integers(2, 12))
def test_equals_the_definition_with_few_and_with_many_samples(seed, samples_a, samples_b, dimensions):
    a, b = features(seed, samples_a, dimensions), features(seed + 1, samples_b, dimensions)
    expected = distance_by_symmetric_root(a, b)
    # The definition takes roots of eigenvalues that are 0 but for rounding, and is that much less exact.
    scale = np.trace(np.cov(a, rowvar=False) + np.cov(b, rowvar=False))
    assert frechet_distance(a, b) == pytest.approx(expected, abs=1e-6 * scale)


@given(seeds)
def test_is_symmetric_and_zero_between_equal_sets(seed):
    a, b = features(seed, 30, 6), features(seed + 1, 20, 6)
    assert frechet_distance(a, b) == pytest.approx(frechet_distance(b, a), rel=1e-9)
    assert frechet_distance(a, a[::-1]) == pytest.approx(0.0, abs=1e-9 * np.sum(a**2))


def test_of_one_dimension_is_that_of_two_normal_distributions():
    a, b = np.array([[0.0], [2.0]]), np.array([[5.0], [5.0 + np.sqrt(8.0)], [5.0 - np.sqrt(8.0)]])
    assert frechet_distance(a, b) == pytest.approx((5.0 - 1.0) ** 2 + (np.sqrt(8.0) - np.sqrt(2.0)) ** 2)


def test_a_shift_adds_its_square():
    a = features(1, 5, 2048)
    assert frechet_distance(a, a + 0.5) == pytest.approx(0.25 * 2048, rel=1e-6)


@pytest.mark.parametrize(
    ("a", "b"),
    [
        (np.zeros((1, 3)), np.zeros((4, 3))),
        (np.zeros((4, 3)), np.zeros((4, 2))),
        (np.full((4, 3), np.nan), np.zeros((4, 3))),
        (np.zeros(3), np.zeros((4, 3))),
    ],
)
def test_what_has_no_distance_is_refused(a, b):
    with pytest.raises(InputError, match="Fréchet"):
        frechet_distance(a, b)
