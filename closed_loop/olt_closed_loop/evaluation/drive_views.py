"""What there is to be seen of a rollout: who was where, what happened when, how far off its plan the vehicle was."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.rollouts.rollout import Rollout
from olt_closed_loop.rollouts.rollout_record import record_rollout
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.scoring.definitions import RolloutScore
from olt_closed_loop.scoring.moving_boxes import MovingBox, agent_box, ego_box
from olt_generator.errors import InputError
from olt_generator.poses import Array
from olt_toolkit.policy.contract import STEP_US


@dataclass(frozen=True)
class Moment:
    """A moment of a drive, in words, with the agent that it concerns, if any; `bad` where it costs the score."""

    time_us: int
    text: str
    bad: bool = False
    agent_id: str | None = None


@dataclass(frozen=True)
class DriveView:
    """A rollout with its scene as it was driven.

    Attributes:
        scene: with the agents as they moved.
        rollout, score: what is shown.
        ego: the box of the ego.
        agents: the boxes of the agents, by id.
        moments: in order of time.
    """

    scene: Scene
    rollout: Rollout
    score: RolloutScore
    ego: MovingBox
    agents: dict[str, MovingBox]
    moments: tuple[Moment, ...]

    def seconds(self, time_us: int) -> float:
        """Time since the start of the recording."""
        return (time_us - int(self.scene.ego.timestamps_us[0])) * 1e-6

    def title(self) -> str:
        """Which rollout, and what it is worth."""
        score, rollout = self.score, self.rollout
        worth = "no score" if score.score is None else f"score {score.score:.3f}"
        reason = f" ({score.reason})" if score.reason else ""
        return f"{rollout.scene}, seed {rollout.seed}, policy {rollout.policy}: {worth}{reason}, {score.definition}"


def view_drive(scene: Scene, rollout: Rollout, score: RolloutScore) -> DriveView:
    """Put together what is to be seen.

    Raises:
        InputError: the rollout failed before its first step, or is one of another scene.
    """
    if rollout.scene != scene.name:
        raise InputError(f"rollout of scene {rollout.scene} cannot be shown on scene {scene.name}; give its own scene")
    if len(rollout.timestamps_us) < 2:
        raise InputError(
            f"rollout of scene {rollout.scene}, seed {rollout.seed}: nothing was driven: {rollout.failure}"
        )
    driven = rollout.driven_scene(scene)
    return DriveView(
        scene=driven,
        rollout=rollout,
        score=score,
        ego=ego_box(record_rollout(scene, rollout)),
        agents={agent.id: agent_box(agent) for agent in driven.agents},
        moments=tuple(sorted(_list_moments(rollout, score), key=lambda moment: moment.time_us)),
    )


def plan_deviations(rollout: Rollout) -> Array:
    """Metres (n,) from the vehicle to where the plan in force wanted it at each time; NaN where no plan was in force.

    A plan is in force for the step that begins when its delay has passed, until the next is.
    """
    deviations = np.full(len(rollout.timestamps_us), np.nan)
    if not len(rollout.plan_times_us):
        return deviations
    delay_us = rollout.handover_us - rollout.plan_times_us[0]
    in_force = np.searchsorted(rollout.plan_times_us, rollout.timestamps_us - STEP_US - delay_us, side="right") - 1
    for row in np.flatnonzero((in_force >= 0) & (rollout.timestamps_us > rollout.handover_us)):
        plan, age = rollout.plans[in_force[row]], rollout.timestamps_us[row] - rollout.plan_times_us[in_force[row]]
        steps = np.arange(len(plan)) * STEP_US
        wanted = [np.interp(age, steps, plan[:, axis]) for axis in range(2)]
        deviations[row] = np.hypot(*(rollout.states[row, :2] - wanted))
    return deviations


def _list_moments(rollout: Rollout, score: RolloutScore) -> list[Moment]:
    moments = [Moment(rollout.handover_us, "hand-over")]
    for hit in score.collisions:
        fault = "at fault" if hit.at_fault else "not at fault"
        moments.append(
            Moment(
                hit.time_us, f"{hit.side} contact with {hit.label} {hit.agent_id}, {fault}", hit.at_fault, hit.agent_id
            )
        )
    if score.offroad_us is not None:
        moments.append(Moment(score.offroad_us, "off the road", bad=True))
    if score.left_path_us is not None:
        moments.append(Moment(score.left_path_us, "4 m from the recorded path"))
    moments += [Moment(int(time_us), "plan refused") for time_us in _refused_us(rollout)]
    if rollout.failure:
        moments.append(Moment(int(rollout.timestamps_us[-1]), rollout.failure, bad=True))
    return moments


def _refused_us(rollout: Rollout) -> NDArray[np.int64]:
    """When plans were refused: the policy was asked, and the plan is not there."""
    if not rollout.incidents.plans_refused or not len(rollout.plan_times_us):
        return np.zeros(0, dtype=np.int64)
    asked = np.arange(rollout.plan_times_us[0], rollout.timestamps_us[-1], STEP_US)
    return np.setdiff1d(asked, rollout.plan_times_us)[: rollout.incidents.plans_refused]
