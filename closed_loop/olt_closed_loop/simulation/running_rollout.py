"""One rollout while it runs: where the vehicle has been, what was planned, and what its policy is shown."""

import time
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.control.plans import PlanRefused, WorldPlan, is_out_of_reach, place_plan
from olt_closed_loop.control.tracking import TrackingController
from olt_closed_loop.rollouts.rollout import Incidents, Rollout
from olt_closed_loop.scenes.conditions import CLEAR_DAY
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.simulation.answers import Answer, PolicyFault, word_error
from olt_closed_loop.simulation.camera_faults import FaultyCameras
from olt_closed_loop.simulation.policy_hosts import PolicyTraits
from olt_closed_loop.simulation.reactive_agents import ReactiveAgents
from olt_closed_loop.simulation.recorded_motion import recorded_motion
from olt_closed_loop.simulation.settings import SimulationSettings, step_times
from olt_closed_loop.vehicle.integrators import VehicleStepper
from olt_closed_loop.vehicle.parameters import with_rolling_tyres
from olt_closed_loop.vehicle.state import STATE, STATE_SIZE
from olt_generator.errors import InputError
from olt_generator.omissions import Omission
from olt_generator.poses import Array, planar_pose
from olt_generator.seeds import derive_seed
from olt_toolkit.policy.contract import (
    FUTURE_STEPS,
    HISTORY_STEPS,
    IMAGE_FRAMES,
    STEP_SECONDS,
)
from olt_toolkit.policy.route import PathTracker, route_ahead
from olt_toolkit.rigs.rig import CAMERA_INDEX

_BEFORE = HISTORY_STEPS - 1


Sensors = Callable[[tuple[str, ...], tuple[int, int], Array, int], NDArray[np.uint8]]
"""(names of cameras, (H, W), T_world_rig (4, 4), time in microseconds) -> images (cameras, 3, H, W)."""


@dataclass(frozen=True)
class RolloutRequest:
    """A scene to drive, what seeds the rollout, and what takes pictures in it."""

    scene: Scene
    seed: int = 0
    sensors: Sensors | None = None


class RunningRollout:
    """The drive of one vehicle through one scene; steps are counted from the start of the recording.

    Attributes:
        times: (n,) int64 times of the steps, microseconds.
        incidents: counted so far.
        failure: why the rollout cannot go on, or None.
    """

    def __init__(self, request: RolloutRequest, policy: PolicyTraits, settings: SimulationSettings) -> None:
        """Follow the recording up to the hand-over.

        Raises:
            InputError: the recording is too short, the policy needs cameras and there is nothing to take pictures, or
                pictures would show reactive traffic where it is not.
        """
        if policy.cameras and request.sensors is None:
            raise InputError(f"policy {policy.name} needs cameras ({', '.join(policy.cameras)}); give a renderer")
        if policy.cameras and settings.traffic != "recorded":
            raise InputError(
                f"policy {policy.name} has cameras, and pictures show agents where they were recorded; "
                "give recorded traffic instead of reactive"
            )
        self._scene, self._seed, self._sensors = request.scene, request.seed, request.sensors
        self._policy, self._settings = policy, settings
        self.times = step_times(self._scene, settings)
        self.incidents: Counter[str] = Counter()
        self.failure: str | None = None
        self._failure_kind: str | None = None
        self._refused_in_a_row = 0
        self._parameters = settings.vehicle_of(self._scene)
        self._controller = TrackingController(self._parameters, settings.control)
        self._stepper = VehicleStepper(self._parameters, settings.integrator, step=STEP_SECONDS)
        self._plans: list[WorldPlan] = []
        self._frames: deque[NDArray[np.uint8]] = deque(maxlen=IMAGE_FRAMES)
        self._timings: defaultdict[str, float] = defaultdict(float)
        self._faults = FaultyCameras(settings.camera_faults, policy.cameras, derive_seed(self._seed, self._scene.name))
        self._unseen = 0
        self._rendered, self._driven = 0, settings.handover
        self._follow_recording()
        reactive = settings.traffic == "idm"
        self._agents = ReactiveAgents(self._scene.agents, int(self.times[self._driven])) if reactive else None
        self._ignores_route = settings.skip and not policy.uses_route
        self._route: PathTracker | None = None
        if len(self._scene.route) and not self._ignores_route:
            self._route = PathTracker(self._scene.route[:, :2])
            self._route.start_at(self._states[settings.handover - settings.planner_delay, : STATE.yaw])

    def _follow_recording(self) -> None:
        recorded, heights = recorded_motion(self._scene, self.times[: self._driven + 1])
        count = len(recorded)
        self._states = np.full((len(self.times), self._parameters.state_size), np.nan)
        self._heights = np.full(len(self.times), np.nan)
        self._controls = np.full((len(self.times) - 1, 2), np.nan)
        self._states[:count] = with_rolling_tyres(recorded, self._parameters)
        self._heights[:count] = heights
        x, y, yaw, speed = recorded[0, : STATE.steering]
        back = STEP_SECONDS * speed * np.arange(-_BEFORE, 0)
        z = np.full(_BEFORE, heights[0])
        # Before the recording starts the rig is taken to have come straight at its first velocity.
        self._earlier = np.column_stack([x + np.cos(yaw) * back, y + np.sin(yaw) * back, z, np.full(_BEFORE, yaw)])

    def begin(self, fault: PolicyFault | None) -> None:
        """Start with a policy in a known state, or end with the fault that it could not be brought into one."""
        if fault:
            self._end_by(fault, 0)

    def runs_at(self, step: int) -> bool:
        """Whether the vehicle is still to be driven on from this step."""
        return not self.failure and step < len(self.times) - 1

    def past_poses(self, step: int) -> Array:
        """x, y, z, yaw (16, 4) of the rig in the world at this step and the 15 before it."""
        first = step - _BEFORE
        known = slice(max(first, 0), step + 1)
        poses = np.column_stack([self._states[known, :2], self._heights[known], self._states[known, STATE.yaw]])
        return poses if first >= 0 else np.concatenate([self._earlier[first:], poses])

    def images(self) -> NDArray[np.uint8] | None:
        """The last four pictures (cameras, 4, 3, H, W) of each camera of the policy, or None without cameras."""
        return np.stack(self._frames, axis=1) if self._policy.cameras else None

    def seed_at(self, step: int) -> int:
        """What seeds the policy's call at a step."""
        return derive_seed(self._seed, self._scene.name, step)

    def route_ahead(self, step: int) -> Array:
        """Route (20, 2) ahead in the rig frame, metres, filled up with NaN where it ends earlier or is not known."""
        x, y, yaw = self._states[step, : STATE.speed].tolist()
        return route_ahead(self._route, x, y, yaw)

    def take_pictures(self, step: int) -> None:
        """Render the policy's cameras once, if it has any; the picture serves this step and the next three."""
        if self._sensors is None or not self._policy.cameras:
            return
        x, y, yaw = self._states[step, : STATE.speed]
        pose = planar_pose(x, y, yaw, self._heights[step])
        now_us = int(self.times[step])
        with self._timed("rendering"):
            images = self._sensors(self._policy.cameras, self._policy.image_size, pose, now_us)
            self._frames.append(self._faults.show(images, now_us))
        self._rendered += 1

    def leave_out_pictures(self) -> None:
        """Note that the policy's cameras take no picture at a step, because no plan is made from it."""
        self._unseen += bool(self._policy.cameras)

    def accept(self, answer: Answer, step: int, seconds: float) -> None:
        """Keep the plan made at a step in so many seconds, count that it is refused, or end with the policy's fault."""
        self._timings["policy"] += seconds
        self.incidents["plans_asked"] += 1
        if isinstance(answer, PolicyFault):
            self._end_by(answer, step)
            return
        try:
            if isinstance(answer, PlanRefused):
                raise answer
            x, y, yaw, speed = self._states[step, : STATE.speed + 1]
            plan = place_plan(answer, x, y, yaw, int(self.times[step]))
            velocity = speed * np.array([np.cos(yaw), np.sin(yaw)])
            self.incidents["plans_out_of_reach"] += is_out_of_reach(plan, velocity)
            self._plans.append(plan)
            self._refused_in_a_row = 0
        except PlanRefused as refusal:
            self._refuse(str(refusal), step)

    def _refuse(self, reason: str, step: int) -> None:
        self.incidents["plans_refused"] += 1
        self._refused_in_a_row += 1
        most = self._settings.limits.refused_in_a_row
        if not self._plans:
            self._end("plans_refused", f"the first plan was refused: {reason}")
        elif self._refused_in_a_row > most:
            self._end(
                "plans_refused",
                f"more than {most} plans in a row were refused, the last at {self.times[step] * 1e-6:.1f} s: {reason}",
            )

    def _end_by(self, fault: PolicyFault, step: int) -> None:
        self.incidents[fault.kind] += 1
        self._end(fault.kind, fault.at(self.times[step] * 1e-6))

    def _end(self, kind: str, reason: str) -> None:
        self._failure_kind, self.failure = kind, reason

    def move(self, step: int) -> None:
        """Drive one step; a plan with which control or vehicle cannot go on ends the rollout."""
        try:
            self._follow_plan(step)
        except (ArithmeticError, RuntimeError, ValueError) as error:
            self.incidents["steps_failed"] += 1
            reason = f"{type(error).__name__}: {word_error(error)}"
            self._end(
                "steps_failed", f"the vehicle could not follow the plan at {self.times[step] * 1e-6:.1f} s: {reason}"
            )

    def _follow_plan(self, step: int) -> None:
        """Follow the plan in force, the newest older than the delay, for one step; agents react to the ego before."""
        now_us, before = int(self.times[step]), self._states[step]
        in_force_us = now_us - self._settings.planner_delay_us
        plan = next(plan for plan in reversed(self._plans) if plan.timestamps_us[0] <= in_force_us)
        with self._timed("control"):
            control = self._controller.control(before, plan, now_us)
        low, high = self._controller.parameters.control_limits
        self.incidents["saturations"] += bool(np.any((control <= low) | (control >= high)))
        with self._timed("vehicle"):
            self._stepper.shift(self._controller.parameters.reverse_gear)
            state = self._stepper(before, control)
        if self._agents is not None:
            x, y, yaw, speed = before[: STATE.steering]
            ego, ahead = self._scene.vehicle, self._scene.vehicle.rear_axle_to_bbox_center
            center = np.array([x + ahead * np.cos(yaw), y + ahead * np.sin(yaw), yaw])
            self._agents.step(now_us, center, (ego.length, ego.width), speed)
        # The ground is as high as at the nearest recorded pose.
        ground = self._scene.ego.positions
        nearest = np.argmin((ground[:, 0] - state[STATE.x]) ** 2 + (ground[:, 1] - state[STATE.y]) ** 2)
        self._controls[step], self._states[step + 1], self._heights[step + 1] = control, state, ground[nearest, 2]
        self._driven = step + 1

    @contextmanager
    def _timed(self, work: str) -> Iterator[None]:
        """Add the time that the block takes to a kind of work."""
        started = time.perf_counter()
        yield
        self._timings[work] += time.perf_counter() - started

    def rollout(self) -> Rollout:
        """What has been driven."""
        self._judge_refusals()
        count = self._driven + 1
        plans = [plan.poses for plan in self._plans]
        solves = self._controller.counts
        return Rollout(
            scene=self._scene.name,
            category=self._scene.category,
            policy=self._policy.name,
            seed=self._seed,
            handover_us=int(self.times[self._settings.handover]),
            timestamps_us=self.times[:count],
            states=self._states[:count, :STATE_SIZE],
            heights=self._heights[:count],
            controls=self._controls[: count - 1],
            plan_times_us=np.array([plan.timestamps_us[0] for plan in self._plans], dtype=np.int64),
            plans=np.stack(plans) if plans else np.zeros((0, FUTURE_STEPS + 1, 3)),
            incidents=Incidents(
                **self.incidents,
                solves=self._driven - self._settings.handover,
                solves_failed=solves.failed,
                solves_late=solves.late,
                solves_given_up=solves.given_up,
            ),
            plan_deviation_max=solves.deviation_max if solves.calls else None,
            plan_deviation_rms=solves.deviation_rms if solves.calls else None,
            failure=self.failure,
            failure_kind=self._failure_kind,
            rendered_images=dict.fromkeys(self._policy.cameras, self._rendered),
            left_out=(*self._left_out(), *self._stepper.left_out()),
            vehicle_steps={way: steps for way, (steps, _) in self._stepper.taken().items()},
            timings=dict(self._timings),
            traffic=self._settings.traffic,
            reacted=self._agents.reacted() if self._agents else (),
            conditions=self._settings.conditions.words if self._rendered else None,
            camera_faults=dict(self._faults.affected),
        )

    def _judge_refusals(self) -> None:
        refused, asked = self.incidents["plans_refused"], self.incidents["plans_asked"]
        most = self._settings.limits.refused_share
        if not self.failure and refused > most * asked:
            self._end("plans_refused", f"{refused} of {asked} plans were refused, more than {100 * most:g} %")

    def _left_out(self) -> Iterator[Omission]:
        unseen = f"policy {self._policy.name} does not look at "
        unused = [camera for camera in CAMERA_INDEX if camera not in self._policy.cameras]
        if unused:
            yield Omission(f"rendering of {', '.join(unused)}", f"{unseen}them")
        if self._unseen:
            yield Omission("pictures between decisions", "no plan is made from them", self._unseen)
        if self._settings.vehicle == "kinematic":
            yield Omission("tyre dynamics", "the vehicle is kinematic")
        if not self._policy.cameras and self._settings.conditions != CLEAR_DAY:
            yield Omission("light and weather", f"policy {self._policy.name} has no cameras")
        if not self._policy.cameras and self._settings.camera_faults:
            yield Omission("faults of cameras", f"policy {self._policy.name} has none")
        if self._ignores_route:
            yield Omission("the route ahead", f"{unseen}it")
