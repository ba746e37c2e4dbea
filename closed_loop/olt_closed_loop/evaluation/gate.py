"""A check that scores mean something: on this scene, do three drives of known worth get what they are worth?"""

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from olt_closed_loop.rollouts.rollout import Rollout
from olt_closed_loop.scenes.scene import Agent, Scene
from olt_closed_loop.scoring.definitions import SHORT_RECORDING, RolloutScore, recorded_length, score_rollout
from olt_closed_loop.simulation.closed_loop import replay, stand
from olt_closed_loop.simulation.settings import SimulationSettings
from olt_closed_loop.vehicle.state import STATE

WALL_LENGTH, WALL_WIDTH, WALL_HEIGHT = 0.5, 8.0, 2.0


@dataclass(frozen=True)
class GateCheck:
    """One check: what was asked, whether it holds (None: it cannot be asked of this scene), and what was found."""

    name: str
    passed: bool | None
    finding: str


@dataclass(frozen=True)
class GateResult:
    """The checks of one scene."""

    scene: str
    checks: tuple[GateCheck, ...]

    @property
    def failed(self) -> list[GateCheck]:
        """The checks that were asked and do not hold."""
        return [check for check in self.checks if check.passed is False]

    @property
    def passed(self) -> bool:
        """Whether no check failed."""
        return not self.failed

    def to_dict(self) -> dict[str, Any]:
        """The result as JSON can hold it."""
        return {"scene": self.scene, "passed": self.passed, "checks": [asdict(check) for check in self.checks]}


def check_gate(scene: Scene, settings: SimulationSettings | None = None) -> GateResult:
    """Score three given drives of the scene.

    Replaying the recording must score 1 without a collision; a car that stands from the hand-over on must make no
    progress and score 0; replaying it into a wall across the road must give exactly one collision, at fault, score 0.

    Raises:
        InputError: the recording is too short to be driven.
    """
    replayed = replay(scene, settings)
    recorded_m = recorded_length(scene, replayed)
    checks = (
        _check_replay(scene, replayed),
        _check_standing(scene, settings, recorded_m),
        _check_wall(scene, replayed, recorded_m),
    )
    return GateResult(scene.name, checks)


def _check_replay(scene: Scene, replayed: Rollout) -> GateCheck:
    score = score_rollout(scene, replayed)
    return GateCheck("replay scores 1", score.score == 1.0 and not score.collisions, _describe(score))


def _check_standing(scene: Scene, settings: SimulationSettings | None, recorded_m: float) -> GateCheck:
    name = "standing scores 0"
    if recorded_m < SHORT_RECORDING:
        return GateCheck(name, None, f"the recording drives less than {SHORT_RECORDING:g} m")
    score = score_rollout(scene, stand(scene, settings))
    return GateCheck(name, score.score == 0.0 and score.progress == 0.0, _describe(score))


def _check_wall(scene: Scene, replayed: Rollout, recorded_m: float) -> GateCheck:
    name = "a wall is hit once"
    if recorded_m < 2.0 * scene.vehicle.length:
        return GateCheck(name, None, "the recording drives less than two vehicle lengths")
    score = score_rollout(replace(scene, agents=(_wall(scene, replayed),)), replayed)
    return GateCheck(name, score.score == 0.0 and len(score.collisions) == 1, _describe(score))


def _wall(scene: Scene, replayed: Rollout) -> Agent:
    """A wall where the ego's box centre is at the end of the drive, across its way."""
    x, y, yaw = replayed.states[-1, : STATE.speed]
    ahead = scene.vehicle.rear_axle_to_bbox_center
    pose = [x + ahead * np.cos(yaw), y + ahead * np.sin(yaw), replayed.heights[-1] + 0.5 * WALL_HEIGHT, yaw]
    times = replayed.timestamps_us[[0, -1]]
    return Agent("wall", "barrier", WALL_LENGTH, WALL_WIDTH, WALL_HEIGHT, times, np.array([pose, pose]))


def _describe(score: RolloutScore) -> str:
    """The score and, where it is not perfect, what happened when, so that the scene can be repaired."""
    happened = [
        f"{hit.side} contact with {hit.label} {hit.agent_id} at {_seconds(hit.time_us)}" for hit in score.collisions
    ]
    if score.offroad_us is not None:
        happened.append(f"off the road at {_seconds(score.offroad_us)}")
    if score.left_path_us is not None:
        happened.append(f"off the recorded path at {_seconds(score.left_path_us)}")
    if score.reason:
        happened.append(score.reason)
    return ", ".join([f"score {_figure(score.score)}", f"progress {_figure(score.progress)}", *happened])


def _figure(value: float | None) -> str:
    return "not measured" if value is None else f"{value:.4f}"


def _seconds(time_us: int) -> str:
    return f"{time_us * 1e-6:.2f} s"
