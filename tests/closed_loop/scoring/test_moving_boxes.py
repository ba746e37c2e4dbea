"""Boxes over time, their corners, and the gaps between them, against values by hand."""

import numpy as np
import pytest

from olt_closed_loop.rollouts.rollout_record import EgoBox, RolloutRecord
from olt_closed_loop.scenes.actors import corners
from olt_closed_loop.scenes.scene import Agent
from olt_closed_loop.scoring.moving_boxes import MovingBox, agent_box, ego_box, separations

TIMES = np.array([1_000_000, 1_100_000, 1_300_000], dtype=np.int64)


def make_box(poses):
    return MovingBox(TIMES, np.array(poses, dtype=np.float64), np.array([2.0, 1.0, 0.75]))


def test_the_ego_box_lies_ahead_of_the_rear_axle_and_stands_on_the_ground():
    poses = np.array([[1.0, 2.0, 0.5, 0.0], [1.0, 2.0, 0.5, np.pi / 2], [1.0, 2.0, 0.5, -np.pi + 0.1]])
    record = RolloutRecord("drive", 0, TIMES, poses, EgoBox(5.0, 2.0, 1.6, 1.5), (), TIMES, poses)
    box = ego_box(record)
    np.testing.assert_allclose(box.poses[:2], [[2.5, 2.0, 1.3, 0.0], [1.0, 3.5, 1.3, np.pi / 2]])
    assert box.poses[2, 3] == pytest.approx(np.pi + 0.1)  # the short way from a quarter turn
    np.testing.assert_allclose(box.half_size, [2.5, 1.0, 0.8])
    assert box.radius == pytest.approx(np.hypot(2.5, 1.0))


def test_an_agent_turns_the_short_way_between_its_samples():
    poses = np.array([[0.0, 0.0, 0.8, 3.0], [2.0, 4.0, 0.8, -3.0], [2.0, 8.0, 1.8, -3.0]])
    box = agent_box(Agent("a", "automobile", 4.0, 2.0, 1.5, TIMES, poses))
    np.testing.assert_allclose(box.half_size, [2.0, 1.0, 0.75])
    halfway = box.at(np.array([1_050_000, 1_250_000]))
    np.testing.assert_allclose(halfway, [[1.0, 2.0, 0.8, np.pi], [2.0, 7.0, 1.55, 2.0 * np.pi - 3.0]])
    np.testing.assert_allclose(box.at(np.array([1_050_000]), columns=2), [[1.0, 2.0]])


def test_a_box_covers_its_first_and_last_time():
    box = make_box(np.zeros((3, 4)))
    assert box.covers(np.array([999_999, 1_000_000, 1_300_000, 1_300_001])).tolist() == [False, True, True, False]


def test_corners_go_round_from_the_front_left():
    turned = corners(np.array([[10.0, 20.0, 0.0, 0.0], [10.0, 20.0, 0.0, np.pi / 2]]), np.array([2.0, 1.0, 0.75]))
    np.testing.assert_allclose(turned[0], [[12.0, 21.0], [8.0, 21.0], [8.0, 19.0], [12.0, 19.0]])
    np.testing.assert_allclose(turned[1], [[9.0, 22.0], [9.0, 18.0], [11.0, 18.0], [11.0, 22.0]])


def test_gaps_are_those_along_five_axes():
    ego, ego_half = np.array([[1.0, 1.0, 0.8, 0.0]]), np.array([2.5, 1.0, 0.8])
    other, other_half = np.array([[7.0, 5.0, 3.0, np.pi / 6]]), np.array([2.0, 0.5, 1.0])
    gaps, offsets = separations(ego, ego_half, other, other_half)
    cos, sin = np.sqrt(3.0) / 2.0, 0.5
    along, across = cos * 6.0 + sin * 4.0, cos * 4.0 - sin * 6.0
    np.testing.assert_allclose(offsets, [[6.0, 4.0, along, across, 2.2]])
    sizes = [
        2.5 + 2.0 * cos + 0.5 * sin,
        1.0 + 2.0 * sin + 0.5 * cos,
        2.0 + 2.5 * cos + 1.0 * sin,
        0.5 + 2.5 * sin + 1.0 * cos,
        1.8,
    ]
    np.testing.assert_allclose(gaps, np.abs([[6.0, 4.0, along, across, 2.2]]) - sizes)
    each_its_own, _ = separations(ego, ego_half[None], other, other_half[None])
    np.testing.assert_array_equal(each_its_own, gaps)
