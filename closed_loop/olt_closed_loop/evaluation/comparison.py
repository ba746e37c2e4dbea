"""Several policies on the same scenes: paired differences, which tell more than two tables beside each other.

Scenes differ far more than policies do, so what is compared is the difference on each scene: the mean over the rollouts
of one policy less that of the other. Its interval comes from drawing scenes, not rollouts, anew, since rollouts of one
scene resemble each other. Intervals are those of one difference each; of twenty that are compared, one misses.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from olt_closed_loop.evaluation.score_table import Interval, ScoreRow, bootstrap_interval, summarize_scores
from olt_closed_loop.scoring.definitions import RolloutScore
from olt_generator.errors import InputError
from olt_generator.poses import Array
from olt_toolkit.runtime.json_files import read_json

FEWEST_SCENES = 6
"""Scenes without which nothing is called separate: if all of five say the same, chance does that in 2 x 0.5^5 > 5 %."""


@dataclass(frozen=True)
class PairedDifference:
    """The first policy less the second, over the scenes where both were measured; None is "not measured".

    Attributes:
        first, second: the policies.
        scenes: on how many scenes both have a score.
        score, score_interval: difference of AS, each scene weighing the same, and its 95 % interval.
        collision_rate, collision_rate_interval: the same of the share of rollouts with a collision.
        separated: whether the scores differ clearly: on at least six scenes, with 0 outside the interval (or where they
            differ by the same on each).
    """

    first: str
    second: str
    scenes: int
    score: float | None
    score_interval: Interval | None
    collision_rate: float | None
    collision_rate_interval: Interval | None
    separated: bool


@dataclass(frozen=True)
class Comparison:
    """What several policies made of the scenes that all of them drove.

    Attributes:
        definition: how the score is defined.
        scenes: how many scenes all have driven.
        not_compared: scenes that only some have driven.
        policies: the overall row of each policy over those scenes.
        differences: pairs of policies.
    """

    definition: str
    scenes: int
    not_compared: tuple[str, ...]
    policies: dict[str, ScoreRow]
    differences: tuple[PairedDifference, ...]

    def to_dict(self) -> dict[str, Any]:
        """The comparison as JSON can hold it."""
        return asdict(self)


def compare_scores(runs: Mapping[str, Sequence[RolloutScore]], reference: str | None = None) -> Comparison:
    """Compare the scores of policies, by name: each with the reference, or all with each other.

    Raises:
        InputError: the scores are of several definitions, or there is no scene that all have driven.
    """
    driven = {name: {score.scene for score in scores} for name, scores in runs.items()}
    shared, everything = set.intersection(*driven.values()), set.union(*driven.values())
    if not shared:
        raise InputError(f"{', '.join(runs)}: no scene was driven by all of them; drive the same scenes")
    kept = {name: [score for score in scores if score.scene in shared] for name, scores in runs.items()}
    tables = {name: summarize_scores(scores) for name, scores in kept.items()}
    definitions = sorted({table.definition for table in tables.values()})
    if len(definitions) > 1:
        raise InputError(f"scores by {' and '.join(definitions)} cannot be compared; use one definition")
    pairs = [(reference, name) for name in runs if name != reference] if reference else combinations(runs, 2)
    return Comparison(
        definition=definitions[0],
        scenes=len(shared),
        not_compared=tuple(sorted(everything - shared)),
        policies={name: table.overall for name, table in tables.items()},
        differences=tuple(_difference(first, second, kept) for first, second in pairs),
    )


def _difference(first: str, second: str, runs: Mapping[str, Sequence[RolloutScore]]) -> PairedDifference:
    scores = _paired([_by_scene(runs[name], "score") for name in (first, second)])
    collisions = _paired([_by_scene(runs[name], "collided") for name in (first, second)])
    interval = _interval(scores, first, second)
    same_sign = interval[0] * interval[1] > 0.0 if interval else bool(np.any(scores))
    return PairedDifference(
        first=first,
        second=second,
        scenes=len(scores),
        score=float(scores.mean()) if len(scores) else None,
        score_interval=interval,
        collision_rate=float(collisions.mean()) if len(collisions) else None,
        collision_rate_interval=_interval(collisions, first, second),
        separated=same_sign and len(scores) >= FEWEST_SCENES,
    )


def _interval(differences: Array, first: str, second: str) -> Interval | None:
    """95 % interval of the mean of differences (scenes,)."""
    if len(differences) < 2:
        return None
    return bootstrap_interval(np.stack([differences, np.ones(len(differences))], axis=-1), first, second)


def _by_scene(scores: Sequence[RolloutScore], figure: str) -> dict[str, list[float]]:
    """The values of a figure on each scene, where it was measured."""
    values: dict[str, list[float]] = {}
    for score in scores:
        value = getattr(score, figure)
        if value is not None:
            values.setdefault(score.scene, []).append(float(value))
    return values


def _paired(values: Sequence[Mapping[str, Sequence[float]]]) -> Array:
    """Differences (scenes,) of the means on the scenes that both have values of."""
    first, second = values
    scenes = sorted(scene for scene in first if first[scene] and second.get(scene))
    return np.array([np.mean(first[scene]) - np.mean(second[scene]) for scene in scenes], dtype=np.float64)


def name_runs(folders: Sequence[Path], scores: Sequence[Sequence[RolloutScore]]) -> list[str]:
    """What to call runs: by their policies if those differ, else by their folders, as short as tells them apart."""
    policies = [" and ".join(sorted({score.policy for score in run})) for run in scores]
    for names in (policies, [folder.name for folder in folders]):
        if len(set(names)) == len(folders):
            return names
    return [str(folder) for folder in folders]


def read_scores(folder: Path) -> list[RolloutScore]:
    """The scores of a run, from the scores.json in its folder.

    Raises:
        InputError: there is no such file, or it holds something else.
    """
    path = folder / "scores.json"
    fields = ("scene", "category", "policy", "seed", "definition", "valid", "failed", "score", "collided", "distance_m")
    fields = (*fields, "incidents", "incidents_at_fault", "rollout_incidents", "plan_deviation_max")
    try:
        return [
            RolloutScore(**{name: values[name] for name in fields}) for values in read_json(path, "scores")["scores"]
        ]
    except KeyError as error:
        raise InputError(f"{path}: field {error} is missing; run `olt closed-loop run --out` again") from error
    except TypeError as error:
        raise InputError(
            f"{path}: not the scores of a run ({error}); give a folder of `olt closed-loop run`"
        ) from error
