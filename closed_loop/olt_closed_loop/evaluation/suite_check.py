"""A check of the suite: each event can be driven by who sees everything, and not by who knows nothing.

For an event and every definition of the score: the gate holds, and the privileged driver scores 1 and touches nobody.
A baseline has solved it if it scores 1 by `strict` and touches nobody.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from olt_closed_loop.evaluation.baselines import BASELINES
from olt_closed_loop.evaluation.evaluation import load_scene
from olt_closed_loop.evaluation.gate import check_gate
from olt_closed_loop.privileged.driver import PrivilegedDriver
from olt_closed_loop.rollouts.rollout import Rollout
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.scoring.definitions import DEFINITIONS, score_rollout
from olt_closed_loop.simulation.closed_loop import simulate
from olt_closed_loop.simulation.policies import make_policy
from olt_closed_loop.suite.apart import lane_shape
from olt_generator.progress import Progress, silent
from olt_toolkit.runtime.workers import map_parallel

FAILED_BY_ALL = 0.8
"""Share of the events that all baselines must fail."""


@dataclass(frozen=True)
class EventCheck:
    """What was found on one event.

    Attributes:
        source, category: which event.
        gate: checks of the gate that do not hold, with the definition.
        privileged: scores of the privileged driver by definition; None where there is none.
        collided: definitions by which it touched somebody.
        baselines: `strict` score of each baseline, and whether it touched somebody.
        lanes: hashes of the shapes of its lanes (`suite.apart`).
    """

    source: str
    category: str
    gate: tuple[str, ...]
    privileged: dict[str, float | None]
    collided: tuple[str, ...]
    baselines: dict[str, tuple[float | None, bool]]
    lanes: tuple[str, ...]

    @property
    def solvable(self) -> bool:
        """Whether the gate holds and the privileged driver scores 1 without touching anybody, by every definition."""
        return not self.gate and not self.collided and all(score == 1.0 for score in self.privileged.values())

    @property
    def solved_by(self) -> tuple[str, ...]:
        """The baselines that score 1 and touch nobody."""
        return tuple(name for name, (score, touched) in self.baselines.items() if score == 1.0 and not touched)

    @property
    def scored_by(self) -> tuple[str, ...]:
        """The baselines that score 1, whoever they touched by no fault of theirs."""
        return tuple(name for name, (score, _) in self.baselines.items() if score == 1.0)

    def to_dict(self) -> dict[str, Any]:
        """The findings as JSON can hold them."""
        return {**asdict(self), "solvable": self.solvable, "solved_by": self.solved_by, "scored_by": self.scored_by}


@dataclass(frozen=True)
class SuiteCheck:
    """What was found on all events, and which lanes they share with scenes they must be apart from."""

    events: tuple[EventCheck, ...]
    shared: tuple[str, ...]
    apart_from: int

    @property
    def failed_by_all(self) -> int:
        """Events that no baseline solves."""
        return sum(not event.solved_by for event in self.events)

    @property
    def passed(self) -> bool:
        """Whether everything holds that the suite promises."""
        enough = self.failed_by_all >= FAILED_BY_ALL * len(self.events)
        none_by_all = all(len(event.solved_by) < len(BASELINES) for event in self.events)
        return all(event.solvable for event in self.events) and enough and none_by_all and not self.shared

    def to_dict(self) -> dict[str, Any]:
        """The findings as JSON can hold them."""
        return {
            "passed": self.passed,
            "events": [event.to_dict() for event in self.events],
            "solvable": sum(event.solvable for event in self.events),
            "failed_by_all_baselines": self.failed_by_all,
            "scored_by_no_baseline": sum(not event.scored_by for event in self.events),
            "shared_lanes": list(self.shared),
            "scenes_apart_from": self.apart_from,
        }


def check_suite(
    sources: Sequence[str], apart_from: Sequence[str] = (), workers: int = 1, on_progress: Progress = silent
) -> SuiteCheck:
    """Check events, and that none has a lane of the shape of one in the scenes `apart_from`.

    Raises:
        InputError: a scene cannot be loaded or driven.
    """
    events = tuple(map_parallel(check_event, list(sources), workers, on_progress))
    known: dict[str, str] = {}
    for other in apart_from:
        known |= {lane_shape(lane): f"{other}, lane {lane.id}" for lane in load_scene(other).lanes}
    shared = [f"{event.source}: {known[lane]}" for event in events for lane in event.lanes if lane in known]
    return SuiteCheck(events, tuple(shared), len(apart_from))


def check_event(source: str) -> EventCheck:
    """Check one event.

    Raises:
        InputError: the scene cannot be loaded or driven.
    """
    scene = load_scene(source)
    failed: list[str] = []
    for definition in DEFINITIONS:
        failed += [
            f"{definition}: {check.name}: {check.finding}" for check in check_gate(scene, None, definition).failed
        ]
    driven = simulate(scene, PrivilegedDriver(scene))
    scores = {definition: score_rollout(scene, driven, definition=definition) for definition in DEFINITIONS}
    baselines = {name: _strict(scene, simulate(scene, make_policy(policy))) for name, policy in BASELINES.items()}
    return EventCheck(
        source=source,
        category=scene.category,
        gate=tuple(failed),
        privileged={definition: score.score for definition, score in scores.items()},
        collided=tuple(definition for definition, score in scores.items() if score.collided),
        baselines=baselines,
        lanes=tuple(lane_shape(lane) for lane in scene.lanes),
    )


def _strict(scene: Scene, rollout: Rollout) -> tuple[float | None, bool]:
    score = score_rollout(scene, rollout)
    return score.score, bool(score.collided)
