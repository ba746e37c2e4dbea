from dataclasses import replace

import numpy as np
import pytest
import shapely
import torch
from hypothesis import given
from hypothesis import strategies as st

from olt_sft_recipes.toy.birds_eye import FRONT, OFFSETS, STATIONS, route_cells
from olt_sft_recipes.toy.image_encoder import SECONDS_AHEAD, Sight
from olt_sft_recipes.training.auxiliary import (
    FAR,
    NEAR,
    SightTruth,
    drive,
    gather_truth,
    plan_errors,
    road_truth,
    sight_errors,
)
from olt_toolkit.policy.action_space import actions_to_trajectory
from olt_toolkit.policy.sample import MOST_OBSTACLES, TRUTH_OFFSETS_US

from ..conftest import make_sample

ROUTE = np.column_stack([np.linspace(0.0, 80.0, 20), np.zeros(20)])
ALONG = route_cells(ROUTE, 0.0)[None]
NOBODY = np.full((len(TRUTH_OFFSETS_US), MOST_OBSTACLES, 5), np.nan, np.float32)
FREE = np.array([0.0, np.nan], np.float32)


ROAD = np.column_stack([ROUTE, np.full((20, 2), 3.0)]).astype(np.float32)


def sample_with(boxes, hold=FREE):
    return replace(make_sample(0.0), obstacle_boxes=boxes, hold=hold, road=ROAD)


def box_of(x, y, yaw, length, width):
    """The outline of a box."""
    box = shapely.affinity.rotate(shapely.box(-length / 2, -width / 2, length / 2, width / 2), yaw, (0, 0), True)
    return shapely.affinity.translate(box, x, y)


@given(
    x=st.floats(0.0, 50.0),
    y=st.floats(-8.0, 8.0),
    yaw=st.floats(-3.0, 3.0),
    length=st.floats(0.3, 12.0),
    width=st.floats(0.3, 3.0),
)
def test_cells_tell_how_near_a_box_is(x, y, yaw, length, width):
    """As far as it is from the part of a cell that is nearest to it: no farther than from the middle, nor nearer than
    from the whole."""
    boxes = NOBODY.copy()
    boxes[:, 3] = x, y, yaw, length, width
    known, truth = gather_truth([sample_with(boxes)], ALONG)
    box = box_of(*boxes[0, 3].astype(float))
    half = 0.5 * np.gradient(STATIONS)[:, None]
    x, y = np.broadcast_arrays(STATIONS[:, None], OFFSETS)
    middle = shapely.distance(shapely.points(x, y), box)
    whole = shapely.distance(
        shapely.linestrings(np.stack([np.stack([x - half, y], -1), np.stack([x + half, y], -1)], 2)), box
    )
    least, most = (255.0 * np.clip((FAR - distance) / (FAR - NEAR), 0.0, 1.0) for distance in (middle, whole))
    assert known.all() and (truth[0, 0] >= least - 1.0).all() and (truth[0, 0] <= most + 1.0).all()


@given(right=st.floats(0.0, 10.0), left=st.floats(0.0, 10.0))
def test_cells_tell_where_the_road_ends(right, left):
    """Between the cells it ends where half of one is road."""
    road = np.column_stack([ROUTE, np.full(20, right), np.full(20, left)])
    share = road_truth(road)[5] / 255.0
    for end, side in ((left, 1.0), (right, -1.0)):
        if 0.5 < end < 5.0 and left + right > 1.6:
            assert np.interp(side * end, OFFSETS, share) == pytest.approx(0.5, abs=0.08)
    assert (share[(left + 0.4 < OFFSETS) | (-right - 0.4 > OFFSETS)] == 0.0).all()


def test_half_seconds_lie_between_those_that_are_told():
    boxes = NOBODY.copy()
    boxes[:, 0] = [[10.0 + 8.0 * index, 0.0, 0.0, 4.0, 2.0] for index in range(len(boxes))]
    _, route = gather_truth([sample_with(boxes)], ALONG)
    seconds = np.array(SECONDS_AHEAD)
    told = 1e-6 * np.array(TRUTH_OFFSETS_US)
    places = 10.0 + 8.0 * np.interp(seconds, told, np.arange(len(told)))
    for taken, place in zip(route[0, :-2].any(axis=2), places, strict=True):
        if place < STATIONS[-1] - 4.0:
            assert abs(STATIONS[taken.astype(bool)].mean() - place) < 1.5


def test_a_line_that_is_held_is_in_its_place_and_one_that_is_not_is_nowhere():
    _, held = gather_truth([sample_with(NOBODY, np.array([1.0, 20.0], np.float32))], ALONG)
    stations = STATIONS[held[0, -2].all(axis=1)]
    assert len(stations) and np.abs(stations - FRONT - 20.0).max() < 1.5 and not held[0, :-2].any()
    _, free = gather_truth([sample_with(NOBODY, np.array([0.0, 20.0], np.float32))], ALONG)
    assert not free[0, -2].any()


def test_who_knows_nothing_learns_nothing():
    known, route = gather_truth([make_sample(0.0), sample_with(NOBODY)], np.repeat(ALONG, 2, axis=0))
    assert known.tolist() == [[False, False], [True, True]] and not route[0].any() and route[1].any()
    logits = torch.randn(route.shape, requires_grad=True)
    truth = SightTruth(torch.from_numpy(known), torch.from_numpy(route))
    errors = sight_errors(Sight(torch.zeros(2, 1, 1), logits), truth)
    errors.sum().backward()
    assert errors[0] == 0.0 and errors[1] > 0.0 and not logits.grad[0].any() and logits.grad[1].any()


def test_who_knows_others_and_no_road_learns_of_them_alone():
    known, route = gather_truth([replace(sample_with(NOBODY), road=None)], ALONG)
    assert known.tolist() == [[True, False]]
    logits = torch.zeros(route.shape, requires_grad=True)
    truth = SightTruth(torch.from_numpy(known), torch.from_numpy(route))
    sight_errors(Sight(torch.zeros(1, 1, 1), logits), truth).sum().backward()
    assert logits.grad[0, :-1].all() and not logits.grad[0, -1].any()


@given(st.integers(0, 1000), st.floats(0.0, 15.0))
def test_actions_lead_where_the_action_space_says(seed, speed):
    actions = np.random.default_rng(seed).normal(size=(1, 64, 2))
    places = drive(torch.from_numpy(actions.astype(np.float32)), torch.tensor([speed], dtype=torch.float32))
    expected, _ = actions_to_trajectory(actions, np.array([speed]))
    assert np.allclose(places[0].numpy(), expected[0, :, :2], atol=2e-2)


def test_a_plan_that_is_right_has_no_error():
    actions = torch.randn(3, 64, 2)
    assert not plan_errors(actions, actions, torch.full((3,), 7.0)).any()
    assert (plan_errors(actions + 0.1, actions, torch.full((3,), 7.0)) > 0.0).all()
