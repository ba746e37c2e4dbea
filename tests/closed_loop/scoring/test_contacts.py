"""First contacts of moving boxes, in continuous time."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_closed_loop.scoring.contacts import TOUCH, first_contacts
from olt_closed_loop.scoring.driving_metrics import box_distances, times_to_collision
from olt_closed_loop.scoring.moving_boxes import MovingBox, separations

SECOND = 1_000_000


def moving_box(times, poses, size=(4.6, 1.9, 1.5)):
    return MovingBox(np.array(times, dtype=np.int64), np.array(poses, dtype=np.float64), 0.5 * np.array(size))


def wandering_box(generator, steps=8):
    """A box that turns and changes its velocity every 0.1 to 0.5 s, somewhere within 12 m."""
    times = np.cumsum(generator.integers(100_000, 500_000, steps))
    poses = np.column_stack(
        [
            generator.uniform(-12, 12, 2) + np.cumsum(generator.uniform(-3, 3, (steps, 2)), axis=0),
            np.full(steps, generator.uniform(0, 3)),
            generator.uniform(-np.pi, np.pi) + np.cumsum(generator.uniform(-0.6, 0.6, steps)),
        ]
    )
    return moving_box(times, poses, generator.uniform(0.4, 6.0, 3))


def gaps_at(ego, box, times):
    return separations(ego.at(times), ego.half_size, box.at(times), box.half_size)[0].max(axis=1)


@settings(max_examples=60)
@given(seed=st.integers(0, 100_000))
def test_contacts_are_those_of_very_fine_sampling(seed):
    generator = np.random.default_rng(seed)
    ego, box = wandering_box(generator), wandering_box(generator)
    start, end = int(ego.timestamps_us[0]), int(ego.timestamps_us[-1])
    (contact_us,) = first_contacts(ego, [box], start, end)
    times = np.arange(start, end, 500)
    times = times[box.covers(times)]
    gaps = gaps_at(ego, box, times)
    touching = times[gaps < TOUCH]
    if np.isinf(contact_us):
        assert len(touching) == 0
        return
    contact = start + int(np.ceil(contact_us))
    assert len(touching) == 0 or contact <= touching[0]
    assert gaps_at(ego, box, np.array([contact]))[0] < 1e-4
    assert np.all(gaps[times < contact] > TOUCH)


@settings(max_examples=60)
@given(seed=st.integers(0, 100_000))
def test_boxes_that_keep_their_velocity_touch_when_the_formula_says(seed):
    generator = np.random.default_rng(seed)
    ego, box = (
        moving_box([0, 10 * SECOND], [start, start + change])
        for start, change in (
            (
                np.array([*generator.uniform(-20, 20, 2), 0.0, generator.uniform(-4, 4)]),
                np.array([*generator.uniform(-60, 60, 2), 0.0, 0.0]),
            )
            for _ in range(2)
        )
    )
    gaps, offsets = separations(ego.poses[:1], ego.half_size, box.poses[:1], box.half_size)
    velocity = (np.diff(box.poses, axis=0) - np.diff(ego.poses, axis=0))[0] / 10.0
    axes = [yaw + turn for yaw in (ego.poses[0, 3], box.poses[0, 3]) for turn in (0.0, np.pi / 2)]
    speeds = np.array([[np.cos(a) * velocity[0] + np.sin(a) * velocity[1] for a in axes] + [0.0]])
    (expected,) = times_to_collision(gaps, offsets, speeds)
    (found,) = first_contacts(ego, [box], 0, 10 * SECOND)
    if expected > 10.0:
        # An overlap of less than a micrometre is no contact.
        assert np.isinf(found)
    elif np.isfinite(found):
        assert found * 1e-6 == pytest.approx(expected, abs=1e-5)
    else:
        times = np.linspace(0, 10 * SECOND, 200_001).astype(np.int64)
        assert gaps_at(ego, box, times).min() > -1e-4


@settings(max_examples=20)
@given(seed=st.integers(0, 100_000), x=st.sampled_from([0.0, 5e6]), extra=st.integers(1, 9))
def test_how_motion_is_sampled_and_where_it_is_do_not_matter(seed, x, extra):
    generator = np.random.default_rng(seed)
    ego, box = wandering_box(generator), wandering_box(generator)
    start, end = int(ego.timestamps_us[0]), int(ego.timestamps_us[-1])

    def elsewhere(moved):
        times = np.union1d(moved.timestamps_us, np.linspace(*moved.timestamps_us[[0, -1]], 7 * extra).astype(np.int64))
        return MovingBox(times, np.add(moved.at(times), [x, -x, 0.0, 0.0]), moved.half_size)

    here, there = first_contacts(ego, [box], start, end), first_contacts(elsewhere(ego), [elsewhere(box)], start, end)
    assert np.isinf(here) == np.isinf(there)
    if np.isfinite(here):
        assert here == pytest.approx(there, abs=50.0)


def test_a_contact_between_two_samples_is_found():
    ego = moving_box([0, SECOND // 10], [[0, 0, 0, 0]] * 2)
    # At 60 m/s across the nose: 2.3 m half length + 0.25 m, clipped by 5 mm, is in the way for a small part of 0.1 s.
    dart = moving_box([0, SECOND // 10], [[2.545, 3.0, 0, 0], [2.545, -3.0, 0, 0]], (0.5, 0.5, 1.7))
    (contact,) = first_contacts(ego, [dart], 0, SECOND // 10)
    assert contact == pytest.approx((3.0 - 0.25 - 0.95) / 60.0 * 1e6, abs=2.0)
    beside = moving_box([0, SECOND // 10], [[2.551, 3.0, 0, 0], [2.551, -3.0, 0, 0]], (0.5, 0.5, 1.7))
    assert np.isinf(first_contacts(ego, [beside], 0, SECOND // 10)[0])


def test_turning_alone_can_touch():
    ego = moving_box([0, SECOND], [[0, 0, 0, 0], [0, 0, 0, np.pi]])
    post = moving_box([0, SECOND], [[0, 1.9, 0, 0]] * 2, (0.2, 0.2, 2.0))
    (contact,) = first_contacts(ego, [post], 0, SECOND)
    times = np.arange(0, SECOND, 10)
    assert contact == pytest.approx(times[np.argmax(gaps_at(ego, post, times) < TOUCH)], abs=10.0)


@pytest.mark.parametrize("spinning", ["ego", "other", "both", "both alike"])
def test_boxes_that_spin_between_two_samples_touch_as_in_very_fine_sampling(spinning):
    """Up to half a turn and a few metres within one piece: what happens between its ends is up to the bound alone."""
    generator = np.random.default_rng(0)
    turn, count = 3.0 * (spinning != "other"), 150
    ego = moving_box([0, SECOND], [[0, 0, 0, 0.3], [1.0, 0.5, 0, 0.3 + turn]], (6.0, 0.8, 1.5))
    start = np.column_stack([*generator.uniform(-7, 7, (2, count)), np.zeros(count), generator.uniform(-3, 3, count)])
    change = np.column_stack([*generator.uniform(-3, 3, (2, count)), np.zeros((count, 2))])
    change[:, 3] = {"ego": 0.0, "both alike": turn}.get(spinning, generator.uniform(-3, 3, count))
    boxes = [
        moving_box([0, SECOND], [here, here + way], (5.0, 0.6, 1.5)) for here, way in zip(start, change, strict=True)
    ]
    contacts = first_contacts(ego, boxes, 0, SECOND)
    times = np.arange(0, SECOND + 1, 1000)
    late = 0
    for box, contact in zip(boxes, contacts, strict=True):
        touching = times[gaps_at(ego, box, times) < TOUCH]
        assert len(touching) == 0 or contact <= touching[0]
        if np.isfinite(contact):
            assert gaps_at(ego, box, np.array([int(np.ceil(contact))]))[0] < 1e-4
            assert len(touching) == 0 or contact > touching[0] - 1000
            late += contact > 0.0
    assert late > 20 and np.isinf(contacts).sum() > 20


@pytest.mark.parametrize("turn", [0.5, 2.5])
@pytest.mark.parametrize("swinging", ["ego", "other"])
def test_a_truck_that_swings_its_nose_past_a_post_between_two_samples_touches_it(swinging, turn):
    """Its nose reaches 6 m at half time only; at both ends it stays as far off as the bound just allows for."""
    angles = np.pi / 2 + np.array([-0.5, 0.5]) * turn
    truck = moving_box([0, SECOND], [[0, 0, 0, angle] for angle in angles], (12.0, 0.1, 2.0))
    post = moving_box([0, SECOND], [[0, 6.03, 0, 0]] * 2, (0.1, 0.1, 2.0))
    (contact,) = first_contacts(*((truck, [post]) if swinging == "ego" else (post, [truck])), 0, SECOND)
    times = np.arange(0, SECOND, 10)
    assert contact == pytest.approx(times[np.argmax(gaps_at(truck, post, times) < TOUCH)], abs=10.0)
    assert 0.3 * SECOND < contact < 0.5 * SECOND


def test_boxes_side_by_side_without_a_gap_do_not_touch():
    ego = moving_box([0, SECOND], [[0, 0, 0, 0], [20, 0, 0, 0]])
    flush = moving_box([0, SECOND], [[0, 1.9, 0, 0]] * 2)
    assert np.isinf(first_contacts(ego, [flush], 0, SECOND)[0])


def test_who_was_there_once_or_never_is_no_trouble():
    ego = moving_box([0, SECOND], [[0, 0, 0, 0], [10, 0, 0, 0]])
    once = moving_box([SECOND // 2], [[5, 0, 0, 0]])
    before, after = moving_box([-5], [[0, 0, 0, 0]]), moving_box([SECOND + 5], [[10, 0, 0, 0]])
    assert first_contacts(ego, [before, once, after], 0, SECOND).tolist() == [np.inf, SECOND / 2, np.inf]
    assert first_contacts(ego, [], 0, SECOND).tolist() == []


@given(seed=st.integers(0, 100_000))
def test_the_distance_of_boxes_is_that_of_their_points(seed):
    generator = np.random.default_rng(seed)
    ours, theirs = (generator.uniform(-8, 8, (1, 4)) for _ in range(2))
    sizes = generator.uniform(0.5, 3.0, (2, 3))
    (distance,) = box_distances(ours, sizes[0], theirs, sizes[1:], at=np.array([0]))
    gaps, _ = separations(ours, sizes[0], theirs, sizes[1:])
    assert gaps.max() <= distance + 1e-9 or gaps.max() < 0.0
    edge = np.linspace(-1.0, 1.0, 41)
    faces = np.array([[s, t] for t in edge for s in (-1.0, 1.0)] + [[t, s] for t in edge for s in (-1.0, 1.0)])

    def outline(pose, half):
        cos, sin = np.cos(pose[3]), np.sin(pose[3])
        return (faces * half[:2]) @ [[cos, sin], [-sin, cos]] + pose[:2]

    apart = np.linalg.norm(outline(ours[0], sizes[0])[:, None] - outline(theirs[0], sizes[1]), axis=-1).min()
    vertical = max(abs(ours[0, 2] - theirs[0, 2]) - sizes[:, 2].sum(), 0.0)
    assert distance <= np.hypot(apart, vertical) + 1e-9
    if gaps[0, :4].max() > 0.0:
        assert distance == pytest.approx(np.hypot(apart, vertical), abs=0.2)
