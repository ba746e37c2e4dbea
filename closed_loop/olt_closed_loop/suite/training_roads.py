"""Roads for training: drawn as those of the suite are, and never equal to one of them, whatever its seed.

The lanes of the suite are as wide as `SUITE_WIDTHS` say. Lanes for training are narrower than those or
wider, and so are shoulders, so that no lane of theirs has the shape of one that a policy is judged by (`suite.apart`).
Everything else varies more: radii, angles between arms, bends, speeds, and how early the event is seen.
"""

import numpy as np

SUITE_WIDTHS = (3.3, 3.8)
"""Metres: the narrowest and the widest lane of the suite."""

_BESIDE = 0.02
_WIDTHS = 0.18
_BROADER = 0.07
_MORE = 0.3
_BENT = 0.5
_SLIGHT = 0.003


class TrainingRoads(np.random.Generator):
    """A generator of random numbers with which grounds draw roads for training."""

    def __init__(self, seed: int) -> None:
        super().__init__(np.random.PCG64(seed))


def draw_lane_width(generator: np.random.Generator, narrowest: float, widest: float) -> float:
    """Metres between two bounds; for training beside the range of the suite, on either side of it."""
    if not isinstance(generator, TrainingRoads):
        return float(generator.uniform(narrowest, widest))
    lowest, highest = SUITE_WIDTHS
    beside = _BESIDE + _WIDTHS * float(generator.random())
    return lowest - beside if generator.random() < 0.5 else highest + beside


def draw_wider(generator: np.random.Generator, low: float, high: float, more: float = _MORE) -> float:
    """A number between two bounds; for training beyond each bound by up to a share `more` of what is between them."""
    if not isinstance(generator, TrainingRoads):
        return float(generator.uniform(low, high))
    reach = more * (high - low)
    return float(generator.uniform(low - reach, high + reach))


def given_width(generator: np.random.Generator, width: float) -> float:
    """Metres of a strip that is as wide in the whole suite; a little wider for training."""
    return width + _BROADER * isinstance(generator, TrainingRoads)


def bend_of(generator: np.random.Generator, curvature: float) -> float:
    """A curvature in 1/m; for training up to a third more or less, and straight roads are slightly bent at times."""
    if not isinstance(generator, TrainingRoads):
        return curvature
    if curvature == 0.0:
        return _SLIGHT * float(generator.uniform(-1.0, 1.0)) * (generator.random() < _BENT)
    return curvature * float(generator.uniform(0.7, 1.33))
