"""One rollout while it runs: where the vehicle has been, what was planned, and what its policy is shown."""

import time
from collections import Counter, defaultdict, deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.control.plans import PlanRefused, WorldPlan, place_plan
from olt_closed_loop.control.tracking import TrackingController
from olt_closed_loop.rollouts.progress import PathTracker
from olt_closed_loop.rollouts.rollout import Events, Rollout
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.simulation.reactive_agents import ReactiveAgents
from olt_closed_loop.simulation.recorded_motion import recorded_motion
from olt_closed_loop.simulation.settings import SimulationSettings, step_times
from olt_closed_loop.vehicle.integrators import make_stepper
from olt_closed_loop.vehicle.parameters import with_rolling_tyres
from olt_closed_loop.vehicle.state import STATE, STATE_SIZE
from olt_generator.omissions import word_omission
from olt_generator.poses import Array, planar_pose
from olt_generator.seeds import derive_seed
from olt_toolkit.policy.contract import (
    FUTURE_STEPS,
    HISTORY_STEPS,
    IMAGE_FRAMES,
    STEP_SECONDS,
    PlannedTrajectory,
    Policy,
)

ROUTE_POINTS = 20
ROUTE_LENGTH = 80.0
"""Number of points and metres of the route that a policy is shown (docs/formats/alpasim.md)."""
_ROUTE_DISTANCES: Array = np.linspace(0.0, ROUTE_LENGTH, ROUTE_POINTS)
_BEFORE = HISTORY_STEPS - 1


class Sensors(Protocol):
    """What takes the pictures."""

    def render_rig(
        self, cameras: tuple[str, ...], size: tuple[int, int], T_world_rig: Array, time_us: int
    ) -> NDArray[np.uint8]:
        """Images (cameras, 3, H, W) of the named cameras on the rig at `T_world_rig`; `size` is (H, W)."""
        ...


class RunningDrive:
    """The drive of one vehicle through one scene; steps are counted from the start of the recording.

    Attributes:
        seed: seeds the rollout.
        times: (n,) int64 times of the steps, microseconds.
        events: counted so far.
        failure: why the drive cannot go on, or None.
    """

    def __init__(
        self,
        scene: Scene,
        policy: Policy,
        settings: SimulationSettings,
        seed: int,
        sensors: Sensors | None,
        with_route: bool,
    ) -> None:
        """Follow the recording up to the hand-over.

        Raises:
            InputError: the recording is too short.
        """
        self.seed, self.times = seed, step_times(scene, settings)
        self._parameters = settings.vehicle_of(scene)
        self._ground = scene.ego.positions.copy()
        self.events: Counter[str] = Counter()
        self.failure: str | None = None
        self._scene, self._policy, self._settings, self._sensors = scene, policy, settings, sensors
        self._controller = TrackingController(self._parameters, settings.control)
        self._stepper = make_stepper(self._parameters, settings.method, settings.substeps, STEP_SECONDS)
        self._plans: list[WorldPlan] = []
        self._frames: deque[NDArray[np.uint8]] = deque(maxlen=IMAGE_FRAMES)
        self._timings: defaultdict[str, float] = defaultdict(float)
        self._rendered = 0
        self._driven = settings.handover
        self._follow_recording()
        reactive = settings.traffic == "idm"
        self._agents = ReactiveAgents(scene.agents, int(self.times[self._driven])) if reactive else None
        self._route = self._start_route() if with_route and len(scene.route) else None

    def _follow_recording(self) -> None:
        recorded = recorded_motion(self._scene, self.times[: self._driven + 1])
        count = len(recorded.states)
        self._states = np.full((len(self.times), self._parameters.state_size), np.nan)
        self._heights = np.full(len(self.times), np.nan)
        self._controls = np.full((len(self.times) - 1, 2), np.nan)
        self._states[:count] = with_rolling_tyres(recorded.states, self._parameters)
        self._heights[:count] = recorded.heights
        x, y, yaw, speed = recorded.states[0, : STATE.steering]
        back = STEP_SECONDS * speed * np.arange(-_BEFORE, 0)
        z = np.full(_BEFORE, recorded.heights[0])
        # Before the recording starts the rig is taken to have come straight at its first velocity.
        self._earlier = np.column_stack([x + np.cos(yaw) * back, y + np.sin(yaw) * back, z, np.full(_BEFORE, yaw)])

    def _start_route(self) -> PathTracker:
        route = PathTracker(self._scene.route[:, :2])
        first_asked = self._settings.handover - self._settings.planner_delay
        route.start_at(self._states[first_asked, : STATE.yaw])
        return route

    def runs_at(self, step: int) -> bool:
        """Whether the vehicle is still to be driven on from this step."""
        return not self.failure and step < len(self.times) - 1

    def past_poses(self, step: int) -> Array:
        """x, y, z, yaw (16, 4) of the rig at this step and the 15 before it."""
        first = step - _BEFORE
        known = slice(max(first, 0), step + 1)
        poses = np.column_stack([self._states[known, :2], self._heights[known], self._states[known, STATE.yaw]])
        return poses if first >= 0 else np.concatenate([self._earlier[first:], poses])

    def images(self) -> NDArray[np.uint8] | None:
        """The last four pictures (cameras, 4, 3, H, W) of each camera of the policy, or None without cameras."""
        return np.stack(self._frames, axis=1) if self._policy.cameras else None

    def seed_at(self, step: int) -> int:
        """What seeds the policy's call at a step."""
        return derive_seed(self.seed, self._scene.name, step)

    def route_ahead(self, step: int) -> Array:
        """Route (20, 2) ahead in the rig frame, filled up with NaN where it ends earlier or is not known."""
        route = np.full((ROUTE_POINTS, 2), np.nan)
        if self._route is None:
            return route
        x, y, yaw = self._states[step, : STATE.speed]
        self._route.advance(np.array([x, y]))
        ahead = self._route.points_ahead(_ROUTE_DISTANCES) - (x, y)
        cos, sin = np.cos(yaw), np.sin(yaw)
        route[: len(ahead), 0] = cos * ahead[:, 0] + sin * ahead[:, 1]
        route[: len(ahead), 1] = cos * ahead[:, 1] - sin * ahead[:, 0]
        return route

    def take_pictures(self, step: int) -> None:
        """Render the policy's cameras once; the picture serves this step and the next three."""
        if self._sensors is None:
            return
        x, y, yaw = self._states[step, : STATE.speed]
        pose = planar_pose(x, y, yaw, self._heights[step])
        with self.timed("rendering"):
            pictures = self._sensors.render_rig(
                self._policy.cameras, self._policy.image_size, pose, int(self.times[step])
            )
        self._frames.append(pictures)
        self._rendered += 1

    def accept(self, plan: PlannedTrajectory, step: int) -> None:
        """Keep the plan made at a step, or count that it is refused."""
        try:
            x, y, yaw = self._states[step, : STATE.speed]
            self._plans.append(place_plan(plan, x, y, yaw, int(self.times[step])))
        except PlanRefused as refusal:
            self.events["plans_refused"] += 1
            if not self._plans:
                self.failure = f"the first plan was refused: {refusal}"

    def fail(self, error: Exception, step: int) -> None:
        """End the drive because the policy raised."""
        self.events["policy_errors"] += 1
        self.failure = f"the policy raised {type(error).__name__} at {self.times[step] * 1e-6:.1f} s: {error}"

    def move(self, step: int) -> None:
        """Control the vehicle and move it on by one step; the agents react to where it was before."""
        control = self._control(step)
        with self.timed("vehicle"):
            state = self._stepper(self._states[step], control)
        if self._agents is not None:
            self._agents.step(int(self.times[step]), *self._ego_box(step))
        self._driven = step + 1
        self._states[step + 1] = state
        self._heights[step + 1] = self._height_at(state)

    def _control(self, step: int) -> Array:
        """The command (2,) that follows the plan in force at a step: the newest that is older than the delay."""
        latest_us = self.times[step] - self._settings.planner_delay_us
        plan = next(plan for plan in reversed(self._plans) if plan.timestamps_us[0] <= latest_us)
        with self.timed("control"):
            control = self._controller.control(self._states[step], plan, int(self.times[step]))
        low, high = self._parameters.control_limits
        self.events["saturations"] += bool(np.any((control <= low) | (control >= high)))
        self._controls[step] = control
        return control

    def _ego_box(self, step: int) -> tuple[Array, tuple[float, float], float]:
        """Pose (3,) of the centre of the ego's box, its length and width, and the ego's speed."""
        x, y, yaw, speed = self._states[step, : STATE.steering]
        vehicle = self._scene.vehicle
        ahead = vehicle.rear_axle_to_bbox_center
        pose = np.array([x + ahead * np.cos(yaw), y + ahead * np.sin(yaw), yaw])
        return pose, (vehicle.length, vehicle.width), speed

    def _height_at(self, state: Array) -> float:
        """Height of the ground under the rig, taken from the nearest recorded pose."""
        x, y, z = self._ground.T
        return float(z[np.argmin((x - state[STATE.x]) ** 2 + (y - state[STATE.y]) ** 2)])

    @contextmanager
    def timed(self, work: str) -> Iterator[None]:
        """Add the time that the block takes to a kind of work."""
        started = time.perf_counter()
        yield
        self.add_time(work, time.perf_counter() - started)

    def add_time(self, work: str, seconds: float) -> None:
        """Add seconds to a kind of work."""
        self._timings[work] += seconds

    def rollout(self, left_out: tuple[str, ...]) -> Rollout:
        """What has been driven."""
        count = self._driven + 1
        plans = [plan.poses for plan in self._plans]
        solves, integration = self._controller.counts, self._stepper.report()
        return Rollout(
            scene=self._scene.name,
            category=self._scene.category,
            policy=self._policy.name,
            seed=self.seed,
            handover_us=int(self.times[self._settings.handover]),
            timestamps_us=self.times[:count],
            states=self._states[:count, :STATE_SIZE],
            heights=self._heights[:count],
            controls=self._controls[: count - 1],
            plan_times_us=np.array([plan.timestamps_us[0] for plan in self._plans], dtype=np.int64),
            plans=np.stack(plans) if plans else np.zeros((0, FUTURE_STEPS + 1, 3)),
            events=Events(**self.events, solves_failed=solves.failed, solves_late=solves.late),
            failure=self.failure,
            rendered_images=dict.fromkeys(self._policy.cameras, self._rendered),
            left_out=(*left_out, *map(word_omission, integration.left_out)),
            vehicle_steps=integration.taken,
            timings=dict(self._timings),
            traffic=self._settings.traffic,
            reacted=self._agents.reacted() if self._agents else (),
        )
