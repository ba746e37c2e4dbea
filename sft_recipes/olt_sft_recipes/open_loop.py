"""A policy judged on recorded samples, without driving."""

from collections.abc import Iterable

import numpy as np

from olt_sft_recipes.metrics import corner_distance, displacement_errors
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.policy.contract import Observation, Policy
from olt_toolkit.policy.sample import PolicySample, SampleKey


def evaluate_open_loop(
    policy: Policy, samples: Iterable[PolicySample], plans_per_sample: int = 1, seed: int = 0
) -> dict[str, float]:
    """Errors in metres (`olt_sft_recipes.metrics`), averaged over samples, of which there is at least one.

    Args:
        policy: what is judged.
        samples: recorded samples.
        plans_per_sample: plans drawn for each.
        seed: seed of the first plan of each; the next has the next number.
    """
    errors = [_errors(policy, sample, plans_per_sample, seed) for sample in samples]
    return {name: float(np.mean([error[name] for error in errors])) for name in errors[0]}


def spread_keys(store: ClipStore, split: str, samples: int) -> list[SampleKey]:
    """Keys of up to `samples` samples of every clip of the split, spread over each clip's time."""
    return [
        SampleKey(str(store.root), info.clip_id, info.sample_t0_us[index])
        for info in store.clips()
        if info.split == split and info.sample_t0_us
        for index in np.unique(np.linspace(0, len(info.sample_t0_us) - 1, samples).round().astype(int))
    ]


def _errors(policy: Policy, sample: PolicySample, plans: int, seed: int) -> dict[str, float]:
    drawn = [policy.plan(_observe(sample, seed + index)) for index in range(plans)]
    xyz, rotation = np.stack([plan.xyz for plan in drawn]), np.stack([plan.rotation for plan in drawn])
    true_xyz = sample.ego_future_xyz[0].astype(np.float64)
    true_rotation = sample.ego_future_rot[0].astype(np.float64)
    corners = corner_distance(xyz, rotation, true_xyz, true_rotation)
    return displacement_errors(xyz, true_xyz) | {"corner_distance": corners}


def _observe(sample: PolicySample, seed: int) -> Observation:
    return Observation(
        images=sample.image_frames,
        camera_indices=sample.camera_indices,
        history_xyz=sample.ego_history_xyz[0].astype(np.float64),
        history_rotation=sample.ego_history_rot[0].astype(np.float64),
        route_xy=np.zeros((0, 2)),
        time_us=sample.t0_us,
        seed=seed,
    )
