"""Engines as folders: what is written is what is loaded, or the reader says why not."""

import json
from dataclasses import replace

import pytest
import torch

from olt_generator.diffusion.engine_folder import load_engine, read_facts
from olt_generator.errors import InputError

from .tiny_engine import FACTS, without_memory, write_engine


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_engine(tmp_path_factory.mktemp("engine") / "tiny")


def test_an_engine_comes_back_whole(folder, tmp_path):
    engine = load_engine(folder)
    assert engine.facts == FACTS == read_facts(folder)
    again = load_engine(write_engine(tmp_path / "again"))
    assert engine.digest == again.digest != load_engine(write_engine(tmp_path / "other", seed=1)).digest
    for name, tensor in engine.model.state_dict().items():
        assert torch.equal(tensor, again.model.state_dict()[name]), name
    latents = torch.randn(1, 16, 2, 4, 6)
    assert torch.equal(engine.codec.decode(latents), again.codec.decode(latents))
    assert not any(p.requires_grad for p in engine.model.parameters())


def test_half_precision_leaves_what_must_stay_single(folder):
    model = load_engine(folder, dtype=torch.bfloat16).model
    gates = [p.dtype for name, p in model.named_parameters() if ".gates." in name]
    assert gates and set(gates) == {torch.float32}
    assert model.backbone.blocks[0].attn1.to_out[0].base_layer.weight.dtype == torch.bfloat16


def spoil(folder, tmp_path, name, change):
    """A copy of the engine with one file changed."""
    for path in folder.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / name).write_bytes(change((tmp_path / name).read_bytes()))
    return tmp_path


def facts_with(**values):
    return lambda content: json.dumps(json.loads(content) | values).encode()


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("engine.json", lambda content: content[:40], "is no JSON"),
        ("engine.json", facts_with(format=7), "format 1"),
        ("engine.json", facts_with(width=50), "multiples of 16"),
        ("engine.json", facts_with(width="wide"), "engine.json"),
        ("engine.json", facts_with(more=1), "more is missing or unknown"),
        ("engine.json", facts_with(layout="mine"), "choose from"),
        ("engine.json", facts_with(config={}), "config"),
        ("model.safetensors", lambda content: content[:-7], "cannot be read"),
        ("text.safetensors", lambda _: b"", "cannot be read"),
    ],
)
def test_damage_is_refused_in_words(folder, tmp_path, name, change, message):
    with pytest.raises(InputError, match=message):
        load_engine(spoil(folder, tmp_path, name, change))


def test_weights_of_another_engine_are_refused(folder, tmp_path):
    other = write_engine(tmp_path / "other", without_memory())
    (other / "model.safetensors").write_bytes((folder / "model.safetensors").read_bytes())
    with pytest.raises(InputError, match="not those of this engine"):
        load_engine(other)


def test_a_backbone_belongs_to_an_engine_without_one(folder, tmp_path):
    with pytest.raises(InputError, match="its own backbone"):
        load_engine(folder, tmp_path)
    with pytest.raises(InputError, match=r"Wan2\.1-VACE"):
        load_engine(write_engine(tmp_path / "engine", replace(FACTS, owns_backbone=False)))
