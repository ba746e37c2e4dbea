import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from olt_sft_recipes.toy.tokens import decode_actions, encode_actions, encode_history
from olt_toolkit.policy.action_space import trajectory_to_actions

# The released tokenizers: (speed, acceleration, curvature), first four future tokens, first six history tokens.
REFERENCE = [
    (10.0, 0.0, 0.0, [1494, 1498, 1493, 1498], [0, 500, 500, 624, 500, 500]),
    (5.0, 1.0, 0.0, [1714, 1498, 1713, 1498], [0, 500, 500, 544, 500, 500]),
    (8.0, 0.0, 0.02, [1494, 1613, 1493, 1613], [0, 678, 500, 597, 477, 500]),
    (8.0, -1.2, 0.01, [1229, 1555, 1229, 1555], [0, 611, 500, 620, 484, 500]),
    (0.0, 0.0, 0.0, [1493, 1498, 1493, 1498], [500, 500, 500, 500, 500, 500]),
]


def drive(speed, acceleration, curvature):
    """Exact poses of motion with constant acceleration and curvature at -1.5 ... 6.4 s."""
    times = np.concatenate([np.arange(-15, 1), np.arange(1, 65)]) * 0.1
    distance = speed * times + 0.5 * acceleration * times**2
    yaw = curvature * distance
    if curvature:
        x, y = np.sin(yaw) / curvature, (1 - np.cos(yaw)) / curvature
    else:
        x, y = distance, 0.0 * distance
    rotation = np.zeros((80, 3, 3))
    rotation[:, 0, 0] = rotation[:, 1, 1] = np.cos(yaw)
    rotation[:, 1, 0], rotation[:, 0, 1], rotation[:, 2, 2] = np.sin(yaw), -np.sin(yaw), 1.0
    return np.stack([x, y, 0.0 * x], axis=-1), rotation


@pytest.mark.parametrize(("speed", "acceleration", "curvature", "future", "history"), REFERENCE)
def test_tokens_of_the_released_tokenizers(speed, acceleration, curvature, future, history):
    xyz, rotation = drive(speed, acceleration, curvature)
    actions = trajectory_to_actions(xyz[:16], rotation[:16], xyz[16:], rotation[16:])
    # Their arithmetic is single precision: a value on the edge between two tokens may fall to either.
    assert np.abs(encode_actions(actions)[0][:4] - future).max() <= 1
    assert np.abs(encode_history(xyz[:16])[:6] - 3000 - history).max() <= 1


@given(hnp.arrays(np.float64, (64, 2), elements=st.floats(-9.99, 9.99)))
def test_decoding_gives_the_nearest_of_the_3000_values(actions):
    tokens, saturated = encode_actions(actions)
    assert saturated == 0
    assert np.abs(decode_actions(tokens) - actions).max() <= 10.0 / 2999 + 1e-12


def test_what_is_cut_off_is_counted():
    actions = np.zeros((64, 2))
    actions[3, 0], actions[5, 1] = 11.0, -40.0
    tokens, saturated = encode_actions(actions)
    assert saturated == 2
    assert tokens.min() == 0 and tokens.max() == 2999
