"""Stage: the trained policies in the closed loop, on held-out long-tail scenes."""

from typing import Any

from olt_closed_loop.evaluation import run_closed_loop, save_results
from olt_closed_loop.gate import check_gate
from olt_closed_loop.score_table import summarize_scores
from olt_closed_loop.stage import read_scene
from olt_generator.errors import InputError
from olt_sft_recipes.demo.job import Job
from olt_sft_recipes.demo.mixtures import RECIPES


def score_policies(job: Job) -> dict[str, Any]:
    """Check the gate, then drive every evaluation scene with each policy; returns the score tables.

    Raises:
        InputError: a scene fails the gate, so that its scores would mean nothing.
    """
    scenes = [job.scenes / f"{name}.usda" for name in job.results["scenes"]["evaluation"]]
    gate = [check_gate(read_scene(scene)).to_dict() for scene in scenes]
    failed = [result["scene"] for result in gate if not result["passed"]]
    if failed:
        raise InputError(f"scenes {', '.join(failed)}: the gate fails, so no score is given")
    policies = {}
    for index, name in enumerate(RECIPES):
        job.bar.start(f"closed loop: {name}")
        results = run_closed_loop(
            [str(scene) for scene in scenes],
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
            "scores": [score.to_dict() for score in scores],
            "events": [{"scene": rollout.scene, **vars(rollout.events)} for rollout, _ in results],
            "left_out": sorted({reason for rollout, _ in results for reason in rollout.left_out}),
        }
    return {"gate": gate, "policies": policies}
