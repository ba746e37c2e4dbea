"""The closed loop: a policy drives the vehicle model through a recorded scene.

Timing is AlpaSim's (docs/formats/alpasim.md): steps of 0.1 s; the recording drives for the first 1.7 s and the
policy is not asked; then in every step the policy plans, the controller follows the plan for 0.1 s and the vehicle
moves. Agents replay the recording or, if asked, brake for the ego. Unlike AlpaSim the first driven step knows the
recorded speed, steering and acceleration, and every random choice hangs on the seed.

With a planner delay a plan is in force that long after it was asked for; the policy is first asked so much before the
hand-over that its first plan is in force then.
"""

import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.rollouts.rollout import Rollout
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.simulation.answers import Answer, PolicyFault
from olt_closed_loop.simulation.policies import ObservationBatch
from olt_closed_loop.simulation.policy_hosts import PolicyHost, PolicySource
from olt_closed_loop.simulation.policy_process import host_policy
from olt_closed_loop.simulation.recorded_motion import recorded_motion
from olt_closed_loop.simulation.running_rollout import RolloutRequest, RunningRollout, Sensors
from olt_closed_loop.simulation.settings import SimulationSettings, step_times
from olt_closed_loop.vehicle.state import STATE
from olt_generator.poses import planar_pose
from olt_toolkit.policy.contract import FUTURE_STEPS, IMAGE_FRAMES, Observation
from olt_toolkit.rigs.rig import CAMERA_INDEX


def simulate(
    scene: Scene,
    policy: PolicySource,
    settings: SimulationSettings | None = None,
    seed: int = 0,
    renderer: Sensors | None = None,
) -> Rollout:
    """Let the policy drive the scene; a policy object drives itself, after its `reset` where it has one.

    What a policy does wrong ends the rollout, which is marked as failed with the event and the reason and has no score:
    raising, exiting, dying, taking too long, answering with something else than plans, changing what it was shown or
    global states, a first plan that is refused, and too many refused ones later (`PolicyLimits`). Other plans that are
    refused are counted and the last feasible plan is held. In this process, unless the limits say otherwise.

    Raises:
        InputError: the recording is too short, the policy does not keep the contract, it needs cameras and there is no
            renderer, or pictures would show reactive traffic where it is not.
        PolicyNotStarted: the policy's own process could not build it.
    """
    settings = settings or SimulationSettings()
    with closing(host_policy(policy, settings.limits, borrowed=True)) as host:
        return next(drive([RolloutRequest(scene, seed, renderer)], host, settings))


def simulate_batch(
    requests: Sequence[RolloutRequest], policy: PolicySource, settings: SimulationSettings | None = None
) -> list[Rollout]:
    """Many rollouts of one policy, in the order of the requests; each is the same as by `simulate` from a fresh policy.

    A policy that can answer for many (`BatchPolicy`) drives all side by side, any other one after another, each from
    the same state (`simulation.policy_hosts`).

    Raises:
        InputError: see `simulate`.
        PolicyNotStarted: see `simulate`.
    """
    settings = settings or SimulationSettings()
    with closing(host_policy(policy, settings.limits)) as host:
        return list(drive(requests, host, settings))


def drive(requests: Sequence[RolloutRequest], host: PolicyHost, settings: SimulationSettings) -> Iterator[Rollout]:
    """The rollouts of the requests in their order, each as soon as it has ended.

    Raises:
        InputError: see `simulate`.
    """
    for group in [requests] if host.traits.answers_batches else [[request] for request in requests]:
        running = [RunningRollout(request, host.traits, settings) for request in group]
        for rollout, request in zip(running, group, strict=True):
            rollout.begin(host.begin(request.seed, request.scene.name))
        _run_in_step(running, host, settings)
        yield from (rollout.rollout() for rollout in running)


def _run_in_step(running: Sequence[RunningRollout], host: PolicyHost, settings: SimulationSettings) -> None:
    delay = settings.planner_delay
    first = settings.handover - delay
    for step in range(first - IMAGE_FRAMES + 1, first):
        for rollout in running:
            rollout.take_pictures(step)
    for step in range(first, max(len(rollout.times) for rollout in running) - 1):
        going = [rollout for rollout in running if rollout.runs_at(step + delay)]
        until_asked = (first - step) % settings.plan_interval
        if until_asked == 0:
            _plan(going, host, step)
        for rollout in going if until_asked else ():
            # Pictures that no plan is made from are not taken; faults of cameras remember them all.
            if until_asked < IMAGE_FRAMES or settings.camera_faults or not settings.skip:
                rollout.take_pictures(step)
            else:
                rollout.leave_out_pictures()
        for rollout in running if step >= settings.handover else ():
            if rollout.runs_at(step):
                rollout.move(step)


def _plan(running: Sequence[RunningRollout], host: PolicyHost, step: int) -> None:
    """Ask the policy for all rollouts; one that makes it fail fails alone."""
    if not running:
        return
    for rollout in running:
        rollout.take_pictures(step)
    seen = _observe(running, step)
    started = time.perf_counter()
    if host.traits.answers_batches:
        answers = _answer_batch(host, seen)
    else:
        answers = [host.plan(_observation(host, seen.row(i), rollout.images())) for i, rollout in enumerate(running)]
    seconds = (time.perf_counter() - started) / len(running)
    for rollout, answer in zip(running, answers, strict=True):
        rollout.accept(answer, step, seconds)


def _observation(host: PolicyHost, seen: ObservationBatch, images: NDArray[np.uint8] | None) -> Observation:
    route = seen.route_xy[0]
    return Observation(
        images=images,
        camera_indices=np.array([CAMERA_INDEX[camera] for camera in host.traits.cameras], dtype=np.int64),
        history_xyz=seen.history_xyz[0],
        history_rotation=seen.history_rotation[0],
        route_xy=route[~np.isnan(route[:, 0])],
        time_us=int(seen.time_us[0]),
        seed=int(seen.seeds[0]),
    )


def _answer_batch(host: PolicyHost, seen: ObservationBatch) -> list[Answer]:
    """Answers to all rows. After a fault each row is asked alone, so that it meets only those that bring it about."""
    answers = host.plan_batch(seen)
    if len(answers) == 1 or not any(isinstance(answer, PolicyFault) for answer in answers):
        return answers
    return [host.plan_batch(seen.row(index))[0] for index in range(len(answers))]


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
