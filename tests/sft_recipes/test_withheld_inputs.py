"""What is withheld raises the error of a policy that relies on it, and of no other."""

import numpy as np
import pytest

from olt_sft_recipes.open_loop import measure_open_loop
from olt_sft_recipes.withheld_inputs import measure_withheld
from olt_toolkit import PolicySample
from olt_toolkit.policy.contract import PlannedTrajectory
from olt_toolkit.rigs.rig import CAMERA_INDEX, CROSS_LEFT, FRONT_WIDE

TIMES = 0.1 * np.arange(1, 65)


def straight(speed):
    xyz = np.stack([speed * TIMES, np.zeros(64), np.zeros(64)], axis=-1)
    return xyz, np.tile(np.eye(3), (64, 1, 1))


def sample_at(speed, clip, with_route=True):
    """The front camera's last frame is as bright as the sample is fast; its first as twice that; so is the route."""
    images = np.full((2, 4, 3, 2, 2), 9, np.uint8)
    images[1, 3], images[1, 0] = speed, 2 * speed
    xyz, rotation = straight(speed)
    none = np.zeros((2, 4))
    return PolicySample(
        image_frames=images,
        camera_indices=np.array([CAMERA_INDEX[CROSS_LEFT], CAMERA_INDEX[FRONT_WIDE]]),
        ego_history_xyz=np.zeros((1, 16, 3), np.float32),
        ego_history_rot=np.tile(np.eye(3, dtype=np.float32), (1, 16, 1, 1)),
        ego_future_xyz=xyz[None].astype(np.float32),
        ego_future_rot=rotation[None].astype(np.float32),
        relative_timestamps=none.astype(np.float32),
        absolute_timestamps=none.astype(np.int64),
        t0_us=0,
        clip_id=clip,
        route_xy=np.full((20, 2), float(speed), np.float32) if with_route else None,
    )


class Reader:
    """Drives as fast as what it looks at says."""

    name, cameras, image_size = "reader", (CROSS_LEFT, FRONT_WIDE), (2, 2)

    def __init__(self, read):
        self.read = read

    def plan(self, observation):
        return PlannedTrajectory(*straight(float(self.read(observation))))


def withhold(policy, samples):
    return measure_withheld(policy, samples, measure_open_loop(policy, samples))


SAMPLES = [sample_at(speed, clip) for speed, clip in ((4, "a"), (8, "b"), (6, "b"), (10, "c"))]
MEAN = float(np.mean([4, 8, 6, 10]) * TIMES.mean())


@pytest.mark.parametrize(
    ("read", "felt"),
    [
        (lambda seen: seen.images[1, 3].mean(), {f"{FRONT_WIDE} black", "all cameras black"}),
        (
            lambda seen: seen.images[1, 0].mean() - seen.images[1, 3].mean(),
            {f"{FRONT_WIDE} black", "all cameras black", "earlier frames as the last"},
        ),
        (lambda seen: seen.route_xy[0, 0] if len(seen.route_xy) else 0.0, {"no route"}),
    ],
)
def test_what_a_policy_relies_on_is_found(read, felt):
    found = {each.name: each for each in withhold(Reader(read), SAMPLES)}
    assert set(found) == {
        f"{CROSS_LEFT} black",
        f"{FRONT_WIDE} black",
        "all cameras black",
        "earlier frames as the last",
        "no route",
    }
    for name, each in found.items():
        expected = MEAN if name in felt else 0.0
        assert each.increase == pytest.approx(expected, abs=1e-5) and each.min_ade == pytest.approx(expected, abs=1e-5)
        if name in felt:
            low, high = each.increase_interval
            assert low < each.increase < high


def test_samples_without_a_route_have_none_to_withhold():
    samples = [sample_at(4, "a", with_route=False)]
    (*_, last) = withhold(Reader(lambda seen: 4.0), samples)
    assert last.name == "earlier frames as the last" and last.increase_interval is None
