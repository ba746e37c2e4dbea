"""LPIPS, LoFTR and the features of FID and FVD with tiny random networks under the published tensor names."""

from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from olt_generator.errors import InputError
from olt_generator.metrics.i3d_features import I3dFeatures
from olt_generator.metrics.inception_features import InceptionFeatures
from olt_generator.metrics.lpips import Lpips
from olt_generator.metrics.weight_files import read_weights
from olt_generator.seeds import make_generator

CHANNELS = 2


def noise(*shape: int) -> np.ndarray:
    return make_generator("learned", *shape).integers(0, 256, shape).astype(np.uint8)


def random_tensor(*shape: int) -> torch.Tensor:
    values = make_generator("tensor", *shape).normal(0.0, 1.0 / np.sqrt(np.prod(shape[1:])), shape)
    return torch.from_numpy(values.astype(np.float32))


def unit(kind: str, name: str, inputs: int, *kernel: int) -> dict[str, torch.Tensor]:
    """Tensors of one convolution with normalisation."""
    tensors = {f"{name}.{kind}.weight": random_tensor(CHANNELS, inputs, *kernel)}
    for part in ("running_mean", "bias"):
        tensors[f"{name}.bn.{part}"] = 0.1 * random_tensor(CHANNELS, 1)[:, 0]
    for part in ("running_var", "weight"):
        tensors[f"{name}.bn.{part}"] = torch.ones(CHANNELS)
    return tensors


def lpips_folder(folder: Path) -> Path:
    sizes = {0: (3, 11), 3: (CHANNELS, 5), 6: (CHANNELS, 3), 8: (CHANNELS, 3), 10: (CHANNELS, 3)}
    backbone, heads = {}, {}
    for layer, (index, (inputs, side)) in enumerate(sizes.items()):
        backbone[f"features.{index}.weight"] = random_tensor(CHANNELS, inputs, side, side)
        backbone[f"features.{index}.bias"] = torch.zeros(CHANNELS)
        heads[f"lin{layer}.model.1.weight"] = torch.full((1, CHANNELS, 1, 1), 0.5)
    torch.save(backbone, folder / "alexnet-tiny.pth")
    save_file(heads, folder / "alex.safetensors")
    return folder


def inception_weights() -> dict[str, torch.Tensor]:
    c = CHANNELS
    tensors = unit("conv", "Conv2d_1a_3x3", 3, 3, 3)
    for name, side in (("Conv2d_2a_3x3", 3), ("Conv2d_2b_3x3", 3), ("Conv2d_3b_1x1", 1), ("Conv2d_4a_3x3", 3)):
        tensors |= unit("conv", name, c, side, side)

    def block(name: str, inputs: int, first: str, chains: dict[str, tuple[tuple[int, int], ...]]) -> None:
        """`first` names the branches that read the block's input; the others read the branch before them."""
        for branch, kernels in chains.items():
            for step, kernel in enumerate(kernels, start=1):
                suffix = f"_{step}" if len(kernels) > 1 else ""
                reads = inputs if step == 1 or first == "all" else c
                tensors.update(unit("conv", f"{name}.{branch}{suffix}", reads, *kernel))

    one, three, five, wide, tall = (1, 1), (3, 3), (5, 5), (1, 7), (7, 1)
    for name, inputs in (("Mixed_5b", c), ("Mixed_5c", 4 * c), ("Mixed_5d", 4 * c)):
        chains = {"branch1x1": (one,), "branch5x5": (one, five), "branch3x3dbl": (one, three, three)}
        block(name, inputs, "", chains | {"branch_pool": (one,)})
    block("Mixed_6a", 4 * c, "", {"branch3x3": (three,), "branch3x3dbl": (one, three, three)})
    for name, inputs in (("Mixed_6b", 6 * c), ("Mixed_6c", 4 * c), ("Mixed_6d", 4 * c), ("Mixed_6e", 4 * c)):
        chains = {"branch1x1": (one,), "branch7x7": (one, wide, tall), "branch7x7dbl": (one, tall, wide, tall, wide)}
        block(name, inputs, "", chains | {"branch_pool": (one,)})
    block("Mixed_7a", 4 * c, "", {"branch3x3": (one, three), "branch7x7x3": (one, wide, tall, three)})
    for name in ("Mixed_7b", "Mixed_7c"):
        block(name, 6 * c, "all", {"branch1x1": (one,), "branch_pool": (one,)})
        tensors |= unit("conv", f"{name}.branch3x3_1", 6 * c, 1, 1)
        tensors |= unit("conv", f"{name}.branch3x3dbl_1", 6 * c, 1, 1)
        tensors |= unit("conv", f"{name}.branch3x3dbl_2", c, 3, 3)
        for branch in ("branch3x3_2", "branch3x3dbl_3"):
            tensors |= unit("conv", f"{name}.{branch}a", c, 1, 3)
            tensors |= unit("conv", f"{name}.{branch}b", c, 3, 1)
    return tensors


def i3d_weights(classes: int) -> dict[str, torch.Tensor]:
    c = CHANNELS
    tensors = unit("conv3d", "Conv3d_1a_7x7", 3, 7, 7, 7)
    tensors |= unit("conv3d", "Conv3d_2b_1x1", c, 1, 1, 1) | unit("conv3d", "Conv3d_2c_3x3", c, 3, 3, 3)
    for block in ("3b", "3c", "4b", "4c", "4d", "4e", "4f", "5b", "5c"):
        inputs = c if block == "3b" else 4 * c
        for branch in ("b0", "b1a", "b2a", "b3b"):
            tensors |= unit("conv3d", f"Mixed_{block}.{branch}", inputs, 1, 1, 1)
        for branch in ("b1b", "b2b"):
            tensors |= unit("conv3d", f"Mixed_{block}.{branch}", c, 3, 3, 3)
    tensors["logits.conv3d.weight"] = random_tensor(classes, 4 * c, 1, 1, 1)
    tensors["logits.conv3d.bias"] = torch.arange(classes, dtype=torch.float32)
    return tensors


def test_lpips_is_zero_for_equal_images_and_grows_with_the_difference(tmp_path):
    measure = Lpips(lpips_folder(tmp_path))
    image = noise(64, 96, 3) // 2 + 60
    slightly, strongly = (
        np.clip(image + make_generator(scale).normal(0, scale, image.shape), 0, 255).astype(np.uint8)
        for scale in (4, 60)
    )
    assert measure(image, image) == 0.0
    assert 0.0 < measure(image, slightly) < measure(image, strongly)
    assert measure(image, strongly) == pytest.approx(measure(strongly, image))
    assert "alexnet-tiny.pth" in measure.name


def test_lpips_refuses_what_it_cannot_measure(tmp_path):
    with pytest.raises(InputError, match="alexnet-owt"):
        Lpips(tmp_path)
    measure = Lpips(lpips_folder(tmp_path))
    with pytest.raises(InputError, match="one size"):
        measure(noise(64, 64, 3), noise(64, 65, 3))
    with pytest.raises(InputError, match="63 pixels"):
        measure(noise(40, 64, 3), noise(40, 64, 3))
    save_file({"other": torch.zeros(1)}, tmp_path / "alex.safetensors")
    with pytest.raises(InputError, match=r"lin0\.model\.1\.weight"):
        Lpips(tmp_path)


def test_inception_features_follow_the_image(tmp_path):
    path = tmp_path / "inception.safetensors"
    save_file(inception_weights(), path)
    images = noise(2, 50, 80, 3)
    features = InceptionFeatures(path)(images)
    assert features.shape == (2, 6 * CHANNELS)
    assert features.dtype == np.float64
    assert not np.allclose(features[0], features[1])
    np.testing.assert_array_equal(InceptionFeatures(path)(images[1:]), features[1:])


@pytest.mark.slow
def test_i3d_features_are_class_scores_of_each_clip(tmp_path):
    path = tmp_path / "i3d.pt"
    torch.save({"state_dict": i3d_weights(classes=7)}, path)
    clips = noise(2, 9, 40, 60, 3)
    features = I3dFeatures(path)(clips)
    assert features.shape == (2, 7)
    assert not np.allclose(features[0], features[1])
    black = I3dFeatures(path)(np.zeros((1, 9, 40, 60, 3), np.uint8))
    assert not np.allclose(black, features[:1])
    with pytest.raises(InputError, match="at least 9"):
        I3dFeatures(path)(clips[:, :8])


def test_a_tensor_of_another_network_is_named(tmp_path):
    path = tmp_path / "wrong.safetensors"
    save_file({"features.0.weight": torch.zeros(1)}, path)
    with pytest.raises(InputError, match=r"Conv2d_1a_3x3\.conv\.weight"):
        InceptionFeatures(path)(noise(1, 20, 20, 3))
    with pytest.raises(InputError, match=r"Conv3d_1a_7x7\.conv3d\.weight"):
        I3dFeatures(path)(noise(1, 9, 20, 20, 3))


def test_weights_are_read_from_both_formats_and_nothing_is_executed(tmp_path):
    tensors = {"layer.weight": random_tensor(3, 2)}
    save_file(tensors, tmp_path / "a.safetensors")
    torch.save(tensors, tmp_path / "b.pth")
    for name in ("a.safetensors", "b.pth"):
        assert torch.equal(read_weights(tmp_path / name)["layer.weight"], tensors["layer.weight"])
    torch.save({"layer.weight": Path("anything")}, tmp_path / "object.pth")
    torch.save([1, 2], tmp_path / "list.pth")
    for name in ("object.pth", "list.pth"):
        with pytest.raises(InputError, match="tensors"):
            read_weights(tmp_path / name)
    for name in ("cut.safetensors", "cut.pth"):
        (tmp_path / name).write_bytes(b"\x00" * 20)
        with pytest.raises(InputError, match=name):
            read_weights(tmp_path / name)
    with pytest.raises(InputError, match="no such weights file"):
        read_weights(tmp_path / "none.pth")


@pytest.mark.slow
def test_loftr_runs_from_a_local_file(tmp_path):
    from kornia.feature import LoFTR

    from olt_generator.metrics.loftr import LoftrMatcher

    torch.manual_seed(0)
    torch.save({"state_dict": LoFTR(pretrained=None).state_dict()}, tmp_path / "loftr.ckpt")
    matcher = LoftrMatcher(tmp_path / "loftr.ckpt")
    matches = matcher.match(noise(64, 96, 3), noise(64, 96, 3))
    assert matches.pixels_a.shape == matches.pixels_b.shape == (len(matches), 2)
    assert matcher.name == "LoFTR (loftr.ckpt), confidence 0.6"
    save_file({"other": torch.zeros(1)}, tmp_path / "other.safetensors")
    with pytest.raises(InputError, match="LoFTR"):
        LoftrMatcher(tmp_path / "other.safetensors")
