"""What lies far from a drive is left out of its drivable area, and nothing changes by that."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_closed_loop.benchmarks.score_drives import crowded_drive, in_town
from olt_closed_loop.rollouts.rollout_record import PLAN_STEP_US, EgoBox, LaneLines, RolloutRecord
from olt_closed_loop.scoring.definitions import score_record
from olt_closed_loop.scoring.drivable import drivable_area_of
from olt_closed_loop.scoring.moving_boxes import ego_box

STEP_US = 100_000


def record_of(path, lanes=(), edges=(), outlines=()):
    poses = np.column_stack([path, np.zeros(len(path)), np.zeros(len(path))])
    times = STEP_US * np.arange(len(path), dtype=np.int64)
    box = EgoBox(4.8, 2.0, 1.5, 1.4)
    return RolloutRecord("drive", 0, times, poses, box, (), times, poses, tuple(lanes), tuple(edges), tuple(outlines))


def flat(points):
    return np.column_stack([points, np.zeros(len(points))])


def street(x, y, turn, bordered):
    """A lane of 60 m at a place, and an edge on each side of it."""
    way, cos, sin = np.linspace(-30.0, 30.0, 8), np.cos(turn), np.sin(turn)

    def line(offset):
        return flat(np.column_stack([x + cos * way - sin * offset, y + sin * way + cos * offset]))

    lane = LaneLines(line(0.0), line(1.8), line(-1.8)) if bordered else LaneLines(line(0.0))
    return lane, [line(2.5), line(-2.5)]


PLACES = st.floats(-150.0, 150.0)


@settings(max_examples=150)
@given(
    streets=st.lists(st.tuples(PLACES, PLACES, st.floats(-3.2, 3.2), st.booleans()), min_size=1, max_size=8),
    speed=st.floats(0.0, 6.0),
    turn=st.floats(-0.2, 0.2),
    outlined=st.booleans(),
)
def test_the_road_is_left_when_it_is_left(streets, speed, turn, outlined):
    """Roads anywhere: under the drive, beside it, and so far that none is near."""
    heading = turn * np.arange(30)
    path = np.cumsum(speed * np.stack([np.cos(heading), np.sin(heading)], axis=-1), axis=0)
    lanes, edges = zip(*(street(*place) for place in streets), strict=True)
    if outlined:
        outlines = [np.concatenate([left, right[::-1]]) for left, right in edges]
        record = record_of(path, outlines=outlines)
    else:
        record = record_of(path, lanes, [line for both in edges for line in both])
    near, whole = drivable_area_of(record, skip=True), drivable_area_of(record)
    ego = ego_box(record)
    poses = ego.at(np.arange(0, record.timestamps_us[-1], 30_000))
    np.testing.assert_array_equal(near.leaves(poses, ego.half_size), whole.leaves(poses, ego.half_size))
    assert 0 <= near.left_out <= near.parts == whole.parts == len(streets)
    assert whole.left_out == 0
    assert not (near.may_be_left(poses, 3.0) < whole.may_be_left(poses, 3.0)).any()


def test_far_parts_are_left_out_and_an_edge_in_between_counts():
    """The only lane is far away, with an edge between: the nearest lane decides, wherever it is."""
    path = np.column_stack([np.linspace(0.0, 20.0, 30), np.zeros(30)])
    lane, edges = street(10.0, 80.0, 0.0, True)
    for line, off in ((edges[1], True), (edges[0], False)):  # the near edge, and the one beyond the lane
        record = record_of(path, [lane], [line])
        area = drivable_area_of(record, skip=True)
        assert (area.left_out, area.parts) == (1, 1)
        assert area.leaves(ego_box(record).poses, ego_box(record).half_size).tolist() == [off] * 30


@pytest.mark.parametrize("aside", [0.0, 4.0, 60.0])
def test_scores_in_a_town_are_those_with_the_whole_map(aside):
    record = in_town(crowded_drive(5).sampled(PLAN_STEP_US))
    poses = record.poses.copy()
    poses[60:, 1] += np.minimum(aside, 0.5 * np.arange(len(poses) - 60))
    record = replace(record, poses=poses)
    skipped, everything = score_record(record), score_record(record, skip=False)
    assert replace(skipped, left_out=()) == replace(everything, left_out=())
    (omission,) = [entry for entry in skipped.left_out if entry.what == "map in the road test"]
    assert 0 < omission.count < omission.total == len(record.lanes)
    assert skipped.offroad == (aside > 10.0)  # where the edge is
