"""A check that scores mean something on a scene: do drives of known worth get what they are worth?

Three drives are known without a driver: the replayed recording, a car that stands, and the replay into a wall. One is
driven: the recorded motion, planned step by step, through the controller and the vehicle that policies drive with. And
the replay is moved to both sides by what a good driver may be off: where that costs anything, nobody but a replay gets
the score, and the narrow place is named.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from olt_closed_loop.evaluation.margins import NarrowPlace, narrow_places
from olt_closed_loop.rollouts.rollout import Rollout
from olt_closed_loop.rollouts.rollout_record import record_rollout
from olt_closed_loop.scenes.polylines import arc_lengths
from olt_closed_loop.scenes.scene import Agent, Scene
from olt_closed_loop.scoring.definitions import (
    FULL_PROGRESS,
    SHORT_RECORDING,
    Definition,
    DefinitionName,
    RolloutScore,
    full_definition,
    recorded_length,
    score_rollout,
)
from olt_closed_loop.simulation.closed_loop import replay, simulate, stand
from olt_closed_loop.simulation.recorded_driver import RecordedDriver
from olt_closed_loop.simulation.settings import SimulationSettings
from olt_closed_loop.vehicle.state import STATE
from olt_generator.poses import Array
from olt_toolkit.policy.contract import STEP_US

WALL_LENGTH, WALL_WIDTH, WALL_HEIGHT = 0.5, 8.0, 2.0
SIDEWAYS = 0.1
"""Metres to the side that a driver may be off: the controllers are up to 0.052 m off 12 recorded drives, and no policy
follows its plans better than they do."""
SAME_SCORE = 0.02
"""How much less than the replay a drive along the recording may score: it may end a little behind."""
_BISECTIONS = 6


@dataclass(frozen=True)
class GateCheck:
    """One check: what was asked, whether it holds (None: it cannot be asked of this scene), and what was found."""

    name: str
    passed: bool | None
    finding: str


@dataclass(frozen=True)
class GateResult:
    """The checks of one scene.

    Attributes:
        scene: its name, or what it was called where it could not be read.
        checks: what was asked; () for a scene that could not be.
        definition: of the score.
        narrow: where the recorded drive comes nearest to the road's border and to an agent.
        refusal: why the scene could not be asked at all; None if it was.
    """

    scene: str
    checks: tuple[GateCheck, ...]
    definition: Definition = "strict"
    narrow: tuple[NarrowPlace, ...] = ()
    refusal: str | None = None

    @property
    def failed(self) -> list[GateCheck]:
        """The checks that were asked and do not hold."""
        return [check for check in self.checks if check.passed is False]

    @property
    def passed(self) -> bool:
        """Whether the scene could be asked and no check failed."""
        return self.refusal is None and not self.failed

    @property
    def why_not(self) -> str | None:
        """One line on why scores would mean nothing on the scene; None where the gate holds."""
        if self.passed or self.refusal:
            return self.refusal
        failures = "; ".join(f"{check.name}: {check.finding}" for check in self.failed)
        return f"the gate fails on scene {self.scene} ({failures}): scores would mean nothing, repair the scene"

    def to_dict(self) -> dict[str, Any]:
        """The result as JSON can hold it."""
        return {
            "scene": self.scene,
            "definition": self.definition,
            "passed": self.passed,
            "refusal": self.refusal,
            "checks": [asdict(check) for check in self.checks],
            "narrow": [place.to_dict() for place in self.narrow],
        }


def check_gate(
    scene: Scene, settings: SimulationSettings | None = None, definition: DefinitionName = "strict"
) -> GateResult:
    """Score given drives of the scene by a definition, with the vehicle and the controller of the settings.

    Agents replay the recording, and a plan is made in every step, whatever the settings say of traffic and plans.

    Replaying the recording must score 1 without a collision; a car that stands from the hand-over on must make no
    progress and score 0; replaying it into a wall across the road must give exactly one collision, at fault, score 0;
    driving along the recording, and replaying it SIDEWAYS to the left or right, must score what the replay scores.

    Raises:
        InputError: the recording is too short to be driven.
    """
    settings = replace(settings or SimulationSettings(), traffic="recorded", plan_interval_us=STEP_US)
    full = full_definition(definition)
    gate = _Gate(scene, settings, full)
    checks = (gate.replay(), gate.standing(), gate.wall(), gate.driving(), gate.room())
    return GateResult(scene.name, checks, full, narrow_places(record_rollout(scene, gate.replayed)))


class _Gate:
    """The drives of one scene and their scores."""

    def __init__(self, scene: Scene, settings: SimulationSettings, definition: Definition) -> None:
        self._scene, self._settings = scene, settings
        self._definition: Definition = definition
        self.replayed = replay(scene, settings)
        self._recorded_m = recorded_length(record_rollout(scene, self.replayed))
        self._replay_score = self._score(self.replayed)

    def _score(self, rollout: Rollout, scene: Scene | None = None) -> RolloutScore:
        return score_rollout(scene or self._scene, rollout, definition=self._definition)

    def replay(self) -> GateCheck:
        score = self._replay_score
        if self._definition == "strict":
            return GateCheck("replay scores 1", score.score == 1.0 and not score.collided, _found(score))
        # AlpaSim may measure progress along the whole recording, which the drive that is asked for may not end.
        expected = min(self._share(int(self.replayed.timestamps_us[-1])) / FULL_PROGRESS, 1.0)
        passed = score.score is not None and score.score >= expected - SAME_SCORE and not score.collided
        return GateCheck(f"replay scores {expected:.4g}", passed, _found(score))

    def standing(self) -> GateCheck:
        name = "standing scores 0"
        if self._recorded_m < SHORT_RECORDING:
            return GateCheck(name, None, f"the recording drives less than {SHORT_RECORDING:g} m")
        score = self._score(stand(self._scene, self._settings))
        if self._definition == "strict":
            return GateCheck(name, score.score == 0.0 and score.progress == 0.0, _found(score))
        # AlpaSim counts as driven what the recording drove before the hand-over.
        start, end = (self._share(int(time)) for time in (self.replayed.handover_us, self.replayed.timestamps_us[-1]))
        given = start / end * (self._replay_score.progress or 0.0)
        passed = score.progress is not None and score.progress <= given + SAME_SCORE
        finding = f"{_found(score)}, of which the warm-up gives progress {given:.4f}"
        return GateCheck("standing scores what the warm-up gives", passed, finding)

    def _share(self, time_us: int) -> float:
        """The part of the recorded way that is driven until a time; 1 where the recording stands throughout."""
        driven = arc_lengths(self._scene.ego.positions)
        if driven[-1] < SHORT_RECORDING:
            return 1.0
        return float(np.interp(time_us, self._scene.ego.timestamps_us, driven) / driven[-1])

    def wall(self) -> GateCheck:
        name, vehicle = "a wall is hit once", self._scene.vehicle
        if self._recorded_m < 2.0 * vehicle.length:
            return GateCheck(name, None, "the recording drives less than two vehicle lengths")
        # Across the way of the ego, where the centre of its box is at the end of the drive.
        x, y, yaw = self.replayed.states[-1, : STATE.speed]
        ahead = vehicle.rear_axle_to_bbox_center
        pose = [x + ahead * np.cos(yaw), y + ahead * np.sin(yaw), self.replayed.heights[-1] + 0.5 * WALL_HEIGHT, yaw]
        times, poses = self.replayed.timestamps_us[[0, -1]], np.array([pose, pose])
        wall = Agent("wall", "barrier", WALL_LENGTH, WALL_WIDTH, WALL_HEIGHT, times, poses)
        score = self._score(self.replayed, replace(self._scene, agents=(wall,)))
        once = bool(score.collided) and len(score.collisions) <= 1
        if score.score != 0.0 and [collision.rule for collision in score.collisions] == ["came too late"]:
            return GateCheck(name, None, "from the hand-over on, the recording is too fast to brake before its end")
        return GateCheck(name, score.score == 0.0 and once, _found(score))

    def driving(self) -> GateCheck:
        rollout = simulate(self._scene, RecordedDriver(self._scene), self._settings)
        score = self._score(rollout)
        finding = _found(score)
        if rollout.failure is None:
            ahead, left = _deviations(self.replayed, rollout)
            finding += f", up to {left:.3f} m to the side of the recording and {ahead:.2f} m before or behind it"
        return GateCheck("driving along scores as replayed", self._as_replayed(score), finding)

    def room(self) -> GateCheck:
        tight = list(self._tight_sides())
        finding = "; ".join(tight) or f"{SIDEWAYS:g} m to either side cost nothing"
        return GateCheck(f"{SIDEWAYS:g} m aside score as replayed", not tight, finding)

    def _tight_sides(self) -> Iterator[str]:
        for side, sign in (("left", 1.0), ("right", -1.0)):
            score = self._aside(sign * SIDEWAYS)
            if self._as_replayed(score):
                continue
            free, taken = 0.0, SIDEWAYS
            for _ in range(_BISECTIONS):
                middle = 0.5 * (free + taken)
                free, taken = (middle, taken) if self._as_replayed(self._aside(sign * middle)) else (free, middle)
            yield f"from {taken:.3f} m to the {side}: {_found(self._aside(sign * taken))}"

    def _aside(self, metres: float) -> RolloutScore:
        """The score of the replay moved to the left."""
        states = self.replayed.states.copy()
        states[:, STATE.x] -= metres * np.sin(states[:, STATE.yaw])
        states[:, STATE.y] += metres * np.cos(states[:, STATE.yaw])
        return self._score(replace(self.replayed, states=states))

    def _as_replayed(self, score: RolloutScore) -> bool:
        expected, found = self._replay_score.score, score.score
        return found == expected if found is None or expected is None else found >= expected - SAME_SCORE


def _deviations(replayed: Rollout, driven: Rollout) -> tuple[float, float]:
    """Largest distance of a drive from the recording along it and to its side, metres."""
    offset = driven.states[:, : STATE.yaw] - replayed.states[:, : STATE.yaw]
    yaw: Array = replayed.states[:, STATE.yaw]
    along = offset[:, 0] * np.cos(yaw) + offset[:, 1] * np.sin(yaw)
    across = offset[:, 1] * np.cos(yaw) - offset[:, 0] * np.sin(yaw)
    return float(np.abs(along).max()), float(np.abs(across).max())


def _found(score: RolloutScore) -> str:
    """The score and, where it is not perfect, what happened when, so that the scene can be repaired."""
    figures = [
        f"{name} {'not measured' if value is None else f'{value:.4f}'}"
        for name, value in (("score", score.score), ("progress", score.progress))
    ]
    moments = [(f"{hit.side} contact with {hit.label} {hit.agent_id}", hit.time_us) for hit in score.collisions]
    moments += [("off the road", score.offroad_us), ("off the recorded path", score.left_path_us)]
    if score.valid and score.offroad is None:
        figures.append("leaving the road not measured")
    happened = [f"{what} at {time_us * 1e-6:.2f} s" for what, time_us in moments if time_us is not None]
    return ", ".join([*figures, *happened, *([score.reason] if score.reason else [])])
