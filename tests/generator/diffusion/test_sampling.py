"""Noise levels against the formula, solvers against an exact flow, and guidance."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from olt_generator.diffusion.sampling import guided_velocity, integrate, shift_sigma, sigma_grid
from olt_generator.errors import InputError

from .test_conditioned_model import TINY, draw_inputs, fresh, trained  # noqa: F401


@given(st.integers(1, 200), st.floats(0.5, 8.0))
def test_the_grid_is_shifted_once(steps, shift):
    time = 1.0 - np.arange(steps + 1) / steps
    expected = shift * time / (1.0 + (shift - 1.0) * time)
    assert np.abs(sigma_grid(steps, shift) - expected).max() < 1e-12
    assert sigma_grid(steps, shift)[0] == pytest.approx(1.0, abs=1e-15)
    assert sigma_grid(steps, shift)[-1] == 0.0


def test_the_grid_is_that_of_diffusers_asked_for_its_levels():
    from diffusers.schedulers.scheduling_flow_match_euler_discrete import FlowMatchEulerDiscreteScheduler

    scheduler = FlowMatchEulerDiscreteScheduler(shift=3.0)
    scheduler.set_timesteps(sigmas=np.linspace(1.0, 1.0 / 50, 50))
    assert np.abs(scheduler.sigmas.numpy() - sigma_grid(50)).max() < 1e-6
    assert sigma_grid(50)[-2] == pytest.approx(0.05769, abs=1e-5)
    scheduler.set_timesteps(50)
    assert np.abs(scheduler.sigmas.numpy() - sigma_grid(50)).max() > 0.01


@given(st.floats(0.01, 1.0), st.integers(1, 50))
def test_a_grid_starts_where_it_is_told(start, steps):
    grid = sigma_grid(steps, start=start)
    assert grid[0] == pytest.approx(start, abs=1e-12)
    # Uniform in time from there.
    time = grid / (3.0 - 2.0 * grid)
    assert np.abs(np.diff(time, 2)).max(initial=0.0) < 1e-12


@pytest.mark.parametrize(("steps", "start", "shift"), [(0, 1.0, 3.0), (5, 0.0, 3.0), (5, 1.1, 3.0), (5, 1.0, 0.0)])
def test_a_grid_that_cannot_be_is_refused(steps, start, shift):
    with pytest.raises(InputError, match="give at least 1"):
        sigma_grid(steps, shift, start)


# Data is normal with this mean and spread, so the velocity is known and so is where each noise ends.
MEAN, SPREAD = 0.7, 0.4


def exact_velocity(latents, sigma):
    sigma = sigma.to(latents.dtype)[:, None]
    scale = (1.0 - sigma) ** 2 * SPREAD**2 + sigma**2
    centred = latents - (1.0 - sigma) * MEAN
    return -MEAN + (sigma - (1.0 - sigma) * SPREAD**2) / scale * centred


def error(solver, steps):
    noise = torch.linspace(-2.0, 2.0, 9, dtype=torch.float64)[None]
    return float((integrate(exact_velocity, noise, sigma_grid(steps), solver) - (MEAN + SPREAD * noise)).abs().max())


@pytest.mark.parametrize(("solver", "order"), [("euler", 1), ("heun", 2)])
def test_solvers_reach_the_data_with_their_order(solver, order):
    assert error(solver, 400) < 0.02
    assert error(solver, 100) / error(solver, 200) == pytest.approx(2.0**order, rel=0.35)


@pytest.mark.parametrize("solver", ["unipc", "dpm++"])
def test_multistep_solvers_beat_euler_on_the_same_grid(solver):
    assert error(solver, 50) < 0.2 * error("euler", 50)


@pytest.mark.parametrize("solver", ["euler", "heun", "unipc", "dpm++"])
def test_a_straight_flow_is_exact_in_one_step(solver):
    """All data in one point: the velocity eps - z is constant along each path."""
    point = torch.tensor([[0.3, -0.8]])
    noise = torch.tensor([[1.0, 2.0]])
    done = integrate(lambda z, s: (z - point) / s[:, None], noise, sigma_grid(1), solver)
    torch.testing.assert_close(done, point, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(("solver", "asked"), [("euler", 5), ("heun", 9), ("unipc", 5), ("dpm++", 5)])
def test_the_levels_asked_are_those_of_the_grid(solver, asked):
    levels = []

    def velocity(latents, sigma):
        levels.append(float(sigma[0]))
        return torch.zeros_like(latents)

    integrate(velocity, torch.ones(1, 2), sigma_grid(5), solver)
    assert len(levels) == asked
    assert np.abs(np.unique(levels) - np.sort(sigma_grid(5)[:-1])).max() < 1e-6


def test_what_cannot_be_integrated_is_refused():
    noise = torch.ones(1, 2)
    with pytest.raises(InputError, match="choose from euler"):
        integrate(exact_velocity, noise, sigma_grid(2), "rk45")  # type: ignore[arg-type]
    for levels in ([1.0, 0.5], [0.5, 0.7, 0.0], [0.0]):
        with pytest.raises(InputError, match="do not fall to 0"):
            integrate(exact_velocity, noise, np.array(levels))
    for solver in ("euler", "unipc"):
        with pytest.raises(InputError, match="not finite"):
            integrate(lambda z, s: z / 0.0, noise, sigma_grid(2), solver)


@torch.no_grad()
def test_guidance_of_scale_one_is_one_pass(trained):  # noqa: F811
    latents, sigma, conditions = draw_inputs()
    passes = []
    hook = trained.backbone.proj_out.register_forward_hook(lambda *_: passes.append(1))
    empty = torch.zeros(1, 5, TINY.backbone.text_dim)
    expected = trained(latents, sigma, conditions)
    assert torch.equal(guided_velocity(trained, conditions, empty, 1.0)(latents, sigma), expected)
    assert len(passes) == 2
    guided = guided_velocity(trained, conditions, empty, 3.5)(latents, sigma)
    assert len(passes) == 4
    hook.remove()
    without = guided_velocity(trained, conditions, empty, 0.0)(latents, sigma)
    torch.testing.assert_close(guided, without + 3.5 * (expected - without), rtol=1e-4, atol=1e-4)
    nearly = guided_velocity(trained, conditions, empty, 1.0 + 1e-9)(latents, sigma)
    torch.testing.assert_close(nearly, expected, rtol=1e-5, atol=1e-5)


def test_guidance_without_an_empty_prompt_is_refused(fresh):  # noqa: F811
    with pytest.raises(InputError, match="empty prompt"):
        guided_velocity(fresh, draw_inputs()[2], None, 3.5)


@settings(max_examples=20)
@given(st.floats(0.0, 1.0))
def test_no_shift_changes_nothing(time):
    assert shift_sigma(np.array(time), 1.0) == pytest.approx(time, abs=1e-15)
