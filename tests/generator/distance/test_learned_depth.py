"""Depth by networks: loading from folders, inference on tiny random networks, and the alignment to metres."""

import json

import numpy as np
import pytest

from olt_generator.cameras import PinholeCamera, pixel_rays
from olt_generator.distance.depth import DistanceOrigin, estimate_distance
from olt_generator.distance.depth_anything import DepthAnything
from olt_generator.distance.depth_crafter import FILES, DepthCrafter, DiffusionSettings
from olt_generator.distance.depth_source import RelativeDepth
from olt_generator.distance.metric_alignment import align_affine
from olt_generator.errors import InputError
from olt_generator.poses import camera_pose_in_rig, planar_pose
from olt_generator.seeds import make_generator
from olt_generator.trajectory import Trajectory
from olt_toolkit.benchmarks.street import render_street

CAMERA = PinholeCamera.from_field_of_view(128, 72, float(np.radians(90.0)))
T_RIG_CAMERA = camera_pose_in_rig([1.7, 0.0, 1.5], 0.0, 0.03, 0.0)
INDEX = np.arange(6)
DRIVE = Trajectory(100_000 * INDEX, planar_pose(1.6 * INDEX, 0.0, 0.0))


@pytest.fixture(scope="module")
def rendered() -> tuple[np.ndarray, np.ndarray]:
    images, distance = zip(*(render_street(CAMERA, pose @ T_RIG_CAMERA) for pose in DRIVE.T_world_rig), strict=True)
    return np.stack(images), np.stack(distance)


def true_relative_depth(distance: np.ndarray) -> np.ndarray:
    """What a perfect network would say: inverse depth, up to scale and shift."""
    return (7.0 / (distance * pixel_rays(CAMERA)[..., 2]) + 0.3).astype(np.float32)


def test_alignment_recovers_scale_and_shift_among_outliers():
    generator = make_generator("alignment")
    inverse = generator.uniform(0.02, 0.3, 3000)
    relative = (inverse - 0.01) / 0.05
    relative[::4] = generator.uniform(0.0, 6.0, len(relative[::4]))
    alignment = align_affine(relative, inverse)
    assert alignment.scale == pytest.approx(0.05, rel=0.02)
    assert alignment.shift == pytest.approx(0.01, abs=0.002)
    assert alignment.residual < 0.02
    assert 0.75 < alignment.agreement < 0.9


def test_alignment_refuses_what_cannot_be_made_metric():
    inverse = np.linspace(0.02, 0.3, 1000)
    with pytest.raises(InputError, match="pixels of known distance"):
        align_affine(inverse[:10], inverse[:10])
    with pytest.raises(InputError, match="do not grow"):
        align_affine(-inverse, inverse)


def test_a_perfect_relative_network_gives_metres(rendered):
    frames, distance = rendered

    class PerfectNetwork(RelativeDepth):
        def relative_inverse_depth(self, frames, wanted):
            return true_relative_depth(distance)[wanted]

    estimate = PerfectNetwork()(frames, CAMERA, DRIVE, T_RIG_CAMERA, frame_indices=[2, 4])
    truth = distance[[2, 4]]
    near = truth < 60.0
    assert estimate.distance.shape == (2, 72, 128)
    assert np.median(np.abs(estimate.distance[near] - truth[near]) / truth[near]) < 0.05
    assert set(np.unique(estimate.origin)) == {DistanceOrigin.LEARNED}
    assert estimate.alignment is not None and estimate.alignment.residual < 0.05
    assert estimate.confidence.max() == pytest.approx(estimate.alignment.agreement)


def test_distance_by_geometry_is_not_aligned(rendered):
    frames, _ = rendered
    estimate = estimate_distance(frames, CAMERA, DRIVE, T_RIG_CAMERA, frame_indices=[1])
    assert estimate.distance.shape == (1, 72, 128) and estimate.alignment is None


def test_missing_folders_and_files_are_named(tmp_path):
    with pytest.raises(InputError, match="no such folder"):
        DepthAnything(tmp_path / "absent")
    with pytest.raises(InputError, match=r"model\.safetensors is missing"):
        (tmp_path / "config.json").write_text("{}")
        DepthAnything(tmp_path)
    with pytest.raises(InputError, match=r"unet/config\.json is missing"):
        DepthCrafter(tmp_path)
    with pytest.raises(InputError, match="multiples of 64"):
        DiffusionSettings(width=100)


@pytest.fixture(scope="module")
def depth_anything_folder(tmp_path_factory):
    transformers = pytest.importorskip("transformers", reason="the extra `generator` is not installed")
    import torch

    torch.manual_seed(0)
    backbone = transformers.Dinov2Config(
        hidden_size=24,
        num_hidden_layers=4,
        num_attention_heads=2,
        image_size=70,
        patch_size=14,
        out_features=["stage1", "stage2", "stage3", "stage4"],
        reshape_hidden_states=False,
        apply_layernorm=True,
    )
    config = transformers.DepthAnythingConfig(
        backbone_config=backbone,
        patch_size=14,
        reassemble_hidden_size=24,
        neck_hidden_sizes=[8, 8, 8, 8],
        fusion_hidden_size=8,
        head_hidden_size=8,
    )
    folder = tmp_path_factory.mktemp("depth_anything")
    transformers.DepthAnythingForDepthEstimation(config).save_pretrained(folder)
    return folder


@pytest.mark.slow
def test_depth_anything_runs_from_a_folder(rendered, depth_anything_folder):
    frames, _ = rendered
    network = DepthAnything(depth_anything_folder, shorter_side=70)
    (values,) = network.relative_inverse_depth(frames, np.array([0]))
    assert values.shape == (70, 126) and values.dtype == np.float32
    assert np.array_equal([values], network.relative_inverse_depth(frames, np.array([0])))
    assert np.all(np.isfinite(values)) and values.std() > 0.0


@pytest.mark.slow
def test_depth_anything_refuses_other_networks(depth_anything_folder, tmp_path):
    for path in depth_anything_folder.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    config = json.loads((tmp_path / "config.json").read_text())
    (tmp_path / "config.json").write_text(json.dumps(config | {"depth_estimation_type": "metric", "max_depth": 80}))
    with pytest.raises(InputError, match="metric depth"):
        DepthAnything(tmp_path)
    from safetensors.numpy import load_file, save_file

    tensors = load_file(tmp_path / "model.safetensors")
    del tensors[min(name for name in tensors if name.startswith("head"))]
    (tmp_path / "config.json").write_text(json.dumps(config))
    save_file(tensors, tmp_path / "model.safetensors", metadata={"format": "pt"})
    with pytest.raises(InputError, match=r"1 tensors .* are missing"):
        DepthAnything(tmp_path)


@pytest.fixture(scope="module")
def depth_crafter_folder(tmp_path_factory):
    diffusers = pytest.importorskip("diffusers", reason="the extra `generator` is not installed")
    transformers = pytest.importorskip("transformers", reason="the extra `generator` is not installed")
    import torch

    torch.manual_seed(0)
    folder = tmp_path_factory.mktemp("depth_crafter")
    diffusers.UNetSpatioTemporalConditionModel(
        block_out_channels=(32, 64),
        down_block_types=("CrossAttnDownBlockSpatioTemporal", "DownBlockSpatioTemporal"),
        up_block_types=("UpBlockSpatioTemporal", "CrossAttnUpBlockSpatioTemporal"),
        in_channels=8,
        out_channels=4,
        layers_per_block=1,
        num_attention_heads=2,
        cross_attention_dim=32,
        addition_time_embed_dim=32,
        projection_class_embeddings_input_dim=96,
    ).save_pretrained(folder / "unet")
    diffusers.AutoencoderKLTemporalDecoder(
        block_out_channels=(32, 32, 32, 32), down_block_types=("DownEncoderBlock2D",) * 4, latent_channels=4
    ).save_pretrained(folder / "vae")
    transformers.CLIPVisionModelWithProjection(
        transformers.CLIPVisionConfig(
            hidden_size=32,
            projection_dim=32,
            intermediate_size=37,
            num_hidden_layers=2,
            num_attention_heads=2,
            image_size=32,
            patch_size=8,
        )
    ).save_pretrained(folder / "image_encoder")
    diffusers.EulerDiscreteScheduler(
        beta_start=0.00085,
        beta_end=0.012,
        beta_schedule="scaled_linear",
        prediction_type="v_prediction",
        use_karras_sigmas=True,
        sigma_min=0.002,
        sigma_max=700.0,
        timestep_type="continuous",
        interpolation_type="linear",
        steps_offset=1,
        timestep_spacing="leading",
    ).save_pretrained(folder / "scheduler")
    return folder


TINY = DiffusionSettings(width=64, height=64, steps=2, window=4, overlap=2)


@pytest.mark.slow
def test_depth_crafter_denoises_a_clip_in_windows(rendered, depth_crafter_folder):
    frames, _ = rendered
    assert all((depth_crafter_folder / name).is_file() for name in FILES)
    values = DepthCrafter(depth_crafter_folder, settings=TINY).relative_inverse_depth(frames, INDEX)
    assert values.shape == (6, 64, 64) and values.dtype == np.float32
    assert values.min() == 0.0 and values.max() == 1.0
    again = DepthCrafter(depth_crafter_folder, settings=TINY).relative_inverse_depth(frames, INDEX[::2])
    assert np.array_equal(values[::2], again)
    other_seed = DepthCrafter(depth_crafter_folder, settings=TINY, seed=1).relative_inverse_depth(frames, INDEX)
    assert not np.array_equal(values, other_seed)


@pytest.mark.slow
def test_every_frame_is_told_of_its_own_embedding(rendered, depth_crafter_folder):
    import torch

    network = DepthCrafter(depth_crafter_folder, settings=TINY)
    generator = torch.Generator().manual_seed(0)
    noise, conditions = (torch.randn((4, 4, 8, 8), generator=generator) for _ in range(2))
    embeddings = torch.randn((4, 32), generator=generator)
    changed = embeddings.clone()
    changed[2] += 3.0
    with torch.inference_mode():
        one = network._denoise_window(noise, noise[:0], conditions, embeddings)
        other = network._denoise_window(noise, noise[:0], conditions, changed)
    difference = (one - other).abs().mean(dim=(1, 2, 3))
    assert difference.argmax() == 2
    assert difference[2] > 0.0


@pytest.mark.slow
def test_clips_of_any_length_are_covered(rendered, depth_crafter_folder):
    frames, _ = rendered
    network = DepthCrafter(depth_crafter_folder, settings=TINY)
    for count in (1, 4, 5):
        assert network.relative_inverse_depth(frames[:count], INDEX[:count]).shape == (count, 64, 64)
