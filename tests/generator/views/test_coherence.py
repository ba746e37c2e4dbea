"""What is not trusted takes the distance of its surroundings, up to the edges in the picture."""

import cv2
import numpy as np

from olt_generator.views.coherence import make_coherent

LORRY = np.s_[30:90, 80:160]


def picture() -> np.ndarray:
    image = np.full((120, 240, 3), 90, np.uint8)
    image[LORRY] = (200, 40, 40)
    return image


def test_a_lorry_with_torn_distances_becomes_one_piece():
    random = np.random.default_rng(2)
    distance = np.full((120, 240), 40.0, np.float32)
    distance[LORRY] = np.exp(random.normal(np.log(10.0), 0.4, (60, 80)))
    trust = np.ones((120, 240), np.float32)
    trust[LORRY] = 0.0
    made = make_coherent(picture(), distance, trust)
    inside = made[35:85, 85:155]
    # Neighbours agree, which they did not, and the whole lies between its own guesses and what is around it.
    steps = np.abs(np.diff(np.log(inside), axis=1))
    assert np.quantile(steps, 0.99) < 0.1
    assert np.quantile(np.abs(np.diff(np.log(distance[LORRY]), axis=1)), 0.5) > 0.3
    assert 6.0 < inside.mean() < 40.0
    assert np.array_equal(made[:, :75], distance[:, :75])


def test_what_is_trusted_stays_as_it_is_and_what_is_unknown_stays_so():
    distance = np.random.default_rng(4).uniform(3.0, 50.0, (120, 240)).astype(np.float32)
    distance[:10] = np.nan
    made = make_coherent(picture(), distance, np.ones((120, 240), np.float32))
    np.testing.assert_array_equal(made, distance)
    doubted = make_coherent(picture(), distance, np.zeros((120, 240), np.float32))
    assert np.isnan(doubted[:10]).all()
    assert np.isfinite(doubted[10:]).all()


def test_the_number_of_threads_changes_nothing():
    random = np.random.default_rng(6)
    distance = random.uniform(3.0, 50.0, (120, 240)).astype(np.float32)
    image = random.integers(0, 256, (120, 240, 3)).astype(np.uint8)
    trust = np.zeros((120, 240), np.float32)
    threads = cv2.getNumThreads()
    cv2.setNumThreads(4)
    several = make_coherent(image, distance, trust)
    cv2.setNumThreads(threads)
    assert np.array_equal(several, make_coherent(image, distance, trust))
