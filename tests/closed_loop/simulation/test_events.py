"""Events of invented scenes: a driver who knows the scene solves each, and one who only follows the route none."""

import pytest

from olt_closed_loop.evaluation.baselines import BASELINES
from olt_closed_loop.evaluation.evaluation import run_closed_loop
from olt_closed_loop.scenes.procedural import CATEGORIES, generate_scene
from olt_closed_loop.scoring.definitions import DEFINITIONS, score_rollout
from olt_closed_loop.simulation.closed_loop import simulate

EVENTS = [category for category in CATEGORIES if category != "nominal"]
SOLVED = 0.5
"""A score that nobody gets who does not get past the event."""


def solved(category, seeds, policy, definition="strict"):
    """The seeds whose event a policy solves."""
    results = run_closed_loop([f"{category}:{seed}" for seed in seeds], policy, 1, definition=definition)
    return [seed for seed, (_, score) in zip(seeds, results, strict=True) if score.score > SOLVED]


def expect_solved_by_who_knows(replay_policy, category, seeds):
    for seed in seeds:
        scene = generate_scene(category, seed)
        score = score_rollout(scene, simulate(scene, replay_policy(scene)))
        assert score.score == 1.0, (scene.name, score.reason, score.progress)


@pytest.mark.parametrize("category", EVENTS)
def test_an_event_is_solved_by_who_knows_it_and_not_by_who_follows_the_route(category, replay_policy):
    assert solved(category, range(4), "route") == []
    expect_solved_by_who_knows(replay_policy, category, range(2))


@pytest.mark.slow
@pytest.mark.parametrize("category", EVENTS)
def test_no_event_of_fifty_is_solved_by_who_follows_the_route(category):
    assert solved(category, range(50), "route") == []


@pytest.mark.slow
@pytest.mark.parametrize("category", EVENTS)
def test_each_event_of_fifty_is_solved_by_who_knows_it(category, replay_policy):
    expect_solved_by_who_knows(replay_policy, category, range(50))


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for label, name in BASELINES.items() if label != "route"])
def test_other_baselines_solve_few_events(name):
    # Where a road bends little, who goes straight on may drift past what stands in the lane.
    for category in EVENTS:
        assert len(solved(category, range(50), name)) <= 10, category


@pytest.mark.slow
@pytest.mark.parametrize("definition", DEFINITIONS[1:])
def test_no_animal_is_solved_along_the_route_by_alpasims_definitions_either(definition):
    assert solved("animal", range(50), "route", definition) == []
