"""What the network is given: views in order, ego motion, latents of videos, and the warp as a control."""

import json
from itertools import permutations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from olt_generator.diffusion.backbone import (
    build_autoencoder,
    build_backbone,
    load_autoencoder,
    load_backbone,
    read_config,
)
from olt_generator.diffusion.config import CONFIGS, BackboneConfig, ConditioningConfig, EngineConfig, find_config
from olt_generator.diffusion.geometry_encoder import ego_motion_features
from olt_generator.diffusion.latents import LatentCodec, latent_frames
from olt_generator.diffusion.view_graph import CONDITIONS, VIEWS, order_views
from olt_generator.diffusion.warp_control import cell_visibility, no_warp, vace_control, warp_prior
from olt_generator.errors import InputError
from olt_generator.poses import make_pose
from olt_generator.views.pixel_origin import PixelOrigin

TINY = CONFIGS["tiny"]


def test_views_are_made_after_what_they_depend_on_in_any_order_of_asking():
    for wanted in permutations(VIEWS[1:]):
        order = order_views(wanted)
        assert order.views == (1, 2, 3, 4, 5)
        assert not order.helpers and not order.left_out
    for view, conditions in enumerate(CONDITIONS):
        assert all(condition < view for condition in conditions)


def test_only_what_is_needed_is_made():
    cross = order_views([VIEWS[2], VIEWS[1]])
    assert cross.views == (1, 2)
    assert {omission.what for omission in cross.left_out} == set(VIEWS[3:])
    rear_left = order_views([VIEWS[3]])
    assert rear_left.views == (1, 3)
    assert rear_left.helpers == (1,)
    tele = order_views([VIEWS[5]])
    assert tele.views == (1, 2, 3, 4, 5)
    assert tele.helpers == (1, 2, 3, 4)


def test_recorded_views_are_not_made():
    order = order_views([VIEWS[5], VIEWS[3]], given=[VIEWS[0], VIEWS[3], VIEWS[2]])
    assert order.views == (4, 5)
    assert order.helpers == (4,)


@pytest.mark.parametrize(
    ("wanted", "given", "said"),
    [
        ([], VIEWS[:1], "none asked for"),
        (["camera_front_tele_30fov"], VIEWS[:1], "camera_front_tele_30fov asked for"),
        ([VIEWS[1]], [VIEWS[2]], "is not given"),
    ],
)
def test_views_that_cannot_be_are_refused(wanted, given, said):
    with pytest.raises(InputError, match=said):
        order_views(wanted, given)


def test_ego_motion_is_the_step_in_the_old_axes():
    """Driving 2 m along +z of a camera that turns by 0.1 rad about its y axis each time."""
    turn = Rotation.from_rotvec([0.0, 0.1, 0.0]).as_matrix()
    step = make_pose(turn, [0.0, 0.0, 2.0])
    poses = np.stack([np.linalg.matrix_power(step, n) for n in range(5)])
    features = ego_motion_features(poses)
    assert features.shape == (5, 6)
    assert not features[0].any()
    np.testing.assert_allclose(features[1:], [[0.0, 0.0, 2.0, 0.0, 0.1, 0.0]] * 4, atol=1e-6)
    assert not ego_motion_features(np.repeat(poses[2:3], 4, axis=0)).any()
    assert ego_motion_features(poses[:1]).shape == (1, 6)


def test_a_memory_layer_that_there_is_not_is_refused():
    with pytest.raises(InputError, match="30 is none of the 30 blocks"):
        EngineConfig(conditioning=ConditioningConfig(memory_layers=(4, 30)))
    with pytest.raises(InputError, match=r"choose from 1\.3B, tiny"):
        find_config("14B")


@pytest.mark.parametrize(("frames", "expected"), [(1, 1), (5, 2), (41, 11)])
def test_four_frames_are_one_latent_but_for_the_first(frames, expected):
    assert latent_frames(frames) == expected


@pytest.mark.parametrize(("frames", "said"), [(40, "to 37 or give 41"), (0, "to 1"), (4, "to 1 or give 5")])
def test_frames_that_would_be_dropped_are_refused(frames, said):
    with pytest.raises(InputError, match=said):
        latent_frames(frames)


@pytest.fixture(scope="module")
def codec():
    torch.manual_seed(0)
    return LatentCodec(build_autoencoder(TINY.autoencoder))


def test_videos_go_to_latents_and_back_in_size(codec):
    video = torch.randint(0, 256, (2, 9, 32, 48, 3), dtype=torch.uint8)
    latents = codec.encode(video)
    assert latents.shape == (2, 16, 3, 4, 6)
    decoded = codec.decode(latents)
    assert decoded.shape == video.shape and decoded.dtype == torch.uint8
    assert not any(parameter.requires_grad for parameter in codec.autoencoder.parameters())


def test_latents_are_normalised_by_the_statistics_of_the_configuration(codec):
    from diffusers.models.autoencoders.autoencoder_kl_wan import AutoencoderKLWan

    mean, spread = torch.linspace(-1.0, 1.0, 16), torch.linspace(0.5, 3.0, 16)
    other = AutoencoderKLWan(
        **TINY.autoencoder.to_diffusers() | {"latents_mean": mean.tolist(), "latents_std": spread.tolist()}
    )
    other.load_state_dict(codec.autoencoder.state_dict())
    video = torch.randint(0, 256, (1, 5, 16, 16, 3), dtype=torch.uint8)
    raw, normalised = codec.encode(video), LatentCodec(other).encode(video)
    torch.testing.assert_close(normalised * spread[:, None, None, None] + mean[:, None, None, None], raw)
    assert (LatentCodec(other).decode(normalised).int() - codec.decode(raw).int()).abs().max() <= 1


@pytest.mark.parametrize(
    ("size", "said"), [((1, 8, 16, 16, 3), "to 5 or give 9"), ((1, 5, 24, 16, 3), "16 x 24 pixels")]
)
def test_videos_that_do_not_fit_are_refused(codec, size, said):
    with pytest.raises(InputError, match=said):
        codec.encode(torch.zeros(size, dtype=torch.uint8))


def test_only_what_was_seen_is_in_the_prior():
    origin = np.array([[[PixelOrigin.INVENTED, PixelOrigin.SAME_FRAME, PixelOrigin.OTHER_FRAME, PixelOrigin.UNSEEN]]])
    images = np.full((1, 1, 4, 3), 200, np.uint8)
    video, visible = warp_prior(images, origin.astype(np.uint8))
    assert visible.tolist() == [[[0.0, 1.0, 1.0, 0.0]]]
    assert (video[0, 0, :, 0] == [0, 200, 200, 0]).all()
    filled, visible = warp_prior(images, origin.astype(np.uint8), fill=True)
    assert visible.tolist() == [[[0.0, 1.0, 1.0, 0.0]]] and (filled == 200).all()
    _, same = warp_prior(images, origin.astype(np.uint8), other_frames=False)
    assert same.tolist() == [[[0.0, 1.0, 0.0, 0.0]]]
    _, trusted = warp_prior(images, origin.astype(np.uint8), confidence=np.full((1, 1, 4), 0.25, np.float32))
    assert trusted.tolist() == [[[0.0, 0.25, 0.25, 0.0]]]


def test_a_cell_is_as_visible_as_its_best_frame():
    visible = torch.zeros(1, 9, 16, 8)
    visible[0, 0, :8, :4] = 1.0
    visible[0, 2, 8:, :] = 1.0
    visible[0, 8, 8:, :2] = 1.0
    cells = cell_visibility(visible)
    assert cells.shape == (1, 1, 3, 2, 1)
    assert cells[0, 0, :, :, 0].tolist() == [[0.5, 0.0], [0.0, 1.0], [0.0, 0.25]]
    with pytest.raises(InputError, match="cut the video to 5"):
        cell_visibility(visible[:, :8])


def test_the_control_holds_warp_and_mask_where_each_layout_has_them():
    warped = torch.randn(1, 16, 2, 4, 4)
    visibility = torch.rand(1, 1, 2, 4, 4)
    released = vace_control(warped, visibility)
    assert released.shape == (1, 96, 2, 4, 4)
    assert not released[:, :16].any()
    assert torch.equal(released[:, 16:32], warped)
    assert torch.equal(released[:, 32:], visibility.expand(-1, 64, -1, -1, -1))
    outpainting = vace_control(warped, visibility, "outpainting")
    assert torch.equal(outpainting[:, :16], warped)
    assert not outpainting[:, 16:32].any()
    assert torch.equal(outpainting[:, 32:], 1.0 - released[:, 32:])
    assert not no_warp(warped).any()


def test_a_local_folder_gives_the_same_networks(tmp_path, codec):
    torch.manual_seed(4)
    backbone = build_backbone(TINY.backbone)
    backbone.save_pretrained(tmp_path / "transformer")
    codec.autoencoder.save_pretrained(tmp_path / "vae")
    loaded = load_backbone(tmp_path)
    assert read_config(loaded) == TINY.backbone
    assert all(torch.equal(value, loaded.state_dict()[name]) for name, value in backbone.state_dict().items())
    half = load_backbone(tmp_path, dtype=torch.bfloat16)
    assert half.blocks[0].ffn.net[2].weight.dtype == torch.bfloat16
    assert half.blocks[0].scale_shift_table.dtype == torch.float32
    video = torch.zeros(1, 5, 16, 16, 3, dtype=torch.uint8)
    assert torch.equal(LatentCodec(load_autoencoder(tmp_path)).encode(video), codec.encode(video))


def test_folders_of_other_networks_are_refused(tmp_path):
    with pytest.raises(InputError, match="no such folder"):
        load_backbone(tmp_path / "none")
    with pytest.raises(InputError, match=r"transformer/config\.json is missing"):
        load_backbone(tmp_path)
    build_backbone(TINY.backbone).save_pretrained(tmp_path / "transformer")
    path = tmp_path / "transformer/config.json"
    config = json.loads(path.read_text())
    path.write_text(json.dumps(config | {"num_layers": 7}))
    with pytest.raises(InputError, match="tensors of WanVACETransformer3DModel are missing"):
        load_backbone(tmp_path)
    path.write_text(json.dumps(config | {"vace_in_channels": 48}))
    with pytest.raises(InputError, match=r"cannot be loaded|vace_in_channels"):
        load_backbone(tmp_path)


def test_the_defaults_are_those_of_the_paper():
    backbone = BackboneConfig()
    assert (backbone.dim, backbone.layers, len(backbone.vace_layers)) == (1536, 30, 15)
    assert ConditioningConfig().memory_layers == (4, 9, 14, 19, 24, 29)
