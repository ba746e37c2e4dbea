"""Numbers of 64, 32 and 16 bits: in the poses that labels are made of, and in driving actions out."""

from collections.abc import Callable, Sequence
from functools import lru_cache, partial

import numpy as np

from olt_generator.poses import Array
from olt_sft_recipes.benchmarks.motions import Motions, by_horizon, distances, drawn_motions
from olt_sft_recipes.benchmarks.tokens import fit
from olt_toolkit.bench.benchmark import Benchmark, Setting, list_settings
from olt_toolkit.policy.action_space import (
    ACTION_MEAN,
    ACTION_STD,
    actions_to_trajectory,
    estimate_initial_speed,
    trajectory_to_actions,
)
from olt_toolkit.policy.contract import STEP_SECONDS

COUNT = 256


@lru_cache(maxsize=1)
def _fitted() -> tuple[Motions, Array, Array]:
    motions = drawn_motions(COUNT)
    return motions, *fit(motions)


def cast(values: Array, kind: str) -> Array:
    """Values as numbers of that type of torch keep them, as float64 again."""
    import torch

    return torch.from_numpy(np.ascontiguousarray(values)).to(getattr(torch, kind)).double().numpy()


def from_poses(kind: str) -> Array:
    """Trajectories (n, 64, 3) of labels that were made of poses of that type, as a cast of the inputs would."""
    history_xyz, history_rotation, xyz, rotation = (cast(part, kind) for part in _fitted()[0].poses())
    actions = trajectory_to_actions(history_xyz, history_rotation, xyz, rotation)
    return actions_to_trajectory(actions, estimate_initial_speed(history_xyz, history_rotation))[0]


def from_actions(kind: str) -> Array:
    """Trajectories (n, 64, 3) of actions of that type, driven out in float64."""
    _, actions, speed = _fitted()
    return actions_to_trajectory(cast(actions, kind), cast(speed, kind))[0]


def driven_out(kind: str) -> Array:
    """Trajectories (n, 64, 3) of actions that are driven out in that type, every sum of it."""
    import torch

    _, actions, speed = _fitted()
    dtype = getattr(torch, kind)
    physical = torch.from_numpy(actions * ACTION_STD + ACTION_MEAN).to(dtype)
    v, x, y, yaw = torch.from_numpy(np.asarray(speed)).to(dtype), *torch.zeros(3, len(actions), dtype=dtype)
    places = []
    for acceleration, curvature in (step.unbind(-1) for step in physical.unbind(1)):
        faster = v + acceleration * STEP_SECONDS
        turned = yaw + curvature * (v * STEP_SECONDS + 0.5 * acceleration * STEP_SECONDS**2)
        x = x + 0.5 * STEP_SECONDS * (v * yaw.cos() + faster * turned.cos())
        y = y + 0.5 * STEP_SECONDS * (v * yaw.sin() + faster * turned.sin())
        v, yaw = faster, turned
        places.append(torch.stack([x, y, torch.zeros_like(x)], dim=-1))
    return torch.stack(places, dim=1).double().numpy()


def _settings() -> Sequence[Setting]:
    calls: dict[str, Callable[[], Array]] = {"all in float64": partial(from_actions, "float64")}
    for kind in ("float32", "float16", "bfloat16"):
        calls[f"labels of {kind} poses"] = partial(from_poses, kind)
        calls[f"{kind} actions"] = partial(from_actions, kind)
        calls[f"driven out in {kind}"] = partial(driven_out, kind)
    return list_settings(_fitted, calls, "all in float64")


BENCHMARK = Benchmark(
    title=f"{COUNT} drawn motions of 6.4 s in numbers of 64, 32 and 16 bits",
    error_name="mean distance",
    error_unit="m",
    reference="the motions, integrated from speed and curvature in steps of 1 ms",
    settings=_settings,
    measure_error=lambda driven: float(distances(driven, _fitted()[0]).mean()),
    figures=lambda driven: by_horizon(distances(driven, _fitted()[0])),
)
