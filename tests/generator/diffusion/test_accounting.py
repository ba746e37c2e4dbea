"""What an engine costs, counted without content, against formulas and against passes with content."""

from dataclasses import replace

import pytest
import torch
from torch.profiler import ProfilerActivity, profile

from olt_generator.diffusion.accounting import (
    compare_with_paper,
    cost_of,
    cost_of_autoencoder,
    cost_of_clip,
    cost_of_view,
    describe_parts,
    make_inputs,
)
from olt_generator.diffusion.backbone import build_autoencoder
from olt_generator.diffusion.conditioned_model import build_model
from olt_generator.diffusion.config import CONFIGS
from olt_generator.diffusion.latents import LatentCodec
from olt_generator.errors import InputError

TINY = CONFIGS["tiny"]
SIZE = (9, 32, 48)


@pytest.mark.slow
def test_the_parameters_of_the_paper_s_size():
    parts = {part.name: part for part in describe_parts(CONFIGS["1.3B"])}
    # Wan 2.1 with 1.3 billion parameters; rank 32 on four square matrices of each block.
    assert parts["DiT"].parameters == pytest.approx(1.42e9, rel=0.02)
    assert parts["LoRA, self-attention of DiT"].parameters == 30 * 4 * 2 * 32 * 1536
    assert parts["LoRA, self-attention of VACE"].parameters == 15 * 4 * 2 * 32 * 1536
    assert parts["geometry encoder, rays"].parameters == 6 * 256 + 256 + 256 * 1536 + 1536
    assert parts["memory, gates"].parameters == 6 * (16 + 16 + 2 * 16 + 2)
    assert parts["memory, semantic attention"].parameters == 6 * (4 * (1536**2 + 1536) + 2 * 1536 + 5 * 1536)
    assert not any(part.trainable for name, part in parts.items() if name in ("DiT", "VACE branch"))


def test_the_parts_are_the_whole():
    model, autoencoder = build_model(TINY), build_autoencoder(TINY.autoencoder)
    for config in (TINY, replace(TINY, conditioning=replace(TINY.conditioning, plucker=False, memory=False))):
        model = build_model(config)
        parts = describe_parts(config)
        everything = [*model.parameters(), *autoencoder.parameters()]
        assert sum(part.parameters for part in parts) == sum(parameter.numel() for parameter in everything)
        trained = sum(p.numel() for p in model.parameters() if p.requires_grad)
        assert sum(part.parameters for part in parts if part.trainable) == trained


def formula(tokens, conditions, frames):
    """Operations of one pass of the tiny model, from its sizes: 2 for each weight and token, 4 for each pair."""
    b, c = TINY.backbone, TINY.conditioning
    d, rank, text = b.dim, TINY.lora.rank, 256
    block = 2 * tokens * (6 * d * d + 2 * d * b.ffn_dim + 8 * d * rank) + 2 * 2 * text * d * d
    block += 4 * d * (tokens * tokens + tokens * text)
    per_batch = 2 * (b.frequency_dim * d + 7 * d * d)
    per_text = 2 * text * (b.text_dim * d + d * d)
    patches = 2 * tokens * d * 4 * (16 + 96 + 16)
    vace = len(b.vace_layers) * (block + 2 * tokens * d * d) + 2 * tokens * d * d
    geometry = 2 * (6 * c.hidden + c.hidden * d) * (tokens + frames)
    attention = 0
    neighbours = sum(min(n + 1, frames - 1) - max(0, n - 1) + 1 for n in range(frames))
    for memory in (tokens // frames, c.queries):
        attention += 2 * d * d * (2 * tokens + 2 * conditions * frames * memory)
        attention += 4 * d * (tokens // frames) * conditions * memory * neighbours
    gates = 2 * (c.gate_hidden + 2 * c.gate_hidden)
    total = b.layers * block + vace + per_batch + per_text + patches + geometry
    return total + len(c.memory_layers) * (attention + gates)


@pytest.mark.parametrize("conditions", [1, 3])
def test_operations_are_those_of_the_formula_and_of_a_pass_with_content(conditions):
    cost = cost_of_view(TINY, SIZE, conditions, passes=2, dtype=torch.float32)
    frames, tokens = 3, 3 * 2 * 3
    assert cost.step.flops == pytest.approx(formula(tokens, conditions, frames), rel=0.001)
    model = build_model(TINY).eval()
    latents, given = make_inputs(TINY, SIZE, conditions)
    memory = model.remember(given.views, given.motion)
    measured = cost_of(lambda: model(latents, torch.zeros(1), given, memory))
    assert measured.flops == cost.step.flops
    assert cost.flops == 2 * cost.step.flops + cost.remember.flops


def test_peak_memory_is_that_of_a_pass_with_content():
    """Against the allocations that torch's profiler reports, which knows nothing of this count."""
    size = (9, 128, 128)
    counted = cost_of_view(TINY, size, 2, passes=1, dtype=torch.float32).step.peak_bytes
    model = build_model(TINY).eval()
    latents, given = make_inputs(TINY, size, 2)
    with torch.no_grad():
        memory = model.remember(given.views, given.motion)
        with profile(activities=[ProfilerActivity.CPU], profile_memory=True) as profiler:
            model(latents, torch.zeros(1), given, memory)
    events = [event for event in profiler.profiler.kineto_results.events() if event.name() == "[memory]"]
    now, most = 0, 0
    for event in sorted(events, key=lambda event: event.start_ns()):
        now += event.nbytes()
        most = max(most, now)
    assert counted == pytest.approx(most, rel=0.05)


def test_the_autoencoder_costs_what_it_costs_with_content():
    encode, decode = cost_of_autoencoder(TINY, SIZE)
    codec = LatentCodec(build_autoencoder(TINY.autoencoder))
    video = torch.zeros(1, *SIZE, 3, dtype=torch.uint8)
    assert cost_of(lambda: codec.encode(video)).flops == encode.flops
    latents = codec.encode(video)
    assert cost_of(lambda: codec.decode(latents)).flops == decode.flops


def test_a_clip_costs_its_views_and_their_coding():
    clip = cost_of_clip(TINY, SIZE, (1, 3), 10, torch.float32)
    assert [cost.conditions for cost in clip.views.values()] == [1, 2]
    coding = 3 * clip.encode.flops + 2 * clip.decode.flops
    assert clip.flops == coding + clip.views[1].flops + clip.views[3].flops
    assert clip.views[3].step.flops > clip.views[1].step.flops


@pytest.mark.slow
def test_the_paper_s_size_is_the_paper_s():
    for item, paper, here in compare_with_paper(CONFIGS["1.3B"]):
        assert paper in (here, "not stated"), item
    assert compare_with_paper(TINY)[2][2] == "4 / 2"


def test_sizes_that_do_not_fit_are_refused():
    with pytest.raises(InputError, match="cut the video to 5"):
        cost_of_view(TINY, (8, 32, 48), 1, 1)
    with pytest.raises(InputError, match="do not fill tokens"):
        cost_of_view(TINY, (9, 30, 48), 1, 1)
