"""LPIPS and LoFTR with tiny random networks under the published tensor names."""

from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from olt_generator.errors import InputError
from olt_generator.metrics.lpips import Lpips
from olt_generator.metrics.weight_files import read_weights
from olt_generator.seeds import make_generator

CHANNELS = 2


def noise(*shape: int) -> np.ndarray:
    return make_generator("learned", *shape).integers(0, 256, shape).astype(np.uint8)


def random_tensor(*shape: int) -> torch.Tensor:
    values = make_generator("tensor", *shape).normal(0.0, 1.0 / np.sqrt(np.prod(shape[1:])), shape)
    return torch.from_numpy(values.astype(np.float32))


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


def test_weights_are_read_from_both_formats_and_nothing_is_executed(tmp_path):
    tensors = {"layer.weight": random_tensor(3, 2)}
    save_file(tensors, tmp_path / "a.safetensors")
    torch.save(tensors, tmp_path / "b.pth")
    torch.save({"state_dict": tensors}, tmp_path / "c.ckpt")
    for name in ("a.safetensors", "b.pth", "c.ckpt"):
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
