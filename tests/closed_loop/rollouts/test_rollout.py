"""Rollouts in memory and in files."""

import numpy as np
import pyarrow.parquet as pq
import pytest

from olt_closed_loop.rollouts.rollout import Rollout
from olt_closed_loop.rollouts.rollout_tables import load_rollouts, save_rollouts
from olt_closed_loop.simulation.closed_loop import simulate
from olt_closed_loop.simulation.policies import ConstantVelocityPolicy, StandingPolicy
from olt_closed_loop.simulation.settings import SimulationSettings
from olt_generator.errors import InputError
from olt_toolkit.policy.contract import PlannedTrajectory

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
    save_rollouts(tmp_path / "rollouts.parquet", rollouts)
    loaded = load_rollouts(tmp_path / "rollouts.parquet")
    assert [one.to_dict() for one in loaded] == [one.to_dict() for one in rollouts]
    np.testing.assert_array_equal(loaded[0].states, rollouts[0].states)


@pytest.fixture
def rollout_file(straight_scene, moving_agent, tmp_path):
    scene = straight_scene((moving_agent("follower", (-20.0, 0.0), (10.0, 0.0)),))
    save_rollouts(tmp_path / "rollouts.parquet", [simulate(scene, StandingPolicy(), IDM)])
    (path,) = tmp_path.iterdir()
    return path


def test_damaged_files_of_rollouts(fuzzer, rollout_file):
    fuzzer.run("rollouts", rollout_file)


def test_reacting_agents_survive_a_file(straight_scene, moving_agent, tmp_path):
    scene = straight_scene((moving_agent("follower", (-20.0, 0.0), (10.0, 0.0)),))
    rollout = simulate(scene, StandingPolicy(), IDM)
    save_rollouts(tmp_path / "rollouts.parquet", [rollout])
    (loaded,) = load_rollouts(tmp_path / "rollouts.parquet")
    assert loaded.to_dict() == rollout.to_dict()
    np.testing.assert_array_equal(loaded.reacted[0].poses, rollout.reacted[0].poses)


def test_a_damaged_rollout_file_is_refused(tmp_path):
    path = tmp_path / "rollouts.parquet"
    path.write_text('{"rollouts": [')
    with pytest.raises(InputError, match=r"rollouts\.parquet: not a readable Parquet file"):
        load_rollouts(path)
    with pytest.raises(InputError, match="states"):
        Rollout.from_dict({"controls": [], "timestamps_us": []})


def test_a_row_whose_arrays_do_not_fit_is_refused(straight_scene, tmp_path):
    path = tmp_path / "rollouts.parquet"
    save_rollouts(path, [simulate(straight_scene(), StandingPolicy())])
    table = pq.read_table(path)
    place = table.schema.get_field_index("heights")
    pq.write_table(table.set_column(place, table.schema.field(place), [[[0.0]]]), path)
    with pytest.raises(InputError, match=r"rollouts\.parquet: row 0: states and heights do not fit 81 times"):
        load_rollouts(path)


def test_files_of_rollouts_of_other_versions_and_of_something_else_are_refused(tmp_path):
    path = tmp_path / "rollouts.parquet"
    save_rollouts(path, [])
    assert load_rollouts(path) == []
    table = pq.read_table(path)
    pq.write_table(table.replace_schema_metadata({"olt_rollouts": "4"}), path)
    with pytest.raises(InputError, match=r"rollouts\.parquet: rollouts of version 4, not 3; simulate them again"):
        load_rollouts(path)
    pq.write_table(table.replace_schema_metadata({}), path)
    with pytest.raises(InputError, match="not a file of rollouts"):
        load_rollouts(path)
    pq.write_table(table.drop_columns(["seed"]), path)
    with pytest.raises(InputError, match="columns are not those of rollouts"):
        load_rollouts(path)
    with pytest.raises(InputError, match=r"rollouts\.json: rollouts of version 2 or earlier"):
        load_rollouts(tmp_path / "rollouts.json")


def test_without_timings_equal_rollouts_give_equal_bytes(straight_scene, tmp_path):
    paths = [tmp_path / "one.parquet", tmp_path / "two.parquet"]
    for path in paths:
        save_rollouts(path, [simulate(straight_scene(), StandingPolicy())], timings=False)
    assert paths[0].read_bytes() == paths[1].read_bytes()
    assert load_rollouts(paths[0])[0].timings == {}
