"""Results in the form in which AlpaSim leaves them, so that its tools and ours can be laid side by side."""

import json
from collections.abc import Sequence
from pathlib import Path

from olt_closed_loop.scoring.definitions import RolloutScore, alpasim_rows
from olt_generator.files import write_whole


def save_alpasim_summary(path: Path, scores: Sequence[RolloutScore]) -> None:
    """Write the rows of AlpaSim's `results-summary.json` for scores by one of its versions, whole or not at all."""
    summary = {"schema_version": 1, "scene_score_enabled": True, "rollouts": alpasim_rows(scores)}
    with write_whole(path) as temporary:
        temporary.write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n")
