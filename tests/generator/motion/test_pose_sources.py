"""Known poses and MapAnything behind one door."""

import sys
from types import ModuleType

import numpy as np
import pytest
import torch

from olt_generator.cameras import PinholeCamera
from olt_generator.errors import InputError
from olt_generator.motion.map_anything import MapAnything
from olt_generator.motion.pose_sources import KnownPoses, PoseSource
from olt_generator.poses import camera_pose_in_rig, invert, planar_pose
from olt_generator.progress import silent
from olt_generator.trajectory import Trajectory

CAMERA = PinholeCamera(8, 6, 5.0, 5.0, 3.5, 2.5)
MOUNTING = camera_pose_in_rig([1.5, 0.1, 1.4], 0.01, 0.05, -0.02)
COUNT = 12
FRAMES = np.zeros((COUNT, 6, 8, 3), dtype=np.uint8)
TIMES = np.arange(COUNT, dtype=np.int64) * 100_000


def true_motion(times_us=TIMES):
    seconds = times_us * 1e-6
    return Trajectory(times_us, planar_pose(8.0 * seconds, 0.4 * seconds**2, 0.1 * seconds))


def elsewhere(trajectory):
    return Trajectory(trajectory.timestamps_us, planar_pose(4e5, -2e6, 2.5, 30.0) @ trajectory.T_world_rig)


def estimate(source: PoseSource):
    return source(FRAMES, TIMES, CAMERA, MOUNTING, silent)


@pytest.mark.parametrize("of", ["rig", "camera"])
def test_known_poses_are_interpolated_and_start_at_the_identity(of):
    dense = true_motion(np.arange(-1, 24, dtype=np.int64) * 50_000)
    if of == "camera":
        dense = Trajectory(dense.timestamps_us, dense.T_world_rig @ MOUNTING)
    found = estimate(KnownPoses(elsewhere(dense), of))
    np.testing.assert_allclose(found.trajectory.T_world_rig, true_motion().T_world_rig, atol=1e-8)
    assert np.all(found.T_rig_camera == MOUNTING)


@pytest.mark.parametrize("part", [slice(1, None), slice(None, -1)])
def test_known_poses_are_not_extrapolated(part):
    motion = true_motion()
    short = Trajectory(motion.timestamps_us[part], motion.T_world_rig[part])
    with pytest.raises(InputError, match="known poses: they cover"):
        estimate(KnownPoses(short))


def fake_package(monkeypatch, scale=2.5):
    """The documented interface of the package: poses in the first camera's frame, metric scale applied."""
    T_start_camera = invert(MOUNTING) @ true_motion().T_world_rig @ MOUNTING

    class FakeModel:
        @classmethod
        def from_pretrained(cls, path, local_files_only):
            assert local_files_only
            return cls()

        def to(self, device):
            return self

        def eval(self):
            return self

        def infer(self, views, **options):
            assert all(view["img"].shape == (1, 3, 6, 8) for view in views)
            factor = torch.tensor([[scale]])
            poses = torch.from_numpy(T_start_camera).float()
            return [{"camera_poses": pose[None], "metric_scaling_factor": factor} for pose in poses]

    def preprocess_inputs(views):
        for view in views:
            lengths = view["ray_directions"].norm(dim=-1)
            assert lengths.shape == (6, 8)
            torch.testing.assert_close(lengths, torch.ones(6, 8))
        return [{"img": view["img"].permute(2, 0, 1)[None].float(), "data_norm_type": ["dinov2"]} for view in views]

    models, image = ModuleType("mapanything.models"), ModuleType("mapanything.utils.image")
    models.MapAnything, image.preprocess_inputs = FakeModel, preprocess_inputs
    for name in ("mapanything", "mapanything.utils"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setitem(sys.modules, "mapanything.models", models)
    monkeypatch.setitem(sys.modules, "mapanything.utils.image", image)


@pytest.fixture
def weights(tmp_path):
    for name in ("config.json", "model.safetensors"):
        (tmp_path / name).touch()
    return tmp_path


def test_map_anything_gives_the_motion_of_the_rig(monkeypatch, weights):
    fake_package(monkeypatch)
    found = estimate(MapAnything(weights, "cpu"))
    np.testing.assert_allclose(found.trajectory.T_world_rig, true_motion().T_world_rig, atol=1e-5)
    assert found.scale_sigma is None


def test_map_anything_without_a_metric_scale_is_an_error(monkeypatch, weights):
    fake_package(monkeypatch, scale=float("nan"))
    with pytest.raises(InputError, match="no metric scale for frame 0"):
        estimate(MapAnything(weights, "cpu"))


def test_missing_weights_are_an_error(tmp_path):
    with pytest.raises(InputError, match=r"no config\.json and no model\.safetensors"):
        estimate(MapAnything(tmp_path, "cpu"))


def test_a_missing_package_is_an_error(monkeypatch, weights):
    monkeypatch.setitem(sys.modules, "mapanything", None)
    with pytest.raises(InputError, match=r"package mapanything.* is not installed"):
        estimate(MapAnything(weights, "cpu"))
