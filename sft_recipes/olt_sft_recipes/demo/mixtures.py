"""Stage: two mixtures from the clip table, by recipe."""

from typing import Any

from olt_datasets.mixtures.mixture import Mixture, compose_mixture
from olt_datasets.mixtures.recipe import builtin_recipe
from olt_datasets.tables.clip_frame import read_clip_tables
from olt_sft_recipes.demo.job import Job

# What each policy is trained on: the same number of samples, from nominal drives alone or with long-tail Syn.
RECIPES: tuple[str, ...] = ("toy_nominal", "toy_nominal_long_tail")


def compose_mixtures(job: Job) -> dict[str, Any]:
    """Compose both mixtures; returns what was asked of each component and what it got."""
    return {name: compose(job, name).describe() for name in RECIPES}


def compose(job: Job, name: str) -> Mixture:
    """Compose one mixture, checked against the scenes that the policies will be evaluated on."""
    names = job.results["scenes"]
    held_out = [*names["validation"], *names["evaluation"]]
    return compose_mixture(builtin_recipe(name), read_clip_tables([job.clips]), job.settings.seed, held_out)
