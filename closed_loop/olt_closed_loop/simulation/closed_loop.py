"""The closed loop: a policy drives the vehicle model through a recorded scene.

Timing is AlpaSim's (docs/formats/alpasim.md): steps of 0.1 s; the recording drives for the first 1.7 s and the
policy is not asked; then in every step the policy plans, the controller follows the plan for 0.1 s and the vehicle
moves. Agents replay the recording or, if asked, brake for the ego. Unlike AlpaSim the first driven step knows the
recorded speed, steering and acceleration, and every random choice hangs on the seed.

With a planner delay a plan is in force that long after it was asked for; the policy is first asked so much before the
hand-over that its first plan is in force then.
"""

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.rollouts.rollout import Rollout
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.simulation.policies import BatchPolicy, ObservationBatch
from olt_closed_loop.simulation.recorded_motion import recorded_motion
from olt_closed_loop.simulation.running_rollout import RolloutRequest, RunningRollout, Sensors
from olt_closed_loop.simulation.settings import SimulationSettings, step_times
from olt_closed_loop.vehicle.state import STATE
from olt_generator.poses import planar_pose
from olt_toolkit.policy.contract import FUTURE_STEPS, IMAGE_FRAMES, Observation, PlannedTrajectory, Policy
from olt_toolkit.rigs.rig import CAMERA_INDEX


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
        InputError: the recording is too short, the policy needs cameras and there is no renderer, or pictures would
            show reactive traffic where it is not.
    """
    return simulate_batch([RolloutRequest(scene, seed, renderer)], policy, settings)[0]


def simulate_batch(
    requests: Sequence[RolloutRequest], policy: Policy, settings: SimulationSettings | None = None
) -> list[Rollout]:
    """Many rollouts of one policy, in the order of the requests; each is the same as by `simulate`.

    A policy that can answer for many (`BatchPolicy`) drives all side by side, any other one after another.

    Raises:
        InputError: see `simulate`.
    """
    settings = settings or SimulationSettings()
    delay = settings.planner_delay
    first = settings.handover - delay
    finished: list[RunningRollout] = []
    for group in [requests] if isinstance(policy, BatchPolicy) else [[request] for request in requests]:
        running = [RunningRollout(request, policy, settings) for request in group]
        for step in range(first - IMAGE_FRAMES + 1, first):
            for rollout in running:
                rollout.take_pictures(step)
        for step in range(first, max(len(rollout.times) for rollout in running) - 1):
            _plan([rollout for rollout in running if rollout.runs_at(step + delay)], policy, step)
            for rollout in running if step >= settings.handover else ():
                if rollout.runs_at(step):
                    rollout.move(step)
        finished += running
    return [rollout.rollout() for rollout in finished]


def _plan(running: Sequence[RunningRollout], policy: Policy, step: int) -> None:
    """Ask the policy for all rollouts; one that makes it raise fails alone."""
    if not running:
        return
    for rollout in running:
        rollout.take_pictures(step)
    seen = _observe(running, step)
    started = time.perf_counter()
    if isinstance(policy, BatchPolicy):
        answers = _answer_batch(policy, seen)
    else:
        answers = [_answer(policy, seen.row(i), rollout.images()) for i, rollout in enumerate(running)]
    seconds = (time.perf_counter() - started) / len(running)
    for rollout, answer in zip(running, answers, strict=True):
        rollout.accept(answer, step, seconds)


def _answer(policy: Policy, seen: ObservationBatch, images: NDArray[np.uint8] | None) -> PlannedTrajectory | Exception:
    route = seen.route_xy[0]
    observation = Observation(
        images=images,
        camera_indices=np.array([CAMERA_INDEX[camera] for camera in policy.cameras], dtype=np.int64),
        history_xyz=seen.history_xyz[0],
        history_rotation=seen.history_rotation[0],
        route_xy=route[~np.isnan(route[:, 0])],
        time_us=int(seen.time_us[0]),
        seed=int(seen.seeds[0]),
    )
    try:
        return policy.plan(observation)
    except Exception as error:  # whatever a foreign policy raises ends its own rollout and no other
        return error


def _answer_batch(policy: BatchPolicy, seen: ObservationBatch) -> list[PlannedTrajectory | Exception]:
    try:
        plans = policy.plan_batch(seen)
        return [PlannedTrajectory(xyz, rotation) for xyz, rotation in zip(plans.xyz, plans.rotation, strict=True)]
    except Exception as error:
        if len(seen.seeds) == 1:
            return [error]
        return [_answer_batch(policy, seen.row(index))[0] for index in range(len(seen.seeds))]


def _observe(running: Sequence[RunningRollout], step: int) -> ObservationBatch:
    """What the policy sees at a step; the rig stands upright, so its frame is turned about z alone."""
    poses = np.stack([rollout.past_poses(step) for rollout in running])
    offset = poses[..., :3] - poses[:, -1:, :3]
    yaw = poses[:, -1:, 3]
    cos, sin = np.cos(yaw), np.sin(yaw)
    ahead = cos * offset[..., 0] + sin * offset[..., 1]
    left = cos * offset[..., 1] - sin * offset[..., 0]
    return ObservationBatch(
        history_xyz=np.stack([ahead, left, offset[..., 2]], axis=-1),
        history_rotation=planar_pose(0.0, 0.0, poses[..., 3] - yaw)[..., :3, :3],
        route_xy=np.stack([rollout.route_ahead(step) for rollout in running]),
        time_us=np.array([rollout.times[step] for rollout in running], dtype=np.int64),
        seeds=np.array([rollout.seed_at(step) for rollout in running], dtype=np.int64),
    )


def replay(scene: Scene, settings: SimulationSettings | None = None) -> Rollout:
    """The rollout of an ego that is where the recording says at every step, with no policy and no vehicle."""
    settings = settings or SimulationSettings()
    times = step_times(scene, settings)
    states, heights = recorded_motion(scene, times)
    return Rollout(
        scene=scene.name,
        category=scene.category,
        policy="replay",
        seed=0,
        handover_us=int(times[0]) + settings.warm_up_us,
        timestamps_us=times,
        states=states,
        heights=heights,
        controls=np.full((len(times) - 1, 2), np.nan),
        plan_times_us=np.zeros(0, dtype=np.int64),
        plans=np.zeros((0, FUTURE_STEPS + 1, 3)),
    )


def stand(scene: Scene, settings: SimulationSettings | None = None) -> Rollout:
    """The rollout of an ego that stands from the hand-over on."""
    rollout = replay(scene, settings)
    first = (settings or SimulationSettings()).handover
    rollout.states[first:] = rollout.states[first]
    rollout.states[first:, STATE.speed :] = 0.0
    rollout.heights[first:] = rollout.heights[first]
    return replace(rollout, policy="stand")
