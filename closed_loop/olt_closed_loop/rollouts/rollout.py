"""One simulated drive, as it is kept, scored and drawn."""

from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scenes.scene import Agent, Scene
from olt_closed_loop.vehicle.state import STATE_SIZE
from olt_generator.errors import InputError
from olt_generator.omissions import Omission
from olt_generator.poses import Array

Traffic = Literal["recorded", "idm"]


@dataclass(frozen=True)
class Incidents:
    """How often something went wrong, over the steps of one rollout.

    Attributes:
        plans_asked: calls of the policy.
        plans_refused: plans of a wrong shape, not finite, no rotations, or faster than any vehicle; the last feasible
            plan was held. Where the first, too many in a row or too large a share was, the rollout has failed.
        plans_out_of_reach: plans that no tyres can hold (`control.plans.is_out_of_reach`), as those that go back from a
            car in motion or begin elsewhere; they were followed as far as the vehicle can.
        policy_errors: the policy raised; as each of the next seven this ends the rollout.
        policy_exits: it called for an exit.
        policy_deaths: its process ended or crashed.
        policy_timeouts: it gave no answer in time.
        wrong_answers: it answered with something else than a planned trajectory of numbers.
        inputs_changed: it changed what it was shown.
        globals_changed: it changed the states of `random` or `numpy.random`, or the working folder.
        steps_failed: control or vehicle could not go on with its plan.
        solves: steps in which the controller was asked.
        saturations: steps in which a command reached a limit of the vehicle.
        solves_failed: steps in which the controller found no command; its last feasible ones were held.
        solves_late: steps in which it found them after its deadline; its last feasible ones were held.
        solves_given_up: steps in which fatrop gave up, whether or not the fallback of `nonlinear` found commands.
    """

    plans_asked: int = 0
    plans_refused: int = 0
    plans_out_of_reach: int = 0
    policy_errors: int = 0
    policy_exits: int = 0
    policy_deaths: int = 0
    policy_timeouts: int = 0
    wrong_answers: int = 0
    inputs_changed: int = 0
    globals_changed: int = 0
    steps_failed: int = 0
    solves: int = 0
    saturations: int = 0
    solves_failed: int = 0
    solves_late: int = 0
    solves_given_up: int = 0


INCIDENTS: tuple[str, ...] = tuple(field.name for field in fields(Incidents))
"""The names of the counts."""


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
        failure_kind: what kind of failure that is: the name of a count of `Incidents`, "scene_refused" or None.
        rendered_images: number of images rendered for each camera; empty when none was.
        left_out: what was not computed, and why.
        vehicle_steps: steps of the vehicle by model and method (`vehicle.integrators`), such as "kinematic midpoint".
        timings: seconds spent by kind of work; the only part that differs between equal runs.
        traffic: whether the agents replayed the recording ("recorded") or reacted to the ego ("idm").
        reacted: the agents that came to differ from the recording, as they moved.
        conditions: light and weather in which pictures were taken, in words; None where none was.
        camera_faults: how many pictures each fault of the cameras changed, by the fault in words.
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
    failure_kind: str | None = None
    rendered_images: dict[str, int] = field(default_factory=dict)
    left_out: tuple[Omission, ...] = ()
    vehicle_steps: dict[str, int] = field(default_factory=dict)
    timings: dict[str, float] = field(default_factory=dict)
    traffic: Traffic = "recorded"
    reacted: tuple[Agent, ...] = ()
    conditions: str | None = None
    camera_faults: dict[str, int] = field(default_factory=dict)

    @classmethod
    def not_driven(cls, scene: str, category: str, policy: str, seed: int, kind: str, reason: str) -> "Rollout":
        """The rollout that failed before its first step; it has no times and no states."""
        return cls(
            scene=scene,
            category=category,
            policy=policy,
            seed=seed,
            handover_us=0,
            timestamps_us=np.zeros(0, dtype=np.int64),
            states=np.zeros((0, STATE_SIZE)),
            heights=np.zeros(0),
            controls=np.zeros((0, 2)),
            plan_times_us=np.zeros(0, dtype=np.int64),
            plans=np.zeros((0, 0, 3)),
            incidents=Incidents(**({kind: 1} if kind in INCIDENTS else {})),
            failure=reason,
            failure_kind=kind,
        )

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
                "plans": _plans(values["plans"], len(values["plan_times_us"])),
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


def _plans(values: Any, count: int) -> Array:
    plans = np.array(values, dtype=np.float64)
    return plans.reshape(count, -1, 3) if count else plans.reshape(0, 0, 3)


def _plain(record: Rollout | Agent) -> dict[str, Any]:
    """The fields, with lists for arrays."""
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in vars(record).items()}
