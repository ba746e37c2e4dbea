"""One simulated drive, as it is kept, scored and drawn."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scenes.scene import Agent, Scene
from olt_closed_loop.vehicle.state import STATE_SIZE
from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_generator.omissions import Omission
from olt_generator.poses import Array
from olt_toolkit.runtime.json_files import read_json

Traffic = Literal["recorded", "idm"]
FILE_VERSION = 2
"""Of files of rollouts; those of other versions are refused."""


@dataclass(frozen=True)
class Incidents:
    """How often something went wrong, over the steps of one rollout.

    Attributes:
        policy_errors: calls in which the policy raised; the first ends the rollout.
        plans_refused: plans of a wrong shape or not finite; the last feasible plan was held.
        saturations: steps in which a command reached a limit of the vehicle.
        solves_failed: steps in which the controller found no command; its last feasible ones were held.
        solves_late: steps in which it found them after its deadline; its last feasible ones were held.
        solves_given_up: steps in which fatrop gave up, whether or not the fallback of `nonlinear` found commands.
    """

    policy_errors: int = 0
    plans_refused: int = 0
    saturations: int = 0
    solves_failed: int = 0
    solves_late: int = 0
    solves_given_up: int = 0


@dataclass(frozen=True)
class Rollout:
    """A drive of one policy through one scene.

    Attributes:
        scene, category: name and category of the scene.
        policy: name of the policy.
        seed: what the rollout was seeded with.
        handover_us: when the policy took over; before it the recording drives.
        timestamps_us: (n,) int64, every 0.1 s.
        states: (n, 6) float64 vehicle states (`vehicle.state`).
        heights: (n,) float64 height of the rig in the world, metres, as recorded at the nearest place.
        controls: (n - 1, 2) float64 commands held after each time; those of the warm-up are NaN: nobody gave them.
        plan_times_us: (m,) int64, when each accepted plan was made.
        plans: (m, 65, 3) float64 x, y, yaw in the world at the plan's time + 0, 0.1, ... 6.4 s.
        incidents: what went wrong, counted.
        plan_deviation_max, plan_deviation_rms: how far the vehicle was foreseen to be from the plans as they were
            given, metres (`control.tracking.SolveCounts`); None where it was not measured.
        failure: why the rollout is not valid, or None.
        rendered_images: number of images rendered for each camera; empty when none was.
        left_out: what was not computed, and why.
        vehicle_steps: steps of the vehicle by model and method (`vehicle.integrators`), such as "kinematic midpoint".
        timings: seconds spent by kind of work; the only part that differs between equal runs.
        traffic: whether the agents replayed the recording ("recorded") or reacted to the ego ("idm").
        reacted: the agents that came to differ from the recording, as they moved.
    """

    scene: str
    category: str
    policy: str
    seed: int
    handover_us: int
    timestamps_us: NDArray[np.int64]
    states: Array
    heights: Array
    controls: Array
    plan_times_us: NDArray[np.int64]
    plans: Array
    incidents: Incidents = Incidents()
    plan_deviation_max: float | None = None
    plan_deviation_rms: float | None = None
    failure: str | None = None
    rendered_images: dict[str, int] = field(default_factory=dict)
    left_out: tuple[Omission, ...] = ()
    vehicle_steps: dict[str, int] = field(default_factory=dict)
    timings: dict[str, float] = field(default_factory=dict)
    traffic: Traffic = "recorded"
    reacted: tuple[Agent, ...] = ()

    def driven_scene(self, scene: Scene) -> Scene:
        """The scene with its agents as they moved in this rollout."""
        reacted = {agent.id: agent for agent in self.reacted}
        return replace(scene, agents=tuple(reacted.get(agent.id, agent) for agent in scene.agents))

    def to_dict(self) -> dict[str, Any]:
        """The rollout as JSON can hold it; `from_dict` gives it back exactly."""
        return {
            **_plain(self),
            "controls": [None if np.isnan(control).any() else control.tolist() for control in self.controls],
            "incidents": vars(self.incidents),
            "left_out": [omission.to_dict() for omission in self.left_out],
            "reacted": [_plain(agent) for agent in self.reacted],
        }

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "Rollout":
        """The rollout that `to_dict` wrote.

        Raises:
            InputError: a field is missing, unknown, or of another form.
        """
        try:
            arrays = {"timestamps_us": np.int64, "poses": np.float64}
            controls = [[np.nan, np.nan] if control is None else control for control in values["controls"]]
            parts = {
                "timestamps_us": np.array(values["timestamps_us"], dtype=np.int64),
                "states": np.array(values["states"], dtype=np.float64).reshape(-1, STATE_SIZE),
                "heights": np.array(values["heights"], dtype=np.float64),
                "controls": np.array(controls, dtype=np.float64).reshape(-1, 2),
                "plan_times_us": np.array(values["plan_times_us"], dtype=np.int64),
                "plans": np.array(values["plans"], dtype=np.float64).reshape(len(values["plan_times_us"]), -1, 3),
                "incidents": Incidents(**values["incidents"]),
                "left_out": tuple(Omission(**omission) for omission in values["left_out"]),
                "reacted": tuple(
                    Agent(**agent | {name: np.array(agent[name], dtype=kind) for name, kind in arrays.items()})
                    for agent in values["reacted"]
                ),
            }
            return cls(**values | parts)
        except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
            raise InputError(f"rollout: field missing or of another form ({error}); simulate it again") from error


def _plain(record: Rollout | Agent) -> dict[str, Any]:
    """The fields, with lists for arrays."""
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in vars(record).items()}


def save_rollouts(path: Path, rollouts: Sequence[Rollout]) -> None:
    """Write rollouts as one JSON file, whole or not at all."""
    values = {"version": FILE_VERSION, "rollouts": [rollout.to_dict() for rollout in rollouts]}
    text = json.dumps(values, allow_nan=False)
    with write_whole(path) as temporary:
        temporary.write_text(text + "\n")


def load_rollouts(path: Path) -> list[Rollout]:
    """Read what `save_rollouts` wrote.

    Raises:
        InputError: the file is missing, holds something else, or was written by another version.
    """
    try:
        values = read_json(path, "file of rollouts")
        rollouts, version = values["rollouts"], values.get("version", 1)
    except (InputError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"{path}: not a file of rollouts ({error}); give one that `olt closed-loop run` wrote"
        ) from error
    if version != FILE_VERSION:
        raise InputError(f"{path}: rollouts of version {version}, not {FILE_VERSION}; simulate them again")
    return [Rollout.from_dict(rollout) for rollout in rollouts]
