"""What a rollout is worth: the definition `strict`.

It keeps the intent of AlpaSim's scene score (facts sheet alpasim, section 2) and differs from it where that depends on
accidents of the computation:

- Only what happens after the hand-over counts, here as there.
- Collisions are tested between the samples too, with the whole boxes and with heights. Their side does not depend on
  heading or on the order of agents. The ego is at fault when it moved into the agent (`collisions`). A collision that
  is not its fault does not end the rollout.
- Off road is any part of the ego's box outside the drivable area, however far beyond the edge.
- Progress is the arc length along the recorded path, as a share of what the recording drives in the same time, from
  the hand-over to the end of the rollout. It only grows and cannot jump between passages of the same place. It is not
  counted from the first time on at which the ego is 4 m or more from the recorded path.
- The score is 0 after a collision at fault or off the road, else min(progress / 0.8, 1). Where the recording drives
  less than 5 m in that time the progress score is 1.
- A rollout that failed is not valid and has no score.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from olt_closed_loop.collisions import Collision, MovingBox, ego_box, find_collisions, sample_times
from olt_closed_loop.drivable import first_departure
from olt_closed_loop.progress import PathTracker
from olt_closed_loop.rollout import Rollout
from olt_closed_loop.scene import Scene
from olt_closed_loop.vehicle import STATE
from olt_generator.errors import InputError

FULL_PROGRESS = 0.8
SHORT_RECORDING = 5.0
MAX_PATH_DISTANCE = 4.0


@dataclass(frozen=True)
class RolloutScore:
    """The score of one rollout.

    Attributes:
        scene, category, policy, seed: which rollout.
        definition: how the score is defined.
        valid: whether the rollout can be scored; if not, `reason` says why and what was not measured is None.
        score: the scene score, 0 to 1.
        progress: share of the recorded path that was driven after the hand-over, 0 to 1.
        collisions: first contact with each agent, in order of time; () when none was found.
        offroad: whether the ego left the drivable area; None when the scene has none.
        offroad_us: when it first did.
        left_path_us: when the ego was first 4 m or more from the recorded path.
        reason: why the score is 0 by rule ("collision_at_fault", "offroad"), why there is none, or None.
        left_out: what was not computed, and why.
    """

    scene: str
    category: str
    policy: str
    seed: int
    definition: Literal["strict"] = "strict"
    valid: bool = False
    score: float | None = None
    progress: float | None = None
    collisions: tuple[Collision, ...] = ()
    offroad: bool | None = None
    offroad_us: int | None = None
    left_path_us: int | None = None
    reason: str | None = None
    left_out: tuple[str, ...] = ()

    @property
    def collided(self) -> bool | None:
        """Whether anything was touched, at fault or not; None for a rollout that is not valid."""
        return bool(self.collisions) if self.valid else None

    @property
    def collided_at_fault(self) -> bool | None:
        """Whether the ego moved into anything; None for a rollout that is not valid."""
        return any(collision.at_fault for collision in self.collisions) if self.valid else None

    def to_dict(self) -> dict[str, Any]:
        """The score as JSON can hold it."""
        return {
            **vars(self),
            "collided": self.collided,
            "collided_at_fault": self.collided_at_fault,
            "collisions": [collision.to_dict() for collision in self.collisions],
            "left_out": list(self.left_out),
        }


def score_rollout(scene: Scene, rollout: Rollout, skip: bool = True) -> RolloutScore:
    """Score one rollout of the scene.

    Args:
        scene: the scene that was driven.
        rollout: the drive.
        skip: whether what cannot change the result is left out; the result is the same without, only slower.

    Raises:
        InputError: the rollout is one of another scene.
    """
    if rollout.scene != scene.name:
        raise InputError(f"rollout of scene {rollout.scene} cannot be scored on scene {scene.name}; give its own scene")
    named = {"scene": scene.name, "category": scene.category, "policy": rollout.policy, "seed": rollout.seed}
    if rollout.failure:
        return RolloutScore(**named, reason=rollout.failure)

    ego = ego_box(rollout, scene.vehicle)
    times = sample_times(rollout.handover_us, int(rollout.timestamps_us[-1]))
    collisions, unreachable = find_collisions(ego, scene.agents, times, skip_unreachable=skip)
    offroad_us = first_departure(scene, ego, times) if scene.drivable else None
    progress, left_path_us = _progress(scene, rollout)
    reason = _zero_reason(collisions, offroad_us)
    return RolloutScore(
        **named,
        valid=True,
        score=0.0 if reason else _progress_score(scene, rollout, progress),
        progress=progress,
        collisions=collisions,
        offroad=offroad_us is not None if scene.drivable else None,
        offroad_us=offroad_us,
        left_path_us=left_path_us,
        reason=reason,
        left_out=_left_out(scene, ego, unreachable),
    )


def _progress(scene: Scene, rollout: Rollout) -> tuple[float, int | None]:
    """Progress of the rollout, and when it left the path."""
    tracker = PathTracker(scene.ego.positions[:, :2])
    handed_over, reached, left_path_us = 0.0, 0.0, None
    for time_us, state in zip(rollout.timestamps_us, rollout.states, strict=True):
        arc_length = tracker.advance(state[: STATE.yaw])
        if tracker.distance >= MAX_PATH_DISTANCE:
            left_path_us = int(time_us)
            break
        reached = arc_length
        if time_us <= rollout.handover_us:
            handed_over = reached
    recorded = recorded_length(scene, rollout)
    return (min((reached - handed_over) / recorded, 1.0) if recorded > 0.0 else 1.0), left_path_us


def recorded_length(scene: Scene, rollout: Rollout) -> float:
    """Metres that the recording drives from the rollout's hand-over to its end."""
    ego = scene.ego
    steps = np.linalg.norm(np.diff(ego.positions[:, :2], axis=0), axis=1)
    driven = np.concatenate([[0.0], np.cumsum(steps)])
    asked = np.array([rollout.handover_us, rollout.timestamps_us[-1]]) - ego.timestamps_us[0]
    start, end = np.interp(asked, ego.timestamps_us - ego.timestamps_us[0], driven)
    return float(end - start)


def _progress_score(scene: Scene, rollout: Rollout, progress: float) -> float:
    if recorded_length(scene, rollout) < SHORT_RECORDING:
        return 1.0
    return min(progress / FULL_PROGRESS, 1.0)


def _zero_reason(collisions: tuple[Collision, ...], offroad_us: int | None) -> str | None:
    if any(collision.at_fault for collision in collisions):
        return "collision_at_fault"
    return "offroad" if offroad_us is not None else None


def _left_out(scene: Scene, ego: MovingBox, unreachable: tuple[str, ...]) -> tuple[str, ...]:
    notes = []
    if unreachable:
        notes.append(f"collision tests of {len(unreachable)} of {len(scene.agents)} agents: never within reach")
    if not scene.drivable:
        notes.append("road test: the scene has no drivable area")
    return tuple(notes)
