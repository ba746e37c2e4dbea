"""Recorded drives of public data sets in the closed loop: replayed to a perfect score, and driven by policies."""

import numpy as np
import pytest

from olt_closed_loop.evaluation.gate import check_gate
from olt_closed_loop.scenes.scene_file import read_scene, write_scene
from olt_closed_loop.scenes.sources import find_recordings, read_recording
from olt_closed_loop.scoring.definitions import score_rollout
from olt_closed_loop.simulation.closed_loop import simulate
from olt_closed_loop.simulation.policies import make_policy
from olt_closed_loop.simulation.settings import SimulationSettings

AGENTS = {
    "argoverse2_sensor_log_7fab2350": 114,
    "argoverse2_motion_scenario_0a1e6f0a": 47,
    "nuscenes_scene_0061_six_cameras": 225,
    "nuscenes_logged_scenarios/scene-0553.json.gz": 56,
    "nuscenes_logged_scenarios/scene-0655.json.gz": 140,
    "nuscenes_logged_scenarios/scene-0796.json.gz": 51,
    "nuscenes_logged_scenarios/scene-1077.json.gz": 72,
}
RECORDINGS = [name if name.startswith("argoverse2") else pytest.param(name, marks=pytest.mark.slow) for name in AGENTS]


@pytest.fixture(scope="module", params=RECORDINGS)
def recording(request, shared_real):
    return shared_real / request.param, AGENTS[request.param]


@pytest.fixture(scope="module")
def scene(recording):
    return read_recording(recording[0])


def test_everything_of_known_size_is_an_agent(recording, scene):
    assert len(scene.agents) == recording[1]
    assert all(agent.poses.shape == (len(agent.timestamps_us), 4) for agent in scene.agents)


def test_the_ego_does_not_slide_sideways(scene):
    """Its positions are those of the rear axle, and its heading is where it goes."""
    poses = scene.ego.T_world_rig
    velocity = np.gradient(poses[:, :2, 3], scene.ego.times, axis=0)
    sideways = np.einsum("ni,ni->n", velocity, poses[:, :2, 1])
    assert np.sqrt(np.mean(sideways**2)) < 0.1


def test_the_gate_holds(scene):
    result = check_gate(scene)
    assert result.passed, result.failed
    assert result.checks[0].passed
    assert all(place.metres > 0.1 for place in result.narrow)


def test_a_scene_file_keeps_the_scene(scene, tmp_path):
    again = read_scene(write_scene(scene, tmp_path / "scene.usdc"))
    np.testing.assert_allclose(again.ego.T_world_rig, scene.ego.T_world_rig, rtol=0, atol=1e-9)
    assert [agent.id for agent in again.agents] == [agent.id for agent in scene.agents]
    assert check_gate(again).checks == check_gate(scene).checks


@pytest.mark.parametrize("policy", ["constant_velocity", "route"])
def test_baseline_policies_drive_it(scene, policy):
    rollout = simulate(scene, make_policy(policy))
    score = score_rollout(scene, rollout)
    assert score.valid and 0.0 <= score.score <= 1.0
    assert rollout.incidents.plans_refused == 0
    assert len(rollout.timestamps_us) == min(200, int(scene.ego.times[-1] * 10 + 1e-6)) + 1


def test_nobody_drives_into_a_standing_ego_that_they_can_see(scene):
    settings = SimulationSettings(traffic="idm")
    rollout = simulate(scene, make_policy("standing"), settings)
    score = score_rollout(scene, rollout)
    assert score.valid and not any(hit.side == "rear" for hit in score.collisions)


def test_routes_lead_the_way_that_was_driven(scene):
    distances = np.linalg.norm(scene.ego.positions[:, None, :2] - scene.route[None, :, :2], axis=-1).min(axis=1)
    assert distances.max() < 0.25
    assert np.linalg.norm(np.diff(scene.route[:, :2], axis=0), axis=1).sum() >= scene.ego.path_length + 350.0


def test_a_folder_of_four_scenarios(shared_real):
    found = find_recordings(shared_real / "nuscenes_logged_scenarios")
    assert [path.name for path in found] == [name.rpartition("/")[2] for name in AGENTS if "logged" in name]
