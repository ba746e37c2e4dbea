"""What the main job found, as one JSON object: equal runs differ in `timings` and `machine` alone."""

import json
from dataclasses import asdict
from typing import Any

from olt_generator.files import write_whole
from olt_generator.omissions import Omission, word_omission
from olt_sft_recipes.demo.job import Job
from olt_sft_recipes.demo.mixtures import RECIPES
from olt_toolkit import __version__
from olt_toolkit.runtime.environment import describe_machine


def summarize_job(job: Job, seconds: dict[str, float]) -> dict[str, Any]:
    """Put the results of all stages together, times apart."""
    results = job.results
    clip = dict(results["clips"]["input"])
    parts = clip.pop("seconds")
    training = {name: dict(results["training"][name]) for name in RECIPES}
    training_seconds = {name: training[name].pop("seconds") for name in RECIPES}
    return {
        "openlongtail": __version__,
        "settings": asdict(job.settings),
        "input": {"kind": "video" if job.video else "synthetic", "name": job.video.name if job.video else None, **clip},
        "scenes": results["scenes"],
        "training_clips": results["clips"]["training"],
        "mixtures": results["mixtures"],
        "training": training,
        "closed_loop": results["closed_loop"],
        "left_out": list_left_out(results),
        "timings": {"stages_s": seconds, "input_clip_s": parts, "training_s": training_seconds},
        "machine": describe_machine(),
    }


def write_summary(job: Job, summary: dict[str, Any]) -> None:
    """Write `summary.json` whole."""
    with write_whole(job.out / "summary.json") as path:
        path.write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n")


def list_left_out(results: dict[str, dict[str, Any]]) -> list[str]:
    """Everything that the stages with these results did not compute, and why."""
    clip = results["clips"]["input"]
    views = [word_omission(Omission(**omission)) for omission in clip["left_out"]]
    no_sample_reason = clip["clip"]["no_sample_reason"]
    if no_sample_reason:
        views.append(f"policy samples of the input clip: {no_sample_reason}")
    frames = results["clips"]["training"]["frames_left_out_of_each_view"]
    if frames:
        views.append(f"{frames} frames of each view of the training clips: no sample of these clips shows them")
    policies = results["closed_loop"]["policies"].values()
    drives = sorted({reason for policy in policies for reason in policy["left_out"]})
    scores = sorted({reason for policy in policies for score in policy["scores"] for reason in score["left_out"]})
    return [*views, *drives, *scores]
