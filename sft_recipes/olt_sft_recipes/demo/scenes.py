"""Stage: the driving scenes of the synthetic world, written as OpenUSD."""

from typing import Any

from olt_closed_loop.scenes.procedural import generate_scene
from olt_closed_loop.scenes.scene_file import write_scene
from olt_sft_recipes.demo.job import Job
from olt_sft_recipes.demo.settings import (
    EVALUATION_SEEDS,
    INPUT_SEED,
    LONG_TAIL,
    NOMINAL,
    TRAINING_SEEDS,
    VALIDATION_SEEDS,
    DemoSettings,
)

ROLES = ("input", "nominal", "long_tail", "validation", "evaluation")


def write_scenes(job: Job) -> dict[str, Any]:
    """Write every scene that the job drives; returns the scene names by role."""
    plan = plan_scenes(job.settings)
    if job.video is not None:
        plan["input"] = []
    drives = [(role, category, seed) for role in ROLES for category, seed in plan[role]]
    names: dict[str, list[str]] = {role: [] for role in ROLES}
    for done, (role, category, seed) in enumerate(drives, start=1):
        scene = generate_scene(category, seed)
        write_scene(scene, job.scenes / f"{scene.name}.usda")
        names[role].append(scene.name)
        job.on_progress(done / len(drives))
    return names


def plan_scenes(settings: DemoSettings) -> dict[str, list[tuple[str, int]]]:
    """Category and scene seed of every drive by role; no two roles share a scene."""
    base = 10_000 * settings.seed

    def scenes(categories: tuple[str, ...], role_seed: int, count: int) -> list[tuple[str, int]]:
        return [(category, base + role_seed + index) for category in categories for index in range(count)]

    return {
        "input": scenes(LONG_TAIL[:1], INPUT_SEED, 1),
        "nominal": scenes((NOMINAL,), TRAINING_SEEDS, settings.nominal_clips),
        "long_tail": scenes(LONG_TAIL, TRAINING_SEEDS, settings.long_tail_clips),
        "validation": scenes((NOMINAL,), VALIDATION_SEEDS, settings.validation_clips),
        "evaluation": scenes(LONG_TAIL, EVALUATION_SEEDS, settings.evaluation_scenes),
    }
