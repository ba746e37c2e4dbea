from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_sft_recipes.training.driving_samples import DrivingSamples
from olt_toolkit.policy.action_space import actions_to_trajectory


@pytest.fixture(scope="module")
def samples(drives, tiny_config):
    return DrivingSamples.gather(list(drives.values()), tiny_config)


def drive_along(future, config):
    """One drive without history, images and truth along a future (1, 64, 3) and its route."""
    images, history = np.zeros((1, 4, 2, 3, 16, 32), np.uint8), np.zeros((1, 16, 3))
    truth = np.zeros((1, 2), bool), np.zeros((1, 11, 32, 14), np.uint8)
    return DrivingSamples(images, history, future, future[:, ::4, :2], config, np.zeros(1), *truth)


def test_mirror_twice_is_the_same(samples):
    twice = samples.mirrored().mirrored()
    assert np.array_equal(twice.images, samples.images)
    assert np.allclose(twice.future, samples.future) and np.allclose(twice.history, samples.history)


def test_mirror_swaps_left_and_right_cameras(drives, tiny_config):
    config = tiny_config.model_copy(update={"rig": "alpamayo-2"})
    images = np.zeros((6, 4, 3, 16, 32), np.uint8)
    images[:] = np.arange(6, dtype=np.uint8)[:, None, None, None, None]
    sample = replace(next(iter(drives.values())), image_frames=images)
    mirrored = DrivingSamples.gather([sample], config).mirrored()
    # Cross-left, front, cross-right, rear-left, rear-right, tele.
    assert mirrored.images[0, :, 0, 0, 0, 0].tolist() == [2, 1, 0, 4, 3, 5]


@pytest.mark.parametrize(("weight", "expected"), [(1.0, 1.0), (0.0, 0.25), (0.5, 0.625)])
def test_weights_follow_the_invented_share_of_the_images_used(drives, tiny_config, weight, expected):
    origin = np.zeros((4, 4, 8, 8), np.uint8)
    origin[:, [0, 3], 4:, 4:] = 1  # of the oldest and the newest frame, which are used, a quarter is seen
    sample = next(iter(drives.values()))
    samples = DrivingSamples.gather([replace(sample, image_origin=origin), sample], tiny_config)
    assert samples.weights(weight).tolist() == [expected, 1.0]
    assert samples.take([0]).weights(weight).tolist() == [expected]


def test_mirror_turns_curvature_around(samples):
    actions, mirrored = samples.actions(), samples.mirrored().actions()
    mean = actions[..., 1].mean() + mirrored[..., 1].mean()
    assert np.allclose(mirrored[..., 0], actions[..., 0])
    assert np.allclose(mirrored[..., 1] + actions[..., 1], mean, atol=1e-6)


def test_what_is_above_the_top_is_not_kept_and_nothing_below_misses_it(samples, drives, tiny_config):
    cut = DrivingSamples.gather(list(drives.values()), tiny_config.model_copy(update={"image_top": 4}))
    assert np.array_equal(cut.images, samples.images[..., 4:, :])
    aside = np.full(len(samples), 0.5), np.full(len(samples), 0.03)
    # A row further down nothing is looked up above the top.
    assert np.array_equal(cut.perturbed(*aside).images[..., 1:, :], samples.perturbed(*aside).images[..., 5:, :])


def test_no_turn_changes_nothing(samples):
    turned = samples.perturbed(np.zeros(len(samples)), np.zeros(len(samples)))
    assert np.abs(turned.images.astype(int) - samples.images).max() <= 1
    assert np.allclose(turned.future, samples.future)


@given(angle=st.floats(-0.1, 0.1))
def test_a_turned_drive_leaves_along_its_heading_and_returns_to_the_path(tiny_config, angle):
    straight = np.stack([np.arange(1, 65) * 1.0, np.zeros(64), np.zeros(64)], axis=-1)[None]
    drive = drive_along(straight, tiny_config)
    future = drive.perturbed(np.zeros(1), np.array([angle])).future[0]
    # A metre of drive has already turned the vehicle back a little.
    first = np.arctan2(future[0, 1], future[0, 0])
    assert abs(first) <= 0.15 * abs(angle) + 1e-12
    along = np.array([np.cos(-angle), np.sin(-angle)])
    off = future[:, 0] * -along[1] + future[:, 1] * along[0]
    assert abs(off[-1]) <= 0.03 * abs(angle) * 64 + 1e-12
    assert abs(future[-1, 2] + angle) <= 0.02 * abs(angle) + 1e-12
    assert np.abs(off).max() <= abs(angle) * 8.0 / np.e + 1e-9


def test_a_drive_beside_its_path_starts_there_and_returns(tiny_config):
    straight = np.stack([np.arange(1, 65) * 1.0, np.zeros(64), np.zeros(64)], axis=-1)[None]
    drive = drive_along(straight, tiny_config)
    future = drive.perturbed(np.array([0.5]), np.zeros(1)).future[0]
    assert abs(future[0, 1]) < 0.02 and abs(future[0, 2]) < 0.02
    assert future[-1, 1] == pytest.approx(-0.5, abs=0.01)
    assert (np.diff(future[:, 1]) < 1e-6).all()


def test_a_left_turn_moves_the_scene_to_the_right(samples):
    front = samples.perturbed(np.zeros(len(samples)), np.full(len(samples), 0.06)).images[:, 1, 0, 0, 0]
    before = samples.images[:, 1, 0, 0, 0].argmax(axis=-1)
    assert (front.argmax(axis=-1) > before).all()


def test_actions_of_a_drive_drive_it_again(samples):
    xyz, _ = actions_to_trajectory(samples.actions(), np.linalg.norm(samples.future[:, 0, :2], axis=-1) / 0.1)
    assert np.abs(xyz[..., :2] - samples.future[..., :2]).max() < 0.2
