"""Route, boxes of others and holds in a clip, and in its samples."""

from dataclasses import replace

import numpy as np
import pytest

from olt_generator.errors import InputError
from olt_generator.poses import invert, transform, yaw_of
from olt_toolkit.clips.clip import make_clip_id
from olt_toolkit.clips.pai_layout import HOLDS, OBSTACLES, ROAD, ROUTE
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.truth_tables import read_holds, read_obstacles, read_road, read_route, truth_tables
from olt_toolkit.policy.route import routes_ahead
from olt_toolkit.policy.sample import TRUTH_OFFSETS_US, SampleKey
from olt_toolkit.recordings.truth import OBSTACLE_CLASSES, Holds, ObstacleTracks

T0_US = 2_000_000
ROUTE_LINE = np.array([[-5.0, 0.5], [30.0, 0.0], [60.0, 8.0]])


@pytest.fixture
def known_clip(make_clip):
    """A clip with a route, a car that stands in the anchor frame, a person who is there at first only, and a line."""
    clip = make_clip()
    times = np.arange(0, 8_900_001, 100_000)
    T_anchor_rig = clip.ego_motion.interpolate(times)
    place = np.array([[40.0, 3.0, 0.75]])
    boxes = np.array(
        [[*transform(invert(pose), place)[0], 0.3 - yaw_of(pose), 4.6, 1.85, 1.5] for pose in T_anchor_rig]
    )
    early = times <= T0_US
    person = np.tile([5.0, -2.0, 0.9, 0.0, 0.5, 0.6, 1.75], (int(early.sum()), 1))
    stamps = np.concatenate([times, times[early]])
    order = np.argsort(stamps, kind="stable")
    tracks = ObstacleTracks(
        stamps[order],
        np.array(["car"] * len(times) + ["walker"] * int(early.sum()))[order],
        np.array(["automobile"] * len(times) + ["person"] * int(early.sum()))[order],
        np.concatenate([boxes, person])[order],
    )
    holds = Holds(times, times < 3_000_000, np.where(times < 3_000_000, 20.0, np.nan))
    sides = np.linspace([2.0, 3.0], [4.0, 7.0], len(ROUTE_LINE))
    return replace(clip, route=ROUTE_LINE, obstacles=tracks, holds=holds, road=np.column_stack([ROUTE_LINE, sides]))


def stored(folder, clip):
    store = ClipStore(folder)
    store.prepare(clip)
    store.commit([clip.clip_id])
    return ClipStore(folder)


def test_samples_tell_what_is_known(tmp_path, known_clip):
    store = stored(tmp_path, known_clip)
    key = SampleKey(str(tmp_path), known_clip.clip_id, T0_US)
    sample = store.load_sample(key, with_truth=True)
    T_anchor_t0 = known_clip.ego_motion.interpolate(np.array([T0_US]))[0]
    poses = known_clip.ego_motion.interpolate(np.arange(1_700_000, T0_US + 1, 100_000))
    expected = routes_ahead(ROUTE_LINE, np.column_stack([poses[:, :2, 3], yaw_of(poses)]))[-1]
    np.testing.assert_allclose(sample.route_xy, expected, rtol=1e-5, atol=1e-4)

    assert [OBSTACLE_CLASSES[number] for number in sample.obstacle_classes[:2]] == ["person", "automobile"]
    assert np.all(sample.obstacle_classes[2:] == -1)
    car = transform(invert(T_anchor_t0), np.array([[40.0, 3.0, 0.75]]))[0, :2]
    known = [T0_US + offset <= 8_900_000 for offset in TRUTH_OFFSETS_US]
    np.testing.assert_allclose(sample.obstacle_boxes[known, 1, :2], np.tile(car, (sum(known), 1)), atol=1e-3)
    np.testing.assert_allclose(sample.obstacle_boxes[known, 1, 2], 0.3 - yaw_of(T_anchor_t0), atol=1e-3)
    assert sample.obstacle_boxes[0, 0, :2].tolist() == [5.0, -2.0]
    assert np.isnan(sample.obstacle_boxes[1:, 0]).all() and np.isnan(sample.obstacle_boxes[:, 2:]).all()
    assert sample.hold.tolist() == [1.0, 20.0]
    np.testing.assert_array_equal(sample.road[:, :2], sample.route_xy)
    right, left = sample.road[~np.isnan(sample.road[:, 0]), 2:].T
    assert np.all(np.diff(right) > 0.0) and np.allclose(left, 2.0 * right - 1.0, atol=1e-4)


def test_nothing_is_told_where_it_is_not_asked_for_or_not_known(tmp_path, known_clip, make_clip):
    store = stored(tmp_path / "known", known_clip)
    sample = store.load_sample(SampleKey("", known_clip.clip_id, T0_US))
    assert sample.obstacle_boxes is None and sample.obstacle_classes is None and sample.hold is sample.road is None
    plain = stored(tmp_path / "plain", make_clip())
    sample = plain.load_sample(SampleKey("", make_clip_id("bend"), T0_US), with_truth=True)
    assert np.isnan(sample.route_xy).all() and np.isnan(sample.obstacle_boxes).all() and np.isnan(sample.hold).all()
    assert np.isnan(sample.road).all() and plain.read_road(make_clip_id("bend")) is None
    assert np.all(sample.obstacle_classes == -1)
    assert plain.read_route(make_clip_id("bend")) is None


def test_the_same_sample_has_the_same_route_alone_and_in_a_batch(tmp_path, known_clip):
    store = stored(tmp_path, known_clip)
    keys = [SampleKey("", known_clip.clip_id, time) for time in (1_900_000, 2_100_000, 2_500_000)]
    together = store.load_samples(keys)
    for key, sample in zip(keys, together, strict=True):
        assert np.array_equal(store.load_sample(key).route_xy, sample.route_xy, equal_nan=True)


def to_bytes(frame, tmp_path):
    frame.to_parquet(tmp_path / "table.parquet")
    return (tmp_path / "table.parquet").read_bytes()


def test_tables_come_back(known_clip, tmp_path):
    tables = truth_tables(known_clip)
    np.testing.assert_array_equal(read_route(to_bytes(tables[ROUTE], tmp_path), "here"), ROUTE_LINE)
    tracks = read_obstacles(to_bytes(tables[OBSTACLES], tmp_path), "here")
    np.testing.assert_allclose(tracks.boxes, known_clip.obstacles.boxes, atol=1e-12)
    assert tracks.track_ids.tolist() == known_clip.obstacles.track_ids.tolist()
    holds = read_holds(to_bytes(tables[HOLDS], tmp_path), "here")
    np.testing.assert_array_equal(holds.distance, known_clip.holds.distance)
    np.testing.assert_array_equal(read_road(to_bytes(tables[ROAD], tmp_path), "here"), known_clip.road)


@pytest.mark.parametrize(
    ("name", "read", "change", "complaint"),
    [
        (ROUTE, read_route, lambda table: table.drop(columns="y"), "column y is missing"),
        (ROUTE, read_route, lambda table: table.assign(x=float("inf")), "not finite"),
        (ROUTE, read_route, lambda table: table[:1], "two or more"),
        (OBSTACLES, read_obstacles, lambda table: table.assign(orientation_w=3.0), "unit length"),
        (OBSTACLES, read_obstacles, lambda table: table.assign(reference_frame="world"), "frame of the rig"),
        (OBSTACLES, read_obstacles, lambda table: table.assign(timestamp_us=0.5), "int64"),
        (HOLDS, read_holds, lambda table: table[::-1], "increasing"),
        (HOLDS, read_holds, lambda table: table.assign(is_held="no"), "true or false"),
        (ROAD, read_road, lambda table: table.drop(columns="left"), "column left is missing"),
        (ROAD, read_road, lambda table: table.assign(right=-1.0), "negative"),
        (ROAD, read_road, lambda table: table[:1], "two or more"),
    ],
)
def test_damaged_tables_are_named(known_clip, tmp_path, name, read, change, complaint):
    data = to_bytes(change(truth_tables(known_clip)[name]), tmp_path)
    with pytest.raises(InputError, match=complaint):
        read(data, "here")
