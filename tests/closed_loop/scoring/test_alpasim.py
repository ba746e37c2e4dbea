"""The definition `alpasim` on rollouts made for each of its rules; tests/real/test_alpasim_parity has real values."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_closed_loop.rollouts.rollout_files import parse_rollout
from olt_closed_loop.scoring.alpasim.plans import measure_plan_collisions
from olt_closed_loop.scoring.alpasim.recording import lateral_distances
from olt_closed_loop.scoring.alpasim.scores import score_as_alpasim
from olt_closed_loop.scoring.alpasim.surroundings import Surroundings, measure_contact


@pytest.fixture(scope="session")
def score(texts):
    """AlpaSim's values of a drive along x, changed as asked."""

    def scored(poses=None, version="3032e0c", **changes):
        poses = texts.along_x() if poses is None else poses
        return score_as_alpasim(parse_rollout(texts.rollout(poses, **changes), "drive"), version)

    return scored


def plan(texts, now, count=65, offset=0.0, samples=True):
    """A plan at sample `now` along x at 10 m/s, `offset` to the left after its first pose."""
    poses = np.add(texts.along_x(count=count), [float(now), offset, 0.0])
    poses[0, 1] = 0.0
    times = [100_000 * (now + step) for step in range(count)]
    drawn = [poses.tolist()] if samples else []
    return {"now_us": times[0], "timestamps_us": times, "poses": poses.tolist(), "samples": drawn}


@settings(max_examples=12)
@given(seed=st.integers(0, 10_000))
def test_contact_is_that_of_every_outline_against_every_other(texts, seed):
    surroundings = Surroundings(parse_rollout(texts.random(seed), "drive"))
    metrics = measure_contact(surroundings)
    nearest, touched = [], []
    for sample in range(len(surroundings.record.timestamps_us)):
        ego, *others = surroundings.outlines_at(sample)
        nearest.append(min((shapely.distance(ego, other) for other in others), default=np.nan))
        touched.append(any(shapely.intersects(ego, other) for other in others))
    np.testing.assert_allclose(metrics["min_distance_to_obstacle_m"].values, nearest, atol=1e-6)
    np.testing.assert_array_equal(metrics["collision_any"].values, touched)
    zones = [metrics[f"collision_{zone}"].values for zone in ("front", "rear", "lateral")]
    np.testing.assert_array_equal(np.sum(zones, axis=0), touched)


@settings(max_examples=12)
@given(seed=st.integers(0, 10_000))
def test_plans_collide_where_any_outline_of_them_meets_one_of_an_agent(texts, seed):
    surroundings = Surroundings(parse_rollout(texts.random(seed), "drive"))
    expected = []
    for index, plan in enumerate(surroundings.record.plans):
        times = plan.timestamps_us[(plan.timestamps_us > plan.now_us) & (plan.timestamps_us <= plan.now_us + 3_000_000)]
        own = surroundings.ego_shape.polygons(*surroundings.plans.at(times, index))
        for agent in range(len(surroundings.agents)):
            there = surroundings.agents.exists(times, agent)
            shape = surroundings.agent_shapes.select(np.array([agent]))
            outlines = shape.polygons(*surroundings.agents.at(times[there], agent))
            if shapely.intersects(own[there], outlines).any():
                expected.append(index)
                break
    collides = measure_plan_collisions(surroundings)["open_loop_collision"].values
    np.testing.assert_array_equal(np.flatnonzero(collides), expected)


def test_without_a_map_nothing_is_off_road_and_the_scene_has_no_score(score):
    scores = score(map=None)
    roads = {"min_distance_to_lane_boundary_m", "offroad", "wrong_lane"}
    assert set(scores.missing) == roads
    assert all(scores.raw[name] is None for name in roads) and not roads & set(scores.final)
    assert scores.final["offroad_or_collision"] == 0.0
    assert scores.scene.score is None and scores.scene.passed is None
    assert scores.to_dict()["scene"] == {"error": "Cannot compute scene score: missing metric 'offroad'."}


def test_a_lane_without_its_right_border_takes_the_road_metrics_with_it(texts, score):
    road = texts.road()
    del road["lanes"][0]["right"]
    assert "no right one" in score(map=road).missing["offroad"]
    road["lanes"][0].pop("left")
    assert score(map=road).scene.score == 1.0


def test_a_lane_without_borders_is_as_wide_as_usual(texts, score):
    road = texts.road()
    road["lanes"] = [{"id": "only", "center": road["lanes"][0]["center"]}]
    expected = 0.5 * 3.7 - 0.5 * 0.98 * 2.109
    assert score(map=road).raw["min_distance_to_lane_boundary_m"] == pytest.approx(expected, abs=1e-6)


def test_edges_count_only_where_they_are_touched(texts, score):
    assert score(texts.along_x(y=-1.5)).final["offroad"] == 1.0
    assert score(texts.along_x(y=-8.0)).final["offroad"] == 0.0
    straddling = score(texts.along_x(y=1.85))
    assert straddling.final["offroad"] == 0.0 and straddling.final["min_distance_to_lane_boundary_m"] > 0.0


def test_the_warm_up_does_not_count(texts, score):
    brief = texts.agent(np.tile([10.0, 0.0, 0.0], (16, 1)))
    scores = score(agents={"brief": brief})
    assert (scores.raw["collision_any"], scores.final["collision_any"]) == (1.0, 0.0)
    assert scores.n_steps_scored == 64 and scores.final["duration_frac_20s"] == pytest.approx(6.3 / 20.0)


def test_a_drive_that_ends_before_the_hand_over_is_kept_whole(texts, score):
    scores = score(texts.along_x(count=10))
    assert (scores.n_steps_scored, scores.final["eval_relevant"]) == (10, 0.0)


def test_agents_that_start_late_are_not_there_before(texts, score):
    late = texts.agent(np.tile([40.0, 0.0, 0.0], (10, 1)), start=60)
    scores = score(agents={"late": late})
    assert scores.raw["collision_any"] == 0.0
    assert scores.raw["min_distance_to_obstacle_m"] == pytest.approx(60 - 40 - 2.3 + 1.3965 - 0.5 * 5.393, abs=0.1)


CHALLENGE = "challenge-2026-09"


def test_the_lateral_distance_is_that_of_alpasims_own_test():
    line, degenerate = np.array([[0.0, 0.0], [50.0, 0.0]]), np.zeros((2, 2))
    points = np.array([[56.0, 0.0], [70.0, 0.0], [25.0, 4.5], [56.0, 5.0]])
    np.testing.assert_allclose(lateral_distances(line, points), [0.0, 0.0, 4.5, 5.0], atol=1e-12)
    assert lateral_distances(degenerate, np.array([[3.0, 4.0]])) == pytest.approx([5.0])


@given(
    ends=st.lists(st.tuples(st.integers(-30, 30), st.integers(-30, 30)), min_size=2, max_size=5, unique=True),
    point=st.tuples(st.floats(-60, 60), st.floats(-60, 60)),
)
def test_beside_a_path_is_never_farther_than_the_path_and_the_same_before_its_end(ends, point):
    path, place = np.array(ends, dtype=float), shapely.Point(point)
    line = shapely.LineString(path)
    (beside,) = lateral_distances(path, np.array([point]))
    assert beside <= line.distance(place) + 1e-9
    if line.project(place) < line.length - 1e-6:
        assert beside == pytest.approx(line.distance(place))


def beside_the_road(texts, offset):
    """A drive that is `offset` to the left from sample 50 on, with edges too far away to matter."""
    poses = texts.along_x()
    poses[50:, 1] = offset
    changes = {"recorded": texts.along_x(), "map": texts.road() | {"road_edges": [[[-60, -19], [300, -19]]]}}
    return poses, changes


@pytest.mark.parametrize(("offset", "reason"), [(3.999, None), (4.0, "left_corridor_laterally")])
def test_the_challenge_gives_nothing_to_who_leaves_the_corridor_sideways(texts, score, offset, reason):
    poses, changes = beside_the_road(texts, offset)
    scores = score(poses, version=CHALLENGE, **changes)
    assert scores.scene.failure_reason == reason
    assert (scores.scene.score == 0.0) == (reason is not None)
    assert scores.final["lateral_dist_to_gt_trajectory"] == pytest.approx(offset, abs=1e-6)
    assert score(poses, **changes).scene.score > 0.0


def test_driving_on_past_the_end_of_the_recording_is_no_leaving(texts, score):
    slower = texts.along_x(speed=7.0)
    scores = score(recorded=slower, version=CHALLENGE)
    assert scores.final["dist_to_gt_trajectory"] >= 4.0
    assert scores.final["lateral_dist_to_gt_trajectory"] == pytest.approx(0.0, abs=1e-6)
    assert scores.scene.failure_reason is None
    # A quirk: where the recording ends standing its last segment has no direction, and the plain distance counts.
    slower[-1] = slower[-2]
    assert score(recorded=slower, version=CHALLENGE).scene.failure_reason == "left_corridor_laterally"


def test_progress_of_the_challenge_is_a_share_of_what_can_be_reached(texts, score):
    longer = texts.along_x(count=161)
    usual, challenge = score(recorded=longer), score(recorded=longer, version=CHALLENGE)
    assert usual.final["progress_clipped_rel"] == pytest.approx(0.5, abs=1e-6)
    assert challenge.final["progress"] == usual.final["progress"]
    assert challenge.final["progress_clipped_rel"] == pytest.approx(1.0, abs=1e-6)
    faster = score(texts.along_x(speed=15.0), recorded=longer, version=CHALLENGE)
    assert faster.final["progress_rel_to_total"] == pytest.approx(1.5, abs=1e-6) and faster.scene.score == 1.0


def test_an_early_hard_zero_is_named_first(texts, score):
    poses, changes = beside_the_road(texts, 4.5)
    parked = texts.agent(np.tile([52.0, 4.5, 0.0], (81, 1)))
    scores = score(poses, agents={"parked": parked}, version=CHALLENGE, **changes)
    assert scores.scene.failure_reason == "collision_at_fault"


def test_four_metres_off_the_recorded_path_end_the_drive(texts, score):
    poses = texts.along_x()
    poses[50:, 1] = 4.1
    scores = score(poses, recorded=texts.along_x(), map=texts.road() | {"road_edges": [[[-60, -9], [300, -9]]]})
    assert scores.final["dist_to_gt_trajectory"] == pytest.approx(4.1, abs=1e-6)
    assert scores.n_steps_scored == 51 - 17
    assert scores.final["progress_clipped_rel"] == pytest.approx(50.0 / 80.0, abs=1e-5)


def test_a_short_recording_has_full_progress(texts, score):
    still = texts.along_x(speed=0.5)
    still[30:] = still[30]
    scores = score(still, recorded=texts.along_x(speed=0.5))
    assert scores.final["progress"] < 0.5 and scores.scene.progress_score == 1.0


def test_a_recording_that_ends_early_leaves_no_summary(texts, score):
    scores = score(recorded=texts.along_x(count=40))
    assert "progress" in scores.missing and scores.final == {} and scores.scene.score is None
    assert scores.raw["collision_any"] == 0.0


def test_plans_that_jump_deviate_and_are_off_the_recording(texts, score):
    plans = [plan(texts, now, offset=0.5 * (-1) ** now) for now in range(0, 20)]
    scores = score(plans=plans)
    assert scores.raw["plan_deviation"] == pytest.approx(1.0, abs=1e-6)
    assert [scores.raw[f"min_ade@{h}s(gt)"] for h in (0.5, 1.0, 2.5, 5.0)] == pytest.approx([0.5] * 4, abs=1e-6)
    assert scores.raw["open_loop_collision"] == 0.0 and scores.raw["safety_monitor_triggered"] == 0.0


def test_the_nearest_sample_of_a_plan_counts(texts, score):
    values = plan(texts, 20, offset=1.0)
    values["samples"].append(np.add(values["poses"], [0.0, -0.7, 0.0]).tolist())
    assert score(plans=[values]).raw["min_ade@0.5s(gt)"] == pytest.approx(0.3, abs=1e-5)
    assert score(plans=[plan(texts, 20, samples=False)]).raw["min_ade@0.5s(gt)"] is None


def test_plans_that_end_too_early_take_all_displacements_with_them(texts, score):
    scores = score(plans=[plan(texts, 0), plan(texts, 20, count=50)])
    assert scores.raw["min_ade@0.5s(gt)"] is None and "min_ade@0.5s(gt)" in scores.missing
    assert scores.raw["plan_deviation"] == pytest.approx(0.0, abs=1e-6)
    # Near the end of the drive a plan need not reach farther than the drive.
    assert score(plans=[plan(texts, 70, count=20)]).raw["min_ade@1.0s(gt)"] == pytest.approx(0.0, abs=1e-6)


def test_plans_into_recorded_agents_are_counted(texts, score):
    crosses = texts.agent(np.array([[60.0, 20.0 - 0.5 * index, 0.0] for index in range(81)]))
    plans = [plan(texts, now) for now in (20, 27, 45)]
    short = plan(texts, 60, count=1)
    # At sample 40 the agent is where the plans lead; the third is made after that.
    fast = [p | {"poses": np.add(p["poses"], [60.0 - 40.0, 0.0, 0.0]).tolist()} for p in plans]
    assert score(agents={"a": crosses}, plans=[*fast, short]).raw["open_loop_collision"] == pytest.approx(2.0 / 3.0)


@settings(max_examples=10)
@given(seed=st.integers(0, 10_000))
def test_any_rollout_has_numbers_or_none(texts, seed):
    scores = score_as_alpasim(parse_rollout(texts.random(seed), "drive"))
    numbers = [value for value in [*scores.raw.values(), *scores.final.values()] if value is not None]
    assert np.isfinite(numbers).all()
    if scores.scene.score is not None:
        assert 0.0 <= scores.scene.score <= 1.0
        assert scores.scene.passed == (scores.scene.failure_reason is None)


@settings(max_examples=8)
@given(seed=st.integers(0, 10_000))
def test_the_order_of_agents_changes_nothing(texts, seed):
    values = texts.random(seed)
    backwards = values | {"agents": dict(reversed(values["agents"].items()))}
    first, second = (score_as_alpasim(parse_rollout(v, "drive")) for v in (values, backwards))
    assert (first.raw, first.final) == (second.raw, second.final)
