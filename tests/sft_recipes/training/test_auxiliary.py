from dataclasses import replace

import numpy as np
import shapely
import torch
from hypothesis import given
from hypothesis import strategies as st

from olt_sft_recipes.toy.birds_eye import FRONT, STATIONS, route_cells, world_cells
from olt_sft_recipes.toy.image_encoder import SECONDS_AHEAD, Sight
from olt_sft_recipes.training.auxiliary import (
    ROUTE_ROOM,
    WORLD_ROOM,
    SightTruth,
    drive,
    gather_truth,
    plan_errors,
    sight_errors,
)
from olt_toolkit.policy.action_space import actions_to_trajectory
from olt_toolkit.policy.sample import MOST_OBSTACLES, TRUTH_OFFSETS_US

from ..conftest import make_sample

ROUTE = np.column_stack([np.linspace(0.0, 80.0, 20), np.zeros(20)])
ALONG = route_cells(ROUTE, 0.0)[None]
NOBODY = np.full((len(TRUTH_OFFSETS_US), MOST_OBSTACLES, 5), np.nan, np.float32)
FREE = np.array([0.0, np.nan], np.float32)


def sample_with(boxes, hold=FREE):
    return replace(make_sample(0.0), obstacle_boxes=boxes, hold=hold)


def box_of(x, y, yaw, length, width):
    """The outline of a box."""
    box = shapely.affinity.rotate(shapely.box(-length / 2, -width / 2, length / 2, width / 2), yaw, (0, 0), True)
    return shapely.affinity.translate(box, x, y)


def near(cells, box, room):
    points = shapely.points(cells[..., 0], cells[..., 1])
    distance = shapely.distance(points, box)
    return np.where(np.abs(distance - room) < 1e-3, np.nan, distance < room)


@given(
    x=st.floats(0.0, 50.0),
    y=st.floats(-20.0, 20.0),
    yaw=st.floats(-3.0, 3.0),
    length=st.floats(0.3, 12.0),
    width=st.floats(0.3, 3.0),
)
def test_cells_near_a_box_are_taken_and_no_others(x, y, yaw, length, width):
    boxes = NOBODY.copy()
    boxes[:, 3] = x, y, yaw, length, width
    known, route, world = gather_truth([sample_with(boxes)], ALONG)
    assert known.all()
    box = box_of(*boxes[0, 3].astype(float))
    for cells, taken, room in ((ALONG[0], route[0, 0], ROUTE_ROOM), (world_cells(), world[0, 0], WORLD_ROOM)):
        expected = near(cells, box, room)
        decided = ~np.isnan(expected)
        assert np.array_equal(taken[decided], expected[decided].astype(np.uint8))


def test_half_seconds_lie_between_those_that_are_told():
    boxes = NOBODY.copy()
    boxes[:, 0] = [[10.0 + 8.0 * index, 0.0, 0.0, 4.0, 2.0] for index in range(len(boxes))]
    _, route, _ = gather_truth([sample_with(boxes)], ALONG)
    seconds = np.array(SECONDS_AHEAD)
    told = 1e-6 * np.array(TRUTH_OFFSETS_US)
    places = 10.0 + 8.0 * np.interp(seconds, told, np.arange(len(told)))
    for taken, place in zip(route[0, :-1].any(axis=2), places, strict=True):
        if place < STATIONS[-1] - 4.0:
            assert abs(STATIONS[taken.astype(bool)].mean() - place) < 1.5


def test_a_line_that_is_held_is_in_its_place_and_one_that_is_not_is_nowhere():
    _, held, _ = gather_truth([sample_with(NOBODY, np.array([1.0, 20.0], np.float32))], ALONG)
    stations = STATIONS[held[0, -1].all(axis=1)]
    assert len(stations) and np.abs(stations - FRONT - 20.0).max() < 1.5 and held[0, -1].sum() == held.sum()
    _, free, _ = gather_truth([sample_with(NOBODY, np.array([0.0, 20.0], np.float32))], ALONG)
    assert not free.any()


def test_who_knows_nothing_learns_nothing():
    known, route, world = gather_truth([make_sample(0.0), sample_with(NOBODY)], np.repeat(ALONG, 2, axis=0))
    assert known.tolist() == [False, True] and not route.any() and not world.any()
    logits = [torch.randn(shape, requires_grad=True) for shape in (route.shape, world.shape)]
    truth = SightTruth(*(torch.from_numpy(part) for part in (known, route, world)))
    errors = sight_errors(Sight(torch.zeros(2, 1, 1), *logits), truth)
    errors.sum().backward()
    assert errors[0] == 0.0 and errors[1] > 0.0 and not logits[0].grad[0].any() and logits[0].grad[1].any()


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
