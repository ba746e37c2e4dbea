"""Adapters of others: Wan's own names, every key used, and the same output as the change put into the weights."""

import pytest
import torch
from safetensors.torch import save_file

from olt_generator.diffusion.adapters import load_adapter
from olt_generator.diffusion.backbone import build_backbone
from olt_generator.diffusion.conditioned_model import build_model
from olt_generator.diffusion.config import CONFIGS, LoraConfig
from olt_generator.diffusion.warp_control import no_warp
from olt_generator.errors import InputError

TINY = CONFIGS["tiny"]
DIM, RANK = TINY.backbone.dim, 4
BLOCKS = [*(f"blocks.{n}" for n in range(6)), *(f"vace_blocks.{n}" for n in range(3))]
OWN = {"q": "to_q", "k": "to_k", "v": "to_v", "o": "to_out.0"}


def write_adapter(prefix="", down="lora_a", up="lora_b", suffix="", seed=0):
    """The tensors of an adapter as released: self-attention of all blocks in Wan's own names."""
    generator = torch.Generator().manual_seed(seed)
    tensors = {}
    for block in BLOCKS:
        for name in OWN:
            key = f"{prefix}{block}.self_attn.{name}."
            tensors[f"{key}{down}{suffix}.weight"] = torch.randn(RANK, DIM, generator=generator)
            tensors[f"{key}{up}{suffix}.weight"] = torch.randn(DIM, RANK, generator=generator)
    return tensors


def run(backbone):
    latents = torch.randn(1, 16, 2, 4, 4, generator=torch.Generator().manual_seed(1))
    text = torch.ones(1, 3, TINY.backbone.text_dim)
    with torch.no_grad():
        return backbone(latents, torch.tensor([500.0]), text, control_hidden_states=no_warp(latents)).sample


def merged(tensors, scale, down="lora_a", up="lora_b"):
    """A backbone with the change of the adapter added to its weights."""
    torch.manual_seed(0)
    backbone = build_backbone(TINY.backbone)
    with torch.no_grad():
        for block in BLOCKS:
            for name, layer in OWN.items():
                key = f"{block}.self_attn.{name}."
                change = tensors[f"{key}{up}.weight"] @ tensors[f"{key}{down}.weight"]
                backbone.get_submodule(f"{block}.attn1.{layer}").weight += scale * change
    return backbone


@pytest.fixture
def model():
    torch.manual_seed(0)
    return build_model(TINY, seed=0)


@pytest.mark.parametrize("prefix", ["", "diffusion_model.", "module.expert."])
def test_a_released_adapter_changes_what_it_changes_in_its_own_model(model, tmp_path, prefix):
    backbone = merged(write_adapter(), 16.0 / RANK)
    expected = run(backbone)
    torch.manual_seed(0)
    fresh = build_backbone(TINY.backbone)
    plain = run(fresh)
    torch.save(write_adapter(prefix), tmp_path / "lora.pt")
    assert load_adapter(fresh, tmp_path / "lora.pt") == LoraConfig(RANK, 16.0)
    torch.testing.assert_close(run(fresh), expected, rtol=1e-4, atol=1e-4)
    assert (expected - plain).abs().max() > 0.01


def test_other_spellings_and_scales_of_a_file_are_followed(model, tmp_path):
    expected = run(merged(write_adapter(), 2.0 / RANK))
    tensors = write_adapter("diffusion_model.", "lora_down", "lora_up")
    tensors |= {f"diffusion_model.{b}.self_attn.{n}.alpha": torch.tensor(2.0) for b in BLOCKS for n in OWN}
    save_file(tensors, tmp_path / "lora.safetensors")
    torch.manual_seed(0)
    backbone = build_backbone(TINY.backbone)
    load_adapter(backbone, tmp_path / "lora.safetensors")
    torch.testing.assert_close(run(backbone), expected, rtol=1e-4, atol=1e-4)


def test_an_adapter_takes_the_place_of_the_fresh_one_and_is_trained_on(model, tmp_path):
    torch.save(write_adapter(down="lora_A", up="lora_B", suffix=".default"), tmp_path / "lora.pt")
    load_adapter(model.backbone, tmp_path / "lora.pt")
    found = {n: p for n, p in model.backbone.named_parameters() if "lora" in n}
    assert len(found) == 2 * 4 * len(BLOCKS)
    assert all(parameter.requires_grad for parameter in found.values())
    assert torch.equal(
        found["vace_blocks.1.attn1.to_out.0.lora_B.default.weight"],
        write_adapter()["vace_blocks.1.self_attn.o.lora_b.weight"],
    )


def test_feed_forward_and_cross_attention_may_be_adapted_too(model, tmp_path):
    tensors = {
        "blocks.2.ffn.0.lora_A.weight": torch.ones(RANK, DIM),
        "blocks.2.ffn.0.lora_B.weight": torch.ones(TINY.backbone.ffn_dim, RANK),
        "vace_blocks.0.cross_attn.k.lora_A.weight": torch.ones(RANK, DIM),
        "vace_blocks.0.cross_attn.k.lora_B.weight": torch.ones(DIM, RANK),
    }
    save_file(tensors, tmp_path / "lora.safetensors")
    load_adapter(model.backbone, tmp_path / "lora.safetensors")
    assert {n.partition(".lora")[0] for n, _ in model.backbone.named_parameters() if "lora" in n} == {
        "blocks.2.ffn.net.0.proj",
        "vace_blocks.0.attn2.to_k",
    }


@pytest.mark.parametrize(
    ("key", "shape", "said"),
    [
        ("text_embedding.0.lora_a.weight", (RANK, DIM), "no adapter of an attention"),
        ("blocks.0.self_attn.norm_q.lora_a.weight", (RANK, DIM), "no adapter of an attention"),
        ("blocks.0.self_attn.q.diff_b", (DIM,), "no adapter of an attention"),
        ("blocks.77.self_attn.q.lora_a.weight", (RANK, DIM), "blocks.77.attn1.to_q has down alone"),
        ("other.blocks.0.self_attn.q.lora_a.weight", (RANK, DIM), "second tensor"),
    ],
)
def test_a_key_that_is_not_used_is_refused(model, tmp_path, key, shape, said):
    save_file(write_adapter() | {key: torch.ones(shape)}, tmp_path / "lora.safetensors")
    before = {name: tensor.clone() for name, tensor in model.backbone.state_dict().items()}
    with pytest.raises(InputError, match=said):
        load_adapter(model.backbone, tmp_path / "lora.safetensors")
    after = model.backbone.state_dict()
    assert before.keys() == after.keys() and all(torch.equal(before[name], after[name]) for name in before)


def test_adapters_that_do_not_fit_are_refused(model, tmp_path):
    path = tmp_path / "lora.safetensors"
    cases = {
        "is no layer of this backbone": {"blocks.9.self_attn.q.lora_a.weight": (RANK, DIM)}
        | {"blocks.9.self_attn.q.lora_b.weight": (DIM, RANK)},
        r"down is \(4, 90\), not \(4, 96\)": {"blocks.0.self_attn.q.lora_a.weight": (RANK, 90)}
        | {"blocks.0.self_attn.q.lora_b.weight": (DIM, RANK)},
        r"ranks \[2, 4\]": {f"blocks.{n}.self_attn.q.lora_a.weight": (r, DIM) for n, r in ((0, 2), (1, 4))}
        | {f"blocks.{n}.self_attn.q.lora_b.weight": (DIM, r) for n, r in ((0, 2), (1, 4))},
        r"ranks \[\]": {},
    }
    for said, shapes in cases.items():
        save_file({key: torch.ones(shape) for key, shape in shapes.items()}, path)
        with pytest.raises(InputError, match=said):
            load_adapter(model.backbone, path)
