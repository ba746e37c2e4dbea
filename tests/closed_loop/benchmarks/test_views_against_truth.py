"""Made-up views and the measure of their coherence, against the true views of the synthetic world."""

import numpy as np
import pytest

from olt_closed_loop.benchmarks import coherence, cross_views

pytestmark = pytest.mark.slow


def test_coherence_ranks_each_kind_of_fault_as_the_truth_does():
    default = next(setting for setting in coherence.BENCHMARK.settings() if setting.default)
    found = coherence.rank_correlations(default.prepare()())
    assert all(found[kind] > 0.8 for kind in ("specks", "seams", "blur", "flicker"))
    assert found["distances"] > 0.3


def test_no_scene_is_worse_than_what_its_own_frame_shows():
    alone, together = (
        cross_views.scene_errors(cross_views.BENCHMARK.settings()[index].prepare()()) for index in (0, 1)
    )
    assert all(both > own + 0.5 for both, own in zip(together, alone, strict=True))
    assert np.mean(together) > 19.5
