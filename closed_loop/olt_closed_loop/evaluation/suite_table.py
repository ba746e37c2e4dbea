"""The score table of a suite: by category and by factor, and overall by the weights of the scenes."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from olt_closed_loop.evaluation.evaluation import load_scene
from olt_closed_loop.evaluation.score_table import ScoreRow, ScoreTable, summarize_scores
from olt_closed_loop.scoring.definitions import RolloutScore
from olt_closed_loop.suite.files import Suite, SuiteScene
from olt_generator.files import write_whole


@dataclass(frozen=True)
class SuiteTable:
    """Scores of one policy on a suite.

    Attributes:
        suite: its name.
        categories: rows by category, and overall, as `summarize_scores` has them.
        factors: rows by factor; a scene with several counts in each of their rows.
        weighted_score, weighted_collision_rate: means over valid rollouts by the weights of their scenes; None where
            there is none.
    """

    suite: str
    categories: ScoreTable
    factors: tuple[ScoreRow, ...]
    weighted_score: float | None
    weighted_collision_rate: float | None

    def to_dict(self) -> dict[str, Any]:
        """The table as JSON can hold it."""
        return {
            "suite": self.suite,
            "categories": self.categories.to_dict(),
            "factors": [asdict(row) for row in self.factors],
            "weighted_score": self.weighted_score,
            "weighted_collision_rate": self.weighted_collision_rate,
        }


def label_scores(suite: Suite, scores: Sequence[RolloutScore]) -> list[RolloutScore]:
    """Scores of all rollouts of a suite, scene by scene in its order, under the suite's categories."""
    pairs = zip(_scenes_of(suite, scores), scores, strict=True)
    return [replace(score, category=scene.category or score.category) for scene, score in pairs]


def summarize_suite(suite: Suite, scores: Sequence[RolloutScore]) -> SuiteTable:
    """Put together the scores of one policy on all scenes of a suite, scene by scene in its order."""
    scenes, labelled = _scenes_of(suite, scores), label_scores(suite, scores)
    factors = {scene.source: _factors_of(scene) for scene in suite.scenes}
    by_factor = [
        replace(score, category=factor)
        for scene, score in zip(scenes, labelled, strict=True)
        for factor in factors[scene.source]
    ]
    weights = np.array([scene.weight for scene in scenes])
    return SuiteTable(
        suite.name,
        summarize_scores(labelled),
        summarize_scores(by_factor).rows[:-1] if by_factor else (),
        _weighted(weights, [score.score for score in labelled]),
        _weighted(weights, [None if score.collided is None else float(score.collided) for score in labelled]),
    )


def _factors_of(scene: SuiteScene) -> tuple[str, ...]:
    return load_scene(scene.source).factors if scene.factors is None else scene.factors


def _scenes_of(suite: Suite, scores: Sequence[RolloutScore]) -> list[SuiteScene]:
    """The scene of each score."""
    rollouts = len(scores) // len(suite.scenes)
    return [scene for scene in suite.scenes for _ in range(rollouts)]


def _weighted(weights: np.ndarray, values: Sequence[float | None]) -> float | None:
    known = np.array([value is not None for value in values])
    if not known.any():
        return None
    numbers = np.array([value for value in values if value is not None])
    return float(np.average(numbers, weights=weights[known]))


def save_suite_table(path: Path, table: SuiteTable) -> None:
    """Write a table as JSON, whole or not at all."""
    with write_whole(path) as temporary:
        temporary.write_text(json.dumps(table.to_dict(), indent=2, allow_nan=False) + "\n")
