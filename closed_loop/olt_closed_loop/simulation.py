"""The closed loop: a policy drives the vehicle model through a recorded scene.

Timing is AlpaSim's (facts sheet alpasim, section 3): steps of 0.1 s; the recording drives for the first 1.7 s and the
policy is not asked; then in every step the policy plans, the controller follows the plan for 0.1 s and the vehicle
moves. Agents replay the recording. Unlike AlpaSim the first driven step knows the recorded speed, steering and
acceleration, and every random choice hangs on the seed.
"""

import time
from collections import Counter, defaultdict, deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.control import ControlSettings, TrackingController
from olt_closed_loop.integrators import DEFAULT_METHOD, DEFAULT_SUBSTEPS, Method, make_stepper
from olt_closed_loop.plans import PlanRefused, WorldPlan, place_plan
from olt_closed_loop.progress import PathTracker
from olt_closed_loop.recorded_motion import RecordedMotion, recorded_motion
from olt_closed_loop.rollout import Events, Rollout
from olt_closed_loop.scene import Scene
from olt_closed_loop.vehicle import STATE, VehicleParameters
from olt_generator.errors import InputError
from olt_generator.poses import Array, invert, planar_pose
from olt_generator.seeds import derive_seed
from olt_toolkit.policy import FUTURE_STEPS, HISTORY_STEPS, IMAGE_FRAMES, STEP_SECONDS, STEP_US, Observation, Policy
from olt_toolkit.rig import CAMERA_INDEX

ROUTE_POINTS = 20
ROUTE_LENGTH = 80.0
"""Number of points and metres of the route that a policy is shown (facts sheet alpasim, section 6)."""
_ROUTE_DISTANCES: Array = np.linspace(0.0, ROUTE_LENGTH, ROUTE_POINTS)


class Sensors(Protocol):
    """What takes the pictures."""

    def render_rig(
        self, cameras: tuple[str, ...], size: tuple[int, int], T_world_rig: Array, time_us: int
    ) -> NDArray[np.uint8]:
        """Images (cameras, 3, H, W) of the named cameras on the rig at `T_world_rig`; `size` is (H, W)."""
        ...


@dataclass(frozen=True)
class SimulationSettings:
    """How a scene is driven.

    Attributes:
        warm_up_us: how long the recording drives, a multiple of 0.1 s and at least the 0.3 s that the pictures of the
            first plan reach back.
        duration_us: how long the rollout lasts, warm-up included; it ends earlier where the recording does.
        method, substeps: integrator of the vehicle (`olt_closed_loop.integrators`).
        control: how plans are tracked.
    """

    warm_up_us: int = 1_700_000
    duration_us: int = 20_000_000
    method: Method = DEFAULT_METHOD
    substeps: int = DEFAULT_SUBSTEPS
    control: ControlSettings = field(default_factory=ControlSettings)

    def __post_init__(self) -> None:
        if self.warm_up_us % STEP_US or self.warm_up_us < (IMAGE_FRAMES - 1) * STEP_US:
            raise InputError(f"warm-up of {self.warm_up_us} us: give a multiple of 100000 us, 300000 us or more")


def simulate(
    scene: Scene,
    policy: Policy,
    settings: SimulationSettings | None = None,
    seed: int = 0,
    renderer: Sensors | None = None,
) -> Rollout:
    """Let the policy drive the scene.

    A policy that raises, or whose very first plan is refused, ends the rollout: it is marked as failed with the
    reason and has no score. Later plans that are refused are counted and the last feasible plan is held.

    Raises:
        InputError: the recording is too short, or the policy needs cameras and there is no renderer.
    """
    settings = settings or SimulationSettings()
    if policy.cameras and renderer is None:
        raise InputError(f"policy {policy.name} needs cameras ({', '.join(policy.cameras)}); give a renderer")
    return _Drive(scene, policy, settings, seed, renderer).run()


def step_times(scene: Scene, settings: SimulationSettings) -> NDArray[np.int64]:
    """Times (n,) of the rollout's states, microseconds.

    Raises:
        InputError: the recording ends before the policy could drive one step.
    """
    start, end = int(scene.ego.timestamps_us[0]), int(scene.ego.timestamps_us[-1])
    steps = min(settings.duration_us, end - start) // STEP_US
    if steps * STEP_US <= settings.warm_up_us:
        raise InputError(
            f"scene {scene.name}: a drive of {steps * STEP_US * 1e-6:.1f} s leaves nothing after the warm-up of "
            f"{settings.warm_up_us * 1e-6:.1f} s; give a longer recording or duration"
        )
    return start + STEP_US * np.arange(steps + 1, dtype=np.int64)


class _Drive:
    """The state of one rollout while it runs."""

    def __init__(
        self, scene: Scene, policy: Policy, settings: SimulationSettings, seed: int, renderer: Sensors | None
    ) -> None:
        parameters = VehicleParameters.from_dimensions(scene.vehicle)
        self._scene, self._policy, self._seed, self._renderer = scene, policy, seed, renderer
        self._stepper = make_stepper(parameters, settings.method, settings.substeps, STEP_SECONDS)
        self._controller = TrackingController(parameters, settings.control)
        self._limits = parameters.control_limits
        self._times = step_times(scene, settings)
        self._first = settings.warm_up_us // STEP_US
        recorded = recorded_motion(scene, self._times[: self._first + 1])
        self._states, self._heights = list(recorded.states), list(recorded.heights)
        x, y, yaw = recorded.states[:, : STATE.speed].T
        self._poses = list(planar_pose(x, y, yaw, recorded.heights))
        self._controls = [np.full(2, np.nan)] * self._first
        self._plans: list[WorldPlan] = []
        self._frames: deque[NDArray[np.uint8]] = deque(maxlen=IMAGE_FRAMES)
        self._route = PathTracker(scene.route[:, :2]) if len(scene.route) else None
        self._events: Counter[str] = Counter()
        self._timings: defaultdict[str, float] = defaultdict(float)
        self._rendered = 0

    def run(self) -> Rollout:
        if self._route:
            self._route.start_at(self._states[self._first][: STATE.yaw])
        for index in range(self._first - IMAGE_FRAMES + 1, self._first):
            self._take_pictures(index)
        failure = None
        for index in range(self._first, len(self._times) - 1):
            self._take_pictures(index)
            failure = self._plan(index)
            if failure:
                break
            self._move(index)
        return self._rollout(failure)

    def _plan(self, index: int) -> str | None:
        """Ask the policy; returns why the rollout cannot go on, or None."""
        observation = self._observe(index)
        try:
            with self._timed("policy"):
                plan = self._policy.plan(observation)
            x, y, yaw = self._states[index][: STATE.speed]
            self._plans.append(place_plan(plan, x, y, yaw, int(self._times[index])))
        except PlanRefused as refusal:
            self._events["plans_refused"] += 1
            if not self._plans:
                return f"the first plan was refused: {refusal}"
        except Exception as error:  # whatever a foreign policy raises ends its own rollout and no other
            self._events["policy_errors"] += 1
            return f"the policy raised {type(error).__name__} at {self._times[index] * 1e-6:.1f} s: {error}"
        return None

    def _move(self, index: int) -> None:
        state = self._states[index]
        with self._timed("control"):
            control = self._controller.control(state, self._plans[-1], int(self._times[index]))
        self._events["saturations"] += bool(np.any((control <= self._limits[0]) | (control >= self._limits[1])))
        with self._timed("vehicle"):
            state = self._stepper(state, control)
        height = self._height_at(state)
        x, y, yaw = state[: STATE.speed]
        self._states.append(state)
        self._controls.append(control)
        self._heights.append(height)
        self._poses.append(planar_pose(x, y, yaw, height))

    def _observe(self, index: int) -> Observation:
        T_world_rig = self._poses[index]
        history = invert(T_world_rig) @ np.stack([self._pose(index - k) for k in reversed(range(HISTORY_STEPS))])
        return Observation(
            images=np.stack(self._frames, axis=1) if self._policy.cameras else None,
            camera_indices=np.array([CAMERA_INDEX[camera] for camera in self._policy.cameras], dtype=np.int64),
            history_xyz=history[:, :3, 3],
            history_rotation=history[:, :3, :3],
            route_xy=self._route_ahead(T_world_rig),
            time_us=int(self._times[index]),
            seed=derive_seed(self._seed, self._scene.name, index),
        )

    def _pose(self, index: int) -> Array:
        """The rig's pose; before the recording starts it is taken to have come straight at its first velocity."""
        if index >= 0:
            return self._poses[index]
        pose = self._poses[0].copy()
        pose[:3, 3] += index * STEP_SECONDS * self._states[0][STATE.speed] * pose[:3, 0]
        return pose

    def _route_ahead(self, T_world_rig: Array) -> Array:
        if self._route is None:
            return np.zeros((0, 2))
        self._route.advance(T_world_rig[:2, 3])
        ahead = self._route.points_ahead(_ROUTE_DISTANCES)
        return (ahead - T_world_rig[:2, 3]) @ T_world_rig[:2, :2]

    def _take_pictures(self, index: int) -> None:
        """Render the policy's cameras once; the picture serves this step and the next three."""
        if self._renderer is None or not self._policy.cameras:
            return
        with self._timed("rendering"):
            pictures = self._renderer.render_rig(
                self._policy.cameras, self._policy.image_size, self._poses[index], int(self._times[index])
            )
        self._frames.append(pictures)
        self._rendered += 1

    def _height_at(self, state: Array) -> float:
        """Height of the ground under the rig, taken from the nearest recorded pose."""
        positions = self._scene.ego.positions
        nearest = np.argmin(np.square(positions[:, :2] - state[: STATE.yaw]).sum(axis=1))
        return float(positions[nearest, 2])

    @contextmanager
    def _timed(self, work: str) -> Iterator[None]:
        started = time.perf_counter()
        yield
        self._timings[work] += time.perf_counter() - started

    def _rollout(self, failure: str | None) -> Rollout:
        count = len(self._states)
        plans = [plan.poses for plan in self._plans]
        return Rollout(
            scene=self._scene.name,
            category=self._scene.category,
            policy=self._policy.name,
            seed=self._seed,
            handover_us=int(self._times[self._first]),
            timestamps_us=self._times[:count],
            states=np.stack(self._states),
            heights=np.array(self._heights),
            controls=np.stack(self._controls),
            plan_times_us=np.array([plan.timestamps_us[0] for plan in self._plans], dtype=np.int64),
            plans=np.stack(plans) if plans else np.zeros((0, FUTURE_STEPS + 1, 3)),
            events=Events(**self._events),
            failure=failure,
            rendered_images=dict.fromkeys(self._policy.cameras, self._rendered),
            left_out=_cameras_left_out(self._policy),
            timings=dict(self._timings),
        )


def _cameras_left_out(policy: Policy) -> tuple[str, ...]:
    unused = [camera for camera in CAMERA_INDEX if camera not in policy.cameras]
    if not unused:
        return ()
    return (f"rendering of {', '.join(unused)}: policy {policy.name} does not look at them",)


def replay(scene: Scene, settings: SimulationSettings | None = None) -> Rollout:
    """The rollout of an ego that is where the recording says at every step, with no policy and no vehicle."""
    times = step_times(scene, settings or SimulationSettings())
    return _given_motion(scene, "replay", settings or SimulationSettings(), recorded_motion(scene, times))


def stand(scene: Scene, settings: SimulationSettings | None = None) -> Rollout:
    """The rollout of an ego that stands from the hand-over on."""
    settings = settings or SimulationSettings()
    times = step_times(scene, settings)
    recorded = recorded_motion(scene, times)
    first = settings.warm_up_us // STEP_US
    recorded.states[first:] = recorded.states[first]
    recorded.states[first:, STATE.speed :] = 0.0
    recorded.heights[first:] = recorded.heights[first]
    return _given_motion(scene, "stand", settings, recorded)


def _given_motion(scene: Scene, name: str, settings: SimulationSettings, motion: RecordedMotion) -> Rollout:
    times = step_times(scene, settings)
    return Rollout(
        scene=scene.name,
        category=scene.category,
        policy=name,
        seed=0,
        handover_us=int(times[0]) + settings.warm_up_us,
        timestamps_us=times,
        states=motion.states,
        heights=motion.heights,
        controls=np.full((len(times) - 1, 2), np.nan),
        plan_times_us=np.zeros(0, dtype=np.int64),
        plans=np.zeros((0, FUTURE_STEPS + 1, 3)),
    )
