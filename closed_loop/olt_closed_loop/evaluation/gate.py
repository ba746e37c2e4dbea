"""A check that scores mean something: on this scene, do three drives of known worth get what they are worth?"""

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from olt_closed_loop.rollouts.rollout_record import record_rollout
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
    recorded_m = recorded_length(record_rollout(scene, replayed))
    checks = [_check("replay scores 1", score_rollout(scene, replayed), 1.0, collisions=0)]
    if recorded_m < SHORT_RECORDING:
        unasked = f"the recording drives less than {SHORT_RECORDING:g} m"
        checks.append(GateCheck("standing scores 0", None, unasked))
    else:
        standing = score_rollout(scene, stand(scene, settings))
        checks.append(_check("standing scores 0", standing, 0.0, progress=0.0))
    if recorded_m < 2.0 * scene.vehicle.length:
        checks.append(GateCheck("a wall is hit once", None, "the recording drives less than two vehicle lengths"))
    else:
        # Across the way of the ego, where the centre of its box is at the end of the drive.
        x, y, yaw = replayed.states[-1, : STATE.speed]
        ahead = scene.vehicle.rear_axle_to_bbox_center
        pose = [x + ahead * np.cos(yaw), y + ahead * np.sin(yaw), replayed.heights[-1] + 0.5 * WALL_HEIGHT, yaw]
        times, poses = replayed.timestamps_us[[0, -1]], np.array([pose, pose])
        wall = Agent("wall", "barrier", WALL_LENGTH, WALL_WIDTH, WALL_HEIGHT, times, poses)
        walled = score_rollout(replace(scene, agents=(wall,)), replayed)
        checks.append(_check("a wall is hit once", walled, 0.0, collisions=1))
    return GateResult(scene.name, tuple(checks))


def _check(
    name: str, score: RolloutScore, expected: float, collisions: int | None = None, progress: float | None = None
) -> GateCheck:
    """Whether the score, and the number of collisions or the progress where given, are those expected.

    What is found is the score and, where it is not perfect, what happened when, so that the scene can be repaired.
    """
    passed = (
        score.score == expected and collisions in (None, len(score.collisions)) and progress in (None, score.progress)
    )
    figures = [
        f"{name} {'not measured' if value is None else f'{value:.4f}'}"
        for name, value in (("score", score.score), ("progress", score.progress))
    ]
    moments = [(f"{hit.side} contact with {hit.label} {hit.agent_id}", hit.time_us) for hit in score.collisions]
    moments += [("off the road", score.offroad_us), ("off the recorded path", score.left_path_us)]
    happened = [f"{what} at {time_us * 1e-6:.2f} s" for what, time_us in moments if time_us is not None]
    return GateCheck(name, passed, ", ".join([*figures, *happened, *([score.reason] if score.reason else [])]))
