import math

import pytest
import torch

from olt_sft_recipes.benchmarks.flow_solvers import REFERENCE, SOLVERS, Solver, integrate


def velocity(x, time, condition):
    """dx/dt = condition x cos(t), whose solution is x(0) exp(condition sin t)."""
    return condition * x * time.cos()[:, None, None]


def error(solver):
    noise = torch.ones(2, 64, 2, dtype=torch.float64)
    return float((integrate(velocity, solver, noise, 0.8) - math.exp(0.8 * math.sin(1.0))).abs().max())


@pytest.mark.parametrize(("method", "order"), [("euler", 1), ("midpoint", 2), ("heun", 2)])
def test_solvers_have_their_order(method, order):
    coarse, fine = error(Solver(method, 20)), error(Solver(method, 40))
    assert math.log2(coarse / fine) == pytest.approx(order, abs=0.1)


def test_evaluations_are_those_that_are_made():
    for solver in SOLVERS:
        asked = []
        integrate(lambda x, time, _, asked=asked: asked.append(time) or x, solver, torch.ones(1, 64, 2), None)
        assert len(asked) == solver.evaluations
        assert all(0.0 <= float(time[0]) <= 1.0 for time in asked)
    assert REFERENCE.evaluations > max(solver.evaluations for solver in SOLVERS)


@pytest.mark.slow
def test_a_quick_toy_is_measured(tmp_path):
    from olt_sft_recipes.benchmarks.flow_measures import measure
    from olt_sft_recipes.benchmarks.quick_toy import train_quick_toy

    policy, samples = train_quick_toy(tmp_path)
    before = {name: tensor.clone() for name, tensor in policy.model.state_dict().items()}
    result = measure(policy, samples[:3])
    solvers = {row["setting"]: row for row in result["solvers"]}
    assert solvers["heun 10"]["distance_from_reference_m"] < solvers["heun 1"]["distance_from_reference_m"]
    assert solvers["euler 20"]["distance_from_reference_m"] < solvers["euler 1"]["distance_from_reference_m"]
    own = {row["setting"]: row for row in result["precision"]}
    assert own["float32"]["min_ade_m"] == pytest.approx(solvers[result["own_solver"]]["min_ade_m"], abs=1e-4)
    assert (
        own["weights rounded to bfloat16"]["distance_from_reference_m"] != own["float32"]["distance_from_reference_m"]
    )
    assert all(row["finite"] for row in result["extremes"])
    assert all(torch.equal(tensor, before[name]) for name, tensor in policy.model.state_dict().items())
    assert "sample" not in vars(policy.model.expert)
