"""A drive through a junction with 100 road users: what is saved by leaving out what cannot matter."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.benchmarks.busy_junction import busy_junction
from olt_closed_loop.scoring.definitions import score_rollout
from olt_closed_loop.sensors.ray_casting import rig_sensors
from olt_closed_loop.simulation.closed_loop import simulate
from olt_closed_loop.simulation.policies import RouteFollowingPolicy
from olt_closed_loop.simulation.settings import SimulationSettings
from olt_generator.poses import Array, planar_pose
from olt_toolkit.bench.benchmark import Benchmark, Setting
from olt_toolkit.policy.contract import Observation, PlannedTrajectory, Policy
from olt_toolkit.rigs.contracts import find_contract
from olt_toolkit.rigs.rig import CAMERA_INDEX

AGENTS, DURATION_US = 100, 10_000_000
_SIZE = (320, 576)
_POLICY_CAMERAS = find_contract("alpamayo-r1").cameras
_INTERVAL_US = 1_000_000


class CameraPolicy:
    """Follows the route and is shown the four cameras; it stands for any policy that does not wait for its weights."""

    name = "route with cameras"
    cameras: tuple[str, ...] = _POLICY_CAMERAS
    image_size: tuple[int, int] = _SIZE

    def __init__(self) -> None:
        self._route = RouteFollowingPolicy()

    def plan(self, observation: Observation) -> PlannedTrajectory:
        """See `Policy.plan`."""
        return self._route.plan(observation)


@dataclass(frozen=True)
class Kept:
    """What is computed though it cannot matter.

    Attributes:
        cameras: pictures of the rig's cameras that the policy does not have.
        pictures: pictures between decisions.
        scoring: in scoring, agents out of reach and times at which the ego is far from the road's edge.
        looks: the looks and the renderer of a policy without cameras, with pictures of all seven.
    """

    cameras: bool = False
    pictures: bool = False
    scoring: bool = False
    looks: bool = False


@lru_cache(maxsize=1)
def _scene() -> Any:
    return busy_junction(AGENTS, DURATION_US)


def _drive(sees: bool, kept: Kept) -> str:
    """The rollout and its score as text, without times and what was left out."""
    scene = _scene()
    policy: Policy = CameraPolicy() if sees else RouteFollowingPolicy()
    settings = SimulationSettings(
        duration_us=DURATION_US, plan_interval_us=_INTERVAL_US, skip=not (kept.pictures or kept.looks)
    )
    sensors = rig_sensors(scene) if sees or kept.looks else None

    def take(cameras: tuple[str, ...], size: tuple[int, int], T_world_rig: Array, time_us: int) -> NDArray[np.uint8]:
        assert sensors is not None
        pictures = sensors(tuple(CAMERA_INDEX) if kept.cameras else cameras, size, T_world_rig, time_us)
        return pictures[[list(CAMERA_INDEX).index(name) for name in cameras]] if kept.cameras else pictures

    rollout = simulate(scene, policy, settings, renderer=take if sees else None)
    if kept.looks and sensors is not None:
        for time_us, (x, y, yaw) in zip(rollout.timestamps_us.tolist(), rollout.states[:, :3], strict=True):
            sensors(tuple(CAMERA_INDEX), _SIZE, planar_pose(x, y, yaw), time_us)
    score = score_rollout(scene, rollout, skip=not kept.scoring)
    plain = replace(rollout, timings={}, left_out=(), rendered_images={}, conditions=None).to_dict()
    return json.dumps([plain, replace(score, left_out=()).to_dict()], sort_keys=True, default=str)


_SETTINGS: dict[str, tuple[bool, Kept]] = {
    "four cameras, everything on": (True, Kept(cameras=True, pictures=True, scoring=True)),
    "four cameras, without the other three": (True, Kept(pictures=True, scoring=True)),
    "four cameras, and without pictures between decisions": (True, Kept(scoring=True)),
    "four cameras, all that cannot matter left out": (True, Kept()),
    "no cameras, everything on": (False, Kept(scoring=True, looks=True)),
    "no cameras, without looks and pictures": (False, Kept(scoring=True)),
    "no cameras, all that cannot matter left out": (False, Kept()),
}


def _prepare(sees: bool, kept: Kept) -> Callable[[], tuple[bool, str]]:
    _scene()
    return lambda: (sees, _drive(sees, kept))


@lru_cache(maxsize=2)
def _reference(sees: bool) -> str:
    name = "four cameras, everything on" if sees else "no cameras, everything on"
    return _drive(*_SETTINGS[name])


def _measure_error(result: tuple[bool, str]) -> float:
    """How many characters of rollout and score differ from those with everything on."""
    sees, text = result
    exact = _reference(sees)
    return float(sum(a != b for a, b in zip(text, exact, strict=False)) + abs(len(text) - len(exact)))


BENCHMARK = Benchmark(
    title=f"A drive of {DURATION_US * 1e-6:.0f} s past {AGENTS} road users at a junction, a plan every second, scored",
    error_name="characters of rollout and score that differ",
    error_unit="characters",
    reference="the same drive with everything on",
    settings=lambda: [
        Setting(name, partial(_prepare, sees, kept), default=kept == Kept() and sees)
        for name, (sees, kept) in _SETTINGS.items()
    ],
    measure_error=_measure_error,
)
