"""The table of situations is right, and no verdict of it hangs on a hair."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from olt_closed_loop.situations.changes import changed, mirrored, moved
from olt_closed_loop.situations.sweeps import sweep_all
from olt_closed_loop.situations.table import SITUATIONS, contact_of, judge_situation

MIDDLE_US = 5_000_000
BY_NAME = {situation.name: situation for situation in SITUATIONS}
names = st.sampled_from(sorted(BY_NAME))
shares = st.lists(st.floats(-1.0, 1.0), min_size=8, max_size=8).map(np.array)


@lru_cache
def known(name):
    """The rollout of a situation, and the contact of its partner."""
    record = BY_NAME[name].record()
    return record, contact_of(record)


def verdict(hit):
    return (hit.at_fault, hit.rule, hit.side) if hit else None


def test_there_are_many_and_each_has_a_name():
    assert len(SITUATIONS) >= 40
    assert len(BY_NAME) == len(SITUATIONS)


@pytest.mark.parametrize("name", BY_NAME)
def test_the_verdict_is_right_and_for_the_right_reason(name):
    row = judge_situation(BY_NAME[name])
    assert (row.at_fault, row.rule) == (BY_NAME[name].at_fault, BY_NAME[name].rule)
    assert row.reason


@pytest.mark.parametrize("name", BY_NAME)
def test_where_others_say_something_else_the_table_says_why(name):
    row = judge_situation(BY_NAME[name])
    if (row.alpasim, row.nuplan_at_fault) != (row.at_fault, row.at_fault):
        assert row.why


@given(name=names, draws=shares)
@example(name="creeps at 0.06 m/s into a standing car", draws=-np.ones(8))
@settings(max_examples=60)
def test_one_percent_of_speed_heading_and_place_flips_no_verdict(name, draws):
    record, hit = known(name)
    again = contact_of(changed(record, hit.time_us if hit else MIDDLE_US, draws))
    assert (again.at_fault if again else None) == (hit.at_fault if hit else None)


@pytest.mark.slow
@pytest.mark.parametrize("name", BY_NAME)
def test_one_percent_at_all_its_limits_flips_no_verdict(name):
    record, hit = known(name)
    for corner in range(2**8):
        draws = np.array([1.0 if corner >> bit & 1 else -1.0 for bit in range(8)])
        again = contact_of(changed(record, hit.time_us if hit else MIDDLE_US, draws))
        assert (again.at_fault if again else None) == (hit.at_fault if hit else None), draws


@given(name=names, heading=st.integers(0, 39), mirror=st.booleans(), x=st.floats(-1e6, 1e6), y=st.floats(-1e6, 1e6))
@settings(max_examples=60)
def test_the_verdict_is_that_of_the_scene_turned_shifted_and_mirrored(name, heading, mirror, x, y):
    record, hit = known(name)
    turned = moved(mirrored(record) if mirror else record, heading * np.pi / 20.0, (x, y))
    assert verdict(contact_of(replace(turned, agents=turned.agents[::-1]))) == verdict(hit)


@pytest.mark.parametrize("heading", range(40))
def test_who_appears_over_the_ego_is_not_hit_at_any_heading(heading):
    record, _ = known("a car appears over it")
    assert contact_of(moved(record, heading * np.pi / 20.0)) is None
    agent = record.agents[0]
    turned = replace(agent, poses=agent.poses + np.array([0.0, 0.0, 0.0, heading * np.pi / 20.0]))
    hit = contact_of(replace(record, agents=(turned,)))
    # At some headings the two come apart and touch again, which no driver can help.
    assert hit is None or not hit.at_fault


@pytest.fixture(scope="module")
def swept():
    return {sweep.name: np.array(sweep.verdicts) for sweep in sweep_all()}


@pytest.mark.slow
def test_a_standing_ego_is_at_fault_from_no_side(swept):
    assert (swept["stands, run into from all sides"] == False).all()  # noqa: E712


@pytest.mark.slow
def test_who_creeps_is_at_fault_from_the_dead_band_on(swept):
    grid = swept["creeps into a standing person"]
    assert (grid[4:] == True).all()  # noqa: E712
    assert not (grid[:4] == True).any()  # noqa: E712


@pytest.mark.slow
def test_who_crosses_without_right_of_way_is_at_fault_at_every_angle_and_speed(swept):
    grid = swept["drives on at 10 m/s, crossed without a map"]
    assert set(np.delete(grid, 20, axis=1).flat) == {True}


@pytest.mark.slow
def test_a_verdict_changes_once_along_gap_time_and_place(swept):
    cut_in = swept["cuts in at 10 m/s"]
    steps_out = swept["a person steps out"][1:]
    oncoming = swept["meets an oncoming car"]
    # From left to right the gap grows; from the first row on the person shows earlier, the ego is farther over.
    for line in (*cut_in, *steps_out.T[:, ::-1], *oncoming.T[:, ::-1]):
        told = [bool(verdict) for verdict in line if verdict is not None]
        assert told == sorted(told, reverse=True)
    for grid in (cut_in, steps_out, oncoming):
        assert {True, False} <= set(grid.flat)


@pytest.mark.parametrize("step_us", [20_000, 500_000])
def test_verdicts_do_not_depend_on_how_a_drive_was_sampled(step_us):
    for situation in SITUATIONS:
        hit = contact_of(situation.record(step_us))
        assert (hit.at_fault if hit else None) == situation.at_fault, situation.name


def noisy(poses, generator, size, turn):
    noise = generator.normal(0.0, [size, size, 0.0, turn], (len(poses), 4))
    return poses + noise


def test_noise_of_the_poses_flips_no_verdict():
    generator = np.random.default_rng(5)
    for situation in SITUATIONS:
        record = situation.record()
        agents = tuple(replace(agent, poses=noisy(agent.poses, generator, 0.05, 0.0175)) for agent in record.agents)
        hit = contact_of(replace(record, poses=noisy(record.poses, generator, 0.01, 0.0035), agents=agents))
        assert (hit.at_fault if hit else None) == situation.at_fault, situation.name
