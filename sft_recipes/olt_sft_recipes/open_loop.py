"""A policy judged on recorded samples, without driving (metrics of docs/formats/alpamayo.md)."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from olt_generator.poses import Array
from olt_toolkit import ClipStore, Observation, Policy, PolicySample, SampleKey
from olt_toolkit.policy.contract import STEP_SECONDS, Resettable

HORIZONS_SECONDS = (0.5, 1.0, 3.0, 5.0)
# Length, width and height in metres of the box whose corners are compared; it is centred on the trajectory.
_BOX = np.array([4.0, 3.0, 2.0])
_CORNERS = 0.5 * _BOX * np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij"), axis=-1).reshape(8, 3)


def evaluate_open_loop(
    policy: Policy, samples: Iterable[PolicySample], plans_per_sample: int = 1, seed: int = 0
) -> dict[str, float]:
    """Errors in metres (`displacement_errors`, `corner_distance`), averaged over one or more samples.

    Args:
        policy: what is judged.
        samples: recorded samples.
        plans_per_sample: planned trajectories drawn for each.
        seed: seed of the first of each; the next has the next number.
    """
    return mean_errors(measure_open_loop(policy, samples, plans_per_sample, seed))


def mean_errors(errors: Sequence[dict[str, float]]) -> dict[str, float]:
    """The mean of each error over one or more samples."""
    return {name: float(np.mean([error[name] for error in errors])) for name in errors[0]}


def measure_open_loop(
    policy: Policy, samples: Iterable[PolicySample], plans_per_sample: int = 1, seed: int = 0
) -> list[dict[str, float]]:
    """The errors of `evaluate_open_loop` of each sample by itself; what was asked before it is forgotten."""
    errors = []
    for sample in samples:
        if isinstance(policy, Resettable):
            policy.reset(seed, "")
        observation = observe(sample, seed)
        plans = [policy.plan(replace(observation, seed=seed + index)) for index in range(plans_per_sample)]
        xyz, rotation = np.stack([plan.xyz for plan in plans]), np.stack([plan.rotation for plan in plans])
        true_xyz = sample.ego_future_xyz[0].astype(np.float64)
        true_rotation = sample.ego_future_rot[0].astype(np.float64)
        corners = corner_distance(xyz, rotation, true_xyz, true_rotation)
        errors.append(displacement_errors(xyz, true_xyz) | {"corner_distance": corners})
    return errors


def observe(sample: PolicySample, seed: int = 0) -> Observation:
    """What a policy is shown of a sample."""
    return Observation(
        images=sample.image_frames,
        camera_indices=sample.camera_indices,
        history_xyz=sample.ego_history_xyz[0].astype(np.float64),
        history_rotation=sample.ego_history_rot[0].astype(np.float64),
        route_xy=np.zeros((0, 2)) if sample.route_xy is None else sample.route_xy.astype(np.float64),
        time_us=sample.t0_us,
        seed=seed,
    )


def spread_keys(store: ClipStore, split: str, samples: int) -> list[SampleKey]:
    """Keys of up to `samples` samples of every clip of the split, spread over each clip's time."""
    return [
        SampleKey(str(store.root), info.clip_id, info.sample_t0_us[index])
        for info in store.clips()
        if info.split == split and info.sample_t0_us
        for index in np.unique(np.linspace(0, len(info.sample_t0_us) - 1, samples).round().astype(int))
    ]


def displacement_errors(predicted_xyz: Array, true_xyz: Array) -> dict[str, float]:
    """Errors of K predictions of one future, in metres, in the plane.

    `min_ade` is the mean over the horizon of the prediction whose mean is smallest, and `min_ade/by_t=h` the mean over
    its first h seconds; `ade` and `ade/by_t=3.0` are those of the first prediction.

    Args:
        predicted_xyz: (K, T, 3) metres in the rig frame at t0.
        true_xyz: (T, 3).
    """
    displacement = np.linalg.norm(predicted_xyz[..., :2] - true_xyz[..., :2], axis=-1)
    first, best = displacement[0], displacement[np.argmin(displacement.mean(axis=-1))]
    errors = {"min_ade": best.mean(), "ade": first.mean(), "ade/by_t=3.0": first[: round(3.0 / STEP_SECONDS)].mean()}
    errors |= {f"min_ade/by_t={seconds}": best[: round(seconds / STEP_SECONDS)].mean() for seconds in HORIZONS_SECONDS}
    return {name: float(value) for name, value in errors.items()}


def corner_distance(predicted_xyz: Array, predicted_rotation: Array, true_xyz: Array, true_rotation: Array) -> float:
    """Mean distance in metres between the corners of a box that follows the prediction and one that follows the truth.

    The smallest of the K predictions is taken for every step and corner by itself.

    Args:
        predicted_xyz: (K, T, 3) metres in the rig frame at t0.
        predicted_rotation: (K, T, 3, 3).
        true_xyz: (T, 3).
        true_rotation: (T, 3, 3).
    """
    predicted = _place_box(predicted_xyz, predicted_rotation)
    true = _place_box(true_xyz, true_rotation)
    return float(np.linalg.norm(predicted - true, axis=-1).min(axis=0).mean())


def _place_box(xyz: Array, rotation: Array) -> Array:
    """Corners (..., T, 8, 3) of the box at every pose."""
    return xyz[..., None, :] + _CORNERS @ np.swapaxes(rotation, -1, -2)
