"""The conditioned model: it starts as the plain backbone, and each condition reaches the output once it is trained."""

from dataclasses import replace

import pytest
import torch

from olt_generator.diffusion.conditioned_model import Conditions, build_model, cast
from olt_generator.diffusion.config import CONFIGS
from olt_generator.diffusion.memory_bank import ConditionViews, SigmaGates
from olt_generator.diffusion.warp_control import no_warp, vace_control

TINY = CONFIGS["tiny"]


def draw_inputs(frames=3, rows=4, columns=6, samples=2, slots=2, magnitude=1.0, seed=0):
    """Latents, noise levels and conditions of a batch."""
    generator = torch.Generator().manual_seed(seed)

    def draw(*shape):
        return torch.randn(*shape, generator=generator)

    size, tokens = (frames, rows, columns), (frames, rows // 2, columns // 2)
    latents = magnitude * draw(samples, 16, *size)
    conditions = Conditions(
        text=draw(samples, 5, TINY.backbone.text_dim),
        camera=torch.tensor([3, 4])[:samples],
        rays=draw(samples, 6, *tokens),
        motion=draw(samples, frames, 6),
        control=vace_control(draw(samples, 16, *size), torch.rand(samples, 1, *size, generator=generator)),
        views=ConditionViews(
            magnitude * draw(samples, slots, 16, *size),
            torch.tensor([[0, 1, 3], [0, 2, 4]])[:samples, :slots],
            draw(samples, slots, 6, *tokens),
        ),
    )
    return latents, torch.tensor([0.2, 0.9])[:samples], conditions


@pytest.fixture(scope="module")
def fresh():
    return build_model(TINY, seed=1).eval()


@pytest.fixture(scope="module")
def trained():
    """A model whose zero layers say something, as after training."""
    model = build_model(TINY, seed=1).eval()
    generator = torch.Generator().manual_seed(2)
    with torch.no_grad():
        for parameter in model.parameters():
            if parameter.requires_grad:
                parameter += 0.1 * torch.randn(parameter.shape, generator=generator)
    return model


def plain(model, latents, sigma, conditions):
    arguments = {"control_hidden_states": conditions.control, "return_dict": False}
    return model.backbone(latents, 1000.0 * sigma, conditions.text, **arguments)[0]


@pytest.mark.parametrize("case", [{}, {"frames": 1}, {"magnitude": 1e3}, {"slots": 1}, {"slots": 3}])
@torch.no_grad()
def test_before_training_it_is_the_plain_backbone(fresh, case):
    latents, sigma, conditions = draw_inputs(**case)
    expected = plain(fresh, latents, sigma, conditions)
    assert expected.std() > 0.1
    torch.testing.assert_close(fresh(latents, sigma, conditions), expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("visibility", [0.0, 1.0])
@pytest.mark.parametrize("sigma", [0.0, 1.0])
@torch.no_grad()
def test_it_is_the_plain_backbone_with_nothing_and_with_all_visible(fresh, visibility, sigma):
    latents, levels, conditions = draw_inputs()
    control = vace_control(latents, torch.full_like(latents[:, :1], visibility))
    conditions, levels = replace(conditions, control=control), torch.full_like(levels, sigma)
    expected = plain(fresh, latents, levels, conditions)
    torch.testing.assert_close(fresh(latents, levels, conditions), expected, rtol=1e-6, atol=1e-6)


@torch.no_grad()
def test_no_sample_of_a_batch_knows_of_the_others(trained):
    latents, sigma, conditions = draw_inputs()
    together = trained(latents, sigma, conditions)
    for index in range(2):
        one = slice(index, index + 1)
        views = conditions.views
        alone = Conditions(
            conditions.text[one],
            conditions.camera[one],
            conditions.rays[one],
            conditions.motion[one],
            conditions.control[one],
            ConditionViews(views.latents[one], views.camera[one], views.rays[one]),
        )
        torch.testing.assert_close(trained(latents[one], sigma[one], alone), together[one], rtol=1e-4, atol=1e-5)


@torch.no_grad()
def test_an_empty_slot_tells_nothing(trained):
    latents, sigma, conditions = draw_inputs(slots=3)
    views = conditions.views
    two = ConditionViews(views.latents[:, :2], views.camera[:, :2], views.rays[:, :2])
    expected = trained(latents, sigma, replace(conditions, views=two))
    filled = torch.tensor([[True, True, False]] * 2)
    empty = replace(views, filled=filled, latents=views.latents.index_fill(1, torch.tensor(2), 7.0))
    actual = trained(latents, sigma, replace(conditions, views=empty))
    torch.testing.assert_close(actual, expected, rtol=1e-4, atol=1e-5)
    assert (trained(latents, sigma, conditions) - expected).abs().max() > 1e-3


@pytest.mark.parametrize(
    "changed", ["text", "camera", "rays", "motion", "control", "view latents", "view rays", "view"]
)
@torch.no_grad()
def test_every_condition_reaches_the_output(trained, changed):
    latents, sigma, conditions = draw_inputs()
    views = conditions.views
    others = {
        "text": replace(conditions, text=conditions.text + 1.0),
        "camera": replace(conditions, camera=conditions.camera + 1),
        "rays": replace(conditions, rays=conditions.rays.flip(-1)),
        "motion": replace(conditions, motion=conditions.motion + 1.0),
        "control": replace(conditions, control=no_warp(latents)),
        "view latents": replace(conditions, views=replace(views, latents=views.latents.flip(-1))),
        "view rays": replace(conditions, views=replace(views, rays=views.rays.flip(-1))),
        "view": replace(conditions, views=replace(views, camera=views.camera.flip(0))),
    }
    difference = trained(latents, sigma, others[changed]) - trained(latents, sigma, conditions)
    assert difference.abs().max() > 1e-3


@torch.no_grad()
def test_a_frame_sees_the_memory_of_its_neighbours_alone(trained):
    """The window is one frame: what is remembered of the last frame does not reach the block's first."""
    _, sigma, conditions = draw_inputs(frames=4)
    memory = trained.remember(conditions.views, conditions.motion)
    attention = trained.memory_attention["1"]
    hidden = torch.randn(2, 4 * 6, TINY.backbone.dim, generator=torch.Generator().manual_seed(5))
    changed = replace(memory, dense=memory.dense.index_fill(2, torch.tensor(3), 1.0))
    difference = (attention(hidden, memory, sigma) - attention(hidden, changed, sigma)).unflatten(1, (4, 6))
    reached = difference.abs().amax(dim=(0, 2, 3)) > 1e-6
    assert reached.tolist() == [False, False, True, True]


@torch.no_grad()
def test_a_memory_made_before_gives_the_same(trained):
    latents, sigma, conditions = draw_inputs()
    memory = trained.remember(conditions.views, conditions.motion)
    assert torch.equal(trained(latents, sigma, conditions, memory), trained(latents, sigma, conditions))


def test_recomputed_blocks_give_the_same_gradients(trained):
    latents, sigma, conditions = draw_inputs()
    gradients = []
    for trained.gradient_checkpointing in (False, True):
        trained.zero_grad()
        trained(latents, sigma, conditions).square().mean().backward()
        gradients.append({n: p.grad.clone() for n, p in trained.named_parameters() if p.requires_grad})
    trained.gradient_checkpointing = False
    for name, gradient in gradients[0].items():
        assert gradient.abs().max() > 0.0, name
        torch.testing.assert_close(gradients[1][name], gradient, msg=name)
    assert all(p.grad is None for p in trained.backbone.parameters() if not p.requires_grad)


def test_what_is_trained_starts_to_learn_at_the_first_step(fresh):
    """No zero layer stands behind another: each entry, and the way from the memory, gets a gradient."""
    latents, sigma, conditions = draw_inputs()
    fresh.zero_grad()
    fresh(latents, sigma, conditions).square().mean().backward()
    learning = {name for name, p in fresh.named_parameters() if p.grad is not None and p.grad.abs().max() > 0.0}
    fresh.zero_grad()
    for name in (
        "geometry.rays.2.weight",
        "geometry.motion.2.weight",
        "geometry.camera.weight",
        "geometry.role.weight",
        "memory_attention.1.dense.attention.to_out.weight",
        "memory_attention.5.semantic.attention.to_out.weight",
        "backbone.blocks.0.attn1.to_q.lora_B.default.weight",
        "backbone.vace_blocks.2.attn1.to_out.0.lora_B.default.weight",
    ):
        assert name in learning


def test_gates_start_at_a_fifth_whatever_the_noise():
    gates = SigmaGates(16, -1.4)(torch.tensor([0.0, 0.3, 1.0]))
    torch.testing.assert_close(torch.stack(gates), torch.full((2, 3), 0.1978161), rtol=0.0, atol=1e-6)


def test_gates_learn_under_autocast():
    gates = SigmaGates(16, -1.4)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        dense, _ = gates(torch.tensor([0.5]))
    assert dense.dtype == torch.float32
    bias = gates.mlp[-1].bias
    before = bias.detach().clone()
    dense.sum().backward()
    with torch.no_grad():
        bias -= 1e-5 * bias.grad
    assert bias[0] < before[0]


@torch.no_grad()
def test_bfloat16_keeps_what_must_be_precise(trained):
    latents, sigma, conditions = draw_inputs()
    expected = trained(latents, sigma, conditions)
    model = build_model(TINY, seed=1).eval()
    model.load_state_dict(trained.state_dict())
    cast(model, torch.bfloat16)
    types = {name: parameter.dtype for name, parameter in model.named_parameters()}
    assert types["backbone.blocks.0.ffn.net.2.weight"] == torch.bfloat16
    assert types["backbone.blocks.0.scale_shift_table"] == torch.float32
    assert types["geometry.rays.2.weight"] == torch.float32
    with torch.autocast("cpu", dtype=torch.bfloat16):
        mixed = model(latents, sigma, conditions)
    cast(model, torch.bfloat16, trainable=True)
    types = {name: parameter.dtype for name, parameter in model.named_parameters()}
    assert types["geometry.rays.2.weight"] == torch.bfloat16
    assert types["memory_attention.1.gates.mlp.0.weight"] == torch.float32
    for actual in (mixed, model(latents, sigma, conditions)):
        assert actual.dtype == torch.float32
        assert (actual - expected).norm() < 0.05 * expected.norm()


def test_the_same_seed_gives_the_same_weights():
    state = torch.random.get_rng_state()
    one, other = build_model(TINY, seed=3).state_dict(), build_model(TINY, seed=3).state_dict()
    assert all(torch.equal(one[name], other[name]) for name in one)
    assert torch.equal(torch.random.get_rng_state(), state)


@torch.no_grad()
def test_parts_can_be_left_out():
    conditioning = replace(TINY.conditioning, plucker=False, memory=False)
    model = build_model(replace(TINY, conditioning=conditioning), seed=1).eval()
    assert model.remember(draw_inputs()[2].views, draw_inputs()[2].motion) is None
    latents, sigma, conditions = draw_inputs()
    other = replace(conditions, rays=conditions.rays.flip(-1), views=None)
    torch.nn.init.normal_(model.geometry.camera.weight)
    assert torch.equal(model(latents, sigma, conditions), model(latents, sigma, other))
