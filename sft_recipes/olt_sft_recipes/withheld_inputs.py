"""What a policy makes of each of its inputs: how much farther off its plans are where one of them is withheld.

The policy is not trained again, so what is told is what this policy relies on. An input without which another could
have learned as well shows here all the same.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from olt_closed_loop.evaluation.score_table import Interval, bootstrap_interval
from olt_generator.poses import Array
from olt_sft_recipes.open_loop import measure_open_loop
from olt_toolkit import Policy, PolicySample
from olt_toolkit.rigs.rig import CAMERA_INDEX

Withholding = Callable[[PolicySample], PolicySample]
_CAMERA_NAMES = {index: name for name, index in CAMERA_INDEX.items()}


@dataclass(frozen=True)
class WithheldInput:
    """The errors of a policy without one of its inputs.

    Attributes:
        name: what is withheld.
        min_ade: metres, over all samples.
        increase: min_ade less that with all inputs, metres.
        increase_interval: its 95 % interval, by drawing clips anew; None where they do not tell.
    """

    name: str
    min_ade: float
    increase: float
    increase_interval: Interval | None


def measure_withheld(
    policy: Policy, samples: Sequence[PolicySample], measured: Sequence[dict[str, float]], plans_per_sample: int = 1
) -> tuple[WithheldInput, ...]:
    """Judge a policy on the same samples and seeds without each input that they have, one at a time.

    Args:
        measured: errors with all inputs (`measure_open_loop`) of as many plans.
    """
    whole = _min_ades(measured)
    clips = np.unique([sample.clip_id for sample in samples], return_inverse=True)[1]
    found = []
    for name, withhold in list_withholdings(samples):
        without = [withhold(sample) for sample in samples]
        errors = _min_ades(measure_open_loop(policy, without, plans_per_sample))
        sums = [np.bincount(clips, weights) for weights in (errors - whole, np.ones(len(clips)))]
        by_clip = np.stack(sums, axis=-1).astype(np.float64)
        interval = bootstrap_interval(by_clip, "withheld", name)
        found.append(WithheldInput(name, float(errors.mean()), float((errors - whole).mean()), interval))
    return tuple(found)


def list_withholdings(samples: Sequence[PolicySample]) -> Iterator[tuple[str, Withholding]]:
    """What can be withheld of these samples, by name: each camera, all of them, earlier frames, the route."""
    cameras = samples[0].camera_indices.tolist()
    for place, index in enumerate(cameras):
        yield f"{_CAMERA_NAMES[index]} black", lambda sample, place=place: _blackened(sample, [place])
    yield "all cameras black", lambda sample: _blackened(sample, range(len(cameras)))
    yield "earlier frames as the last", _standing_still
    if any(sample.route_xy is not None for sample in samples):
        yield "no route", lambda sample: replace(sample, route_xy=None)


def _min_ades(measured: Sequence[dict[str, float]]) -> Array:
    return np.array([errors["min_ade"] for errors in measured])


def _blackened(sample: PolicySample, places: Sequence[int]) -> PolicySample:
    images = sample.image_frames.copy()
    images[list(places)] = 0
    return replace(sample, image_frames=images)


def _standing_still(sample: PolicySample) -> PolicySample:
    return replace(sample, image_frames=np.repeat(sample.image_frames[:, -1:], sample.image_frames.shape[1], axis=1))
