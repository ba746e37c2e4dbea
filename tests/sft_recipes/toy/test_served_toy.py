"""A toy checkpoint as a driver of AlpaSim: over loopback it plans as it does here."""

import numpy as np
import pytest
import torch

from olt_closed_loop.drivers.driver_service import DriverService
from olt_closed_loop.drivers.remote_driver import load_grpc
from olt_closed_loop.drivers.server import serving
from olt_closed_loop.simulation.policy_hosts import PolicyLimits
from olt_generator.poses import planar_pose
from olt_sft_recipes.toy.checkpoint import ToyModel, save_model
from olt_sft_recipes.toy.policy import load_toy
from olt_toolkit.policy.contract import Observation


@pytest.fixture(scope="module")
def checkpoint(tiny_config, tmp_path_factory):
    torch.manual_seed(0)
    folder = tmp_path_factory.mktemp("toy")
    save_model(folder, ToyModel(tiny_config))
    return folder


def observe(policy, step, seed):
    history = planar_pose(0.8 * np.arange(-15, 1), 0.0, 0.0)
    images = np.random.default_rng(3).integers(0, 255, (len(policy.cameras), 1, 3, *policy.image_size), np.uint8)
    return Observation(
        images=np.repeat(images, 4, axis=1),
        camera_indices=np.arange(len(policy.cameras)),
        history_xyz=history[:, :3, 3],
        history_rotation=history[:, :3, :3],
        route_xy=np.zeros((0, 2)),
        time_us=2_000_000 + step * 100_000,
        seed=seed,
    )


def test_it_plans_over_loopback_as_here(checkpoint):
    here = load_toy(str(checkpoint))
    asked = []
    plan = type(here).plan

    def keep_seed(policy, observation):
        asked.append(observation.seed)
        return plan(policy, observation)

    with (
        pytest.MonkeyPatch.context() as patch,
        serving(DriverService(f"toy:{checkpoint}", limits=PolicyLimits(isolate="none"))) as port,
    ):
        patch.setattr(type(here), "plan", keep_seed)
        far = load_grpc(f"//127.0.0.1:{port}?images=png")
        assert (far.cameras, far.image_size) == (here.cameras, here.image_size)
        far.reset(1, "scene")
        plans = [far.plan(observe(here, step, 0)) for step in range(3)]
        far.close()
    assert len(set(asked)) == 3
    for step, answer in enumerate(plans):
        meant = plan(here, observe(here, step, asked[step]))
        np.testing.assert_allclose(answer.xyz, meant.xyz, atol=1e-3)
        np.testing.assert_allclose(answer.rotation, meant.rotation, atol=1e-4)


def test_the_peers_loop_drives_it(checkpoint):
    testing = pytest.importorskip("carla_driver_interface.testing", reason="needs the package carla-driver-interface")
    cameras = tuple(testing.FakeCamera(name, width=48, height=24) for name in load_toy(str(checkpoint)).cameras)
    with (
        serving(DriverService(f"toy:{checkpoint}")) as port,
        testing.FakeLoop(f"127.0.0.1:{port}", cameras, initial_speed_mps=6.0) as loop,
    ):
        result = loop.run(10)
    assert result.steps == 10
    assert np.isfinite(result.speeds_mps).all()
    assert result.speeds_mps[-1] > 0.0
