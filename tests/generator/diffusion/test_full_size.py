"""A conditioned pass of the paper's size, with random weights and few latent cells: 9 GB of memory, a minute."""

import pytest
import torch

from olt_generator.diffusion.accounting import make_inputs, weight_bytes
from olt_generator.diffusion.conditioned_model import build_model, cast
from olt_generator.diffusion.config import CONFIGS

CONFIG = CONFIGS["1.3B"]


@pytest.mark.slow
@torch.no_grad()
def test_the_paper_s_size_passes_as_the_plain_backbone_before_training():
    model = build_model(CONFIG, seed=1).eval()
    cast(model, torch.bfloat16, trainable=True)
    held = sum(parameter.numel() * parameter.element_size() for parameter in model.parameters())
    assert held == pytest.approx(weight_bytes(CONFIG, torch.bfloat16), rel=0.01)
    latents, conditions = make_inputs(CONFIG, (9, 64, 96), conditions=3, text_tokens=16)
    latents = torch.randn(latents.shape, generator=torch.Generator().manual_seed(0))
    sigma = torch.tensor([0.7])
    velocity = model(latents, sigma, conditions)
    assert velocity.shape == (1, 16, 3, 8, 12)
    arguments = {"control_hidden_states": conditions.control.bfloat16(), "return_dict": False}
    expected = model.backbone(latents.bfloat16(), 1000.0 * sigma, conditions.text.bfloat16(), **arguments)[0].float()
    assert expected.std() > 0.1
    # Half precision keeps 8 bits; what is compared went through 45 blocks of it.
    assert (velocity - expected).norm() < 0.02 * expected.norm()
