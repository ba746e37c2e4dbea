"""Stage: the trained policies in the closed loop, on held-out long-tail scenes."""

from collections.abc import Sequence
from typing import Any

from olt_closed_loop.evaluation.evaluation import pass_gate, run_closed_loop, save_results
from olt_closed_loop.evaluation.score_table import summarize_scores
from olt_generator.omissions import Omission, word_omission
from olt_sft_recipes.demo.job import Job
from olt_sft_recipes.demo.mixtures import RECIPES


def score_policies(job: Job) -> dict[str, Any]:
    """Check the gate, then drive every evaluation scene with each policy; returns the score tables.

    Raises:
        InputError: a scene fails the gate, so that its scores would mean nothing.
    """
    scenes = [str(job.scenes / f"{name}.usda") for name in job.results["scenes"]["evaluation"]]
    gate = [result.to_dict() for result in pass_gate(scenes)]
    policies = {}
    for index, name in enumerate(RECIPES):
        job.bar.start(f"closed loop: {name}")
        results = run_closed_loop(
            scenes,
            f"toy:{job.policy(name) / 'policy'}",
            rollouts=job.settings.rollouts,
            seed=job.settings.seed,
            workers=job.workers,
            on_progress=lambda share, index=index: job.on_progress((index + share) / len(RECIPES)),
        )
        save_results(job.rollouts(name), results)
        scores = [score for _, score in results]
        policies[name] = {
            "table": summarize_scores(scores).to_dict(),
            "scores": [{**score.to_dict(), "left_out": _worded(score.left_out)} for score in scores],
            "incidents": [{"scene": rollout.scene, **vars(rollout.incidents)} for rollout, _ in results],
            "left_out": sorted({reason for rollout, _ in results for reason in _worded(rollout.left_out)}),
        }
    return {"gate": gate, "policies": policies}


def _worded(omissions: Sequence[Omission]) -> list[str]:
    return [word_omission(omission) for omission in omissions]
