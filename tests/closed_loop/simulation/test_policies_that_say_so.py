"""Policies that say themselves what went wrong, keep limits of time themselves, or hold something open."""

from dataclasses import replace

import pytest

from olt_closed_loop.control.plans import PlanRefused
from olt_closed_loop.evaluation.evaluation import run_closed_loop
from olt_closed_loop.simulation.answers import PolicyFault, PolicyFaulted
from olt_closed_loop.simulation.closed_loop import simulate
from olt_closed_loop.simulation.policies import ConstantVelocityPolicy
from olt_closed_loop.simulation.policy_hosts import PolicyLimits
from olt_closed_loop.simulation.settings import SimulationSettings

SHORT = SimulationSettings(duration_us=3_000_000)
ISOLATE = ["none", "process"]


class Told:
    """Raises what its scene is called."""

    name, cameras, image_size = "told", (), (0, 0)

    def __init__(self, folder):
        self.folder, self.limits = folder, None

    def limit_time(self, call_seconds, start_seconds):
        self.limits = call_seconds, start_seconds

    def reset(self, seed, scene):
        self.scene, self.calls = scene, 0

    def plan(self, observation):
        self.calls += 1
        assert self.limits == (7.0, 8.0)
        if self.calls == 4 and self.scene == "refused":
            raise PlanRefused("no idea")
        if self.calls == 4 and self.scene == "gone":
            raise PolicyFaulted(PolicyFault("policy_deaths", "left", "for good"))
        return ConstantVelocityPolicy().plan(observation)

    def close(self):
        (self.folder / "closed").write_text("closed")


@pytest.mark.parametrize("isolate", ISOLATE)
def test_what_they_say_is_what_is_counted(straight_scene, tmp_path, isolate):
    limits = PolicyLimits(isolate=isolate, call_seconds=7.0, start_seconds=8.0)
    scenes = [replace(straight_scene(), name=name) for name in ("refused", "gone", "fine")]
    results = run_closed_loop(scenes, lambda: Told(tmp_path), 1, settings=replace(SHORT, limits=limits), workers=1)
    refused, gone, fine = (rollout for rollout, _ in results)
    assert (refused.failure, refused.incidents.plans_refused) == (None, 1)
    assert gone.failure_kind == "policy_deaths"
    assert "the policy left at 2.0 s: for good" in gone.failure
    assert fine.failure is None
    assert (tmp_path / "closed").exists()


def test_what_is_lent_is_not_closed(straight_scene, tmp_path):
    policy = Told(tmp_path)
    limits = PolicyLimits(call_seconds=7.0, start_seconds=8.0)
    assert simulate(straight_scene(), policy, replace(SHORT, limits=limits)).failure is None
    assert not (tmp_path / "closed").exists()


class Unbuilt(Told):
    """Says already when it is built that it cannot drive."""

    def __init__(self):
        raise PolicyFaulted(PolicyFault("policy_deaths", "could not be reached"))


@pytest.mark.parametrize("isolate", ISOLATE)
def test_one_that_cannot_be_built_fails_its_rollouts(straight_scene, isolate):
    settings = replace(SHORT, limits=PolicyLimits(isolate=isolate, start_seconds=30.0))
    ((rollout, _),) = run_closed_loop([straight_scene()], Unbuilt, 1, settings=settings, workers=1)
    assert rollout.failure_kind == "policy_deaths"
    assert "could not be reached" in rollout.failure
