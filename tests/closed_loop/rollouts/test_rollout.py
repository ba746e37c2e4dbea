"""Rollouts in memory and in files."""

import json

import numpy as np
import pytest

from olt_closed_loop.rollouts.rollout import Rollout, load_rollouts, save_rollouts
from olt_closed_loop.simulation.closed_loop import simulate
from olt_closed_loop.simulation.policies import ConstantVelocityPolicy, StandingPolicy
from olt_closed_loop.simulation.settings import SimulationSettings
from olt_generator.errors import InputError
from olt_toolkit.policy.contract import PlannedTrajectory

from ...fuzzing import SECONDS

IDM = SimulationSettings(traffic="idm")


class Refused:
    """Goes on at constant velocity, but for a while plans nothing that can be followed."""

    name, cameras, image_size = "refused", (), (0, 0)

    def plan(self, observation):
        plan = ConstantVelocityPolicy().plan(observation)
        refused = 2_100_000 <= observation.time_us < 2_500_000
        return PlannedTrajectory(np.full_like(plan.xyz, np.nan), plan.rotation) if refused else plan


class Raising(Refused):
    def plan(self, observation):
        if observation.time_us == 2_600_000:
            raise InputError("no idea")
        return super().plan(observation)


def test_rollouts_survive_a_file(straight_scene, tmp_path):
    rollouts = [simulate(straight_scene(), Refused(), seed=1), simulate(straight_scene(), Raising())]
    save_rollouts(tmp_path / "rollouts.json", rollouts)
    loaded = load_rollouts(tmp_path / "rollouts.json")
    assert [one.to_dict() for one in loaded] == [one.to_dict() for one in rollouts]
    np.testing.assert_array_equal(loaded[0].states, rollouts[0].states)


@pytest.fixture
def rollout_file(straight_scene, moving_agent, tmp_path):
    scene = straight_scene((moving_agent("follower", (-20.0, 0.0), (10.0, 0.0)),))
    save_rollouts(tmp_path / "rollouts.json", [simulate(scene, StandingPolicy(), IDM)])
    (path,) = tmp_path.iterdir()
    return path


def test_damaged_files_of_rollouts(fuzzer, rollout_file):
    fuzzer.run("rollouts", rollout_file)


@pytest.mark.slow
def test_damaged_files_of_rollouts_for_long(fuzzer, rollout_file):
    fuzzer.run("rollouts", rollout_file, seconds=SECONDS)


def test_reacting_agents_survive_a_file(straight_scene, moving_agent, tmp_path):
    scene = straight_scene((moving_agent("follower", (-20.0, 0.0), (10.0, 0.0)),))
    rollout = simulate(scene, StandingPolicy(), IDM)
    save_rollouts(tmp_path / "rollouts.json", [rollout])
    (loaded,) = load_rollouts(tmp_path / "rollouts.json")
    assert loaded.to_dict() == rollout.to_dict()
    np.testing.assert_array_equal(loaded.reacted[0].poses, rollout.reacted[0].poses)


def test_a_damaged_rollout_file_is_refused(tmp_path):
    path = tmp_path / "rollouts.json"
    path.write_text('{"rollouts": [')
    with pytest.raises(InputError, match=r"rollouts\.json"):
        load_rollouts(path)
    with pytest.raises(InputError, match="states"):
        Rollout.from_dict({"controls": [], "timestamps_us": []})


def test_a_file_of_rollouts_of_another_version_is_refused(tmp_path):
    save_rollouts(tmp_path / "rollouts.json", [])
    assert load_rollouts(tmp_path / "rollouts.json") == []
    for version in ({}, {"version": 1}, {"version": 3}):
        (tmp_path / "rollouts.json").write_text(json.dumps({**version, "rollouts": []}))
        with pytest.raises(InputError, match=r"rollouts\.json: rollouts of version \d, not 2; simulate them again"):
            load_rollouts(tmp_path / "rollouts.json")
