"""Training of the toy policy end to end on this machine: what it takes, both stages, and what the policy is worth."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from olt_closed_loop import load_scene
from olt_closed_loop.evaluation.evaluation import find_scenes
from olt_closed_loop.scenes.procedural import CATEGORIES
from olt_datasets import Mixture, write_mixture
from olt_generator.errors import InputError
from olt_generator.progress import Progress, silent
from olt_sft_recipes.open_loop import spread_keys
from olt_sft_recipes.toy.checkpoint import ToyModel
from olt_sft_recipes.toy.config import ToyPolicyConfig
from olt_sft_recipes.training.processes import check_tracker, run_on_processes
from olt_sft_recipes.training.sample_arrays import bytes_of_sample
from olt_sft_recipes.training.stage_config import StageConfig, Tracker, builtin_stage_config, read_stage_config
from olt_sft_recipes.training.two_stages import (
    POLICY_FOLDER,
    StageChoice,
    StageResult,
    read_results,
    train_on_mixture,
)
from olt_sft_recipes.training.validation import Validation
from olt_toolkit import ClipStore
from olt_toolkit.rigs.contracts import DEFAULT_CONTRACT, CameraContract

VALIDATION_SEED = 900
"""The scenes of the validation suite have this seed; no data of the toolkit's has it."""

VALIDATION_SCENES = tuple(f"{category}:{VALIDATION_SEED}" for category in CATEGORIES)
HELD_OUT_SCENES = tuple(f"synthetic/{category}_{VALIDATION_SEED:06d}" for category in CATEGORIES)
"""The same as `compose_mixture` names them, so that none of them is trained on."""

VALIDATION_US = 10_000_000
_MOST_SAMPLES = 64
_SAMPLES_PER_CLIP = 4


def launch_toy(
    mixture: Mixture,
    out: Path,
    *,
    stage: StageChoice = "both",
    processes: int = 1,
    seed: int | None = None,
    rig: str = DEFAULT_CONTRACT.name,
    stores: Sequence[Path] = (),
    stage1: Path | None = None,
    stage2: Path | None = None,
    report_to: Tracker = "none",
    dry_run: bool = False,
    on_progress: Progress = silent,
) -> dict[str, Any]:
    """Train the toy on a mixture and judge it while it trains; the same call goes on with what was interrupted.

    Args:
        mixture: what is trained on.
        out: `out/stage1`, `out/stage2` and `out/policy`, which drives.
        stage: which stage is trained.
        processes: processes of this machine, which share each optimizer step; what they sum they round differently,
            and the differences grow with the steps.
        seed: of both stages; None for those that their YAML says.
        rig: camera contract of the policy.
        stores: clip stores whose split "val" judges the stages; without one, Stage 2 is judged by its driving alone.
        stage1, stage2: YAML of the stages; None for the toy's own.
        report_to: who is told of losses and errors.
        dry_run: tell the plan and train nothing.
        on_progress: told the share that is done; with more processes they tell it themselves.

    Returns:
        `plan` (`plan_toy`), and unless it is a dry run `policy`, the folder of the policy or None before Stage 2, and
        `stages`, the fields of `StageResult`.

    Raises:
        InputError: see `train_on_mixture`; or the tracker is not installed, or `processes` is below 1.
    """
    if processes < 1:
        raise InputError(f"--processes {processes}: give 1 or more")
    check_tracker(report_to)
    stages, config = read_stages(stage1, stage2, report_to), ToyPolicyConfig(rig=rig)
    validation = validation_of(stores, config.contract, VALIDATION_SCENES)
    plan = plan_toy(mixture, stages, stage, config, validation)
    if dry_run:
        return {"plan": plan}
    if processes == 1:
        results = train_on_mixture(mixture, stages, seed, out, on_progress, config, validation, stage)
    else:
        write_mixture(mixture, out / "mixture.json")
        judged = stores if validation.samples else ()
        run_on_processes(_arguments(out, (stage1, stage2), stage, seed, rig, judged, report_to), processes)
        results = read_results(out, stage)
    policy = str(out / POLICY_FOLDER) if stage != "1" else None
    return {"plan": plan, "policy": policy, "stages": [vars(result) for result in results]}


def read_stages(
    stage1: Path | None, stage2: Path | None, report_to: Tracker = "none"
) -> tuple[StageConfig, StageConfig]:
    """The settings of both stages, from YAML files, or the toy's own; `report_to` replaces theirs unless it is none.

    Raises:
        InputError: see `read_stage_config`.
    """
    first = read_stage_config(stage1) if stage1 else builtin_stage_config(1)
    second = read_stage_config(stage2) if stage2 else builtin_stage_config(2)
    if report_to == "none":
        return first, second
    return first.model_copy(update={"report_to": report_to}), second.model_copy(update={"report_to": report_to})


def validation_of(stores: Sequence[Path], contract: CameraContract, scenes: Sequence[str]) -> Validation:
    """What judges the stages: at most 64 samples of the split "val", spread over its clips, and scenes to drive.

    Raises:
        InputError: a store cannot be read, or a scene not be found.
    """
    for scene in find_scenes(scenes):
        load_scene(scene)
    opened = [ClipStore(path) for path in stores]
    keys = [(store, key) for store in opened for key in spread_keys(store, "val", _SAMPLES_PER_CLIP)]
    chosen = keys[:: -(-len(keys) // _MOST_SAMPLES) or 1]
    samples = [
        sample
        for store in opened
        for sample in store.load_samples([key for of, key in chosen if of is store], contract=contract)
    ]
    return Validation(samples, scenes, VALIDATION_US)


def plan_toy(
    mixture: Mixture, stages: Sequence[StageConfig], stage: StageChoice, config: ToyPolicyConfig, validation: Validation
) -> dict[str, Any]:
    """What a training would take: its steps, what is trainable in it, and what judging it costs at most."""
    model = ToyModel(config)
    parts = {1: model.vlm, 2: model.expert}
    rows = []
    for settings in stages:
        if stage not in ("both", str(settings.stage)):
            continue
        per_epoch = -(-len(mixture) // settings.samples_per_step)
        steps = settings.num_train_epochs * per_epoch
        judged = -(-steps // settings.evaluation_interval(steps)) if validation.judges(settings.stage) else 0
        trainable = sum(parameter.numel() for parameter in parts[settings.stage].parameters())
        rows.append(
            {
                "stage": settings.stage,
                "steps": steps,
                "samples_per_step": settings.samples_per_step,
                "trainable": {"vlm" if settings.stage == 1 else "expert": trainable},
                "frozen": sum(parameter.numel() for parameter in model.parameters()) - trainable,
                "evaluations": judged,
                "drives": judged * len(validation.scenes) if settings.stage == 2 else 0,
            }
        )
    return {
        "recipe": mixture.recipe.name,
        "samples_per_epoch": len(mixture),
        "distinct_samples": len(mixture.samples),
        "decoded_bytes": len(mixture.samples) * bytes_of_sample(config),
        "validation_samples": len(validation.samples),
        "validation_scenes": list(validation.scenes),
        "stages": rows,
    }


def describe_toy(result: dict[str, Any]) -> list[str]:
    """What `launch_toy` returned, in lines for people."""
    plan = result["plan"]
    lines = [
        f"recipe {plan['recipe']}: {plan['samples_per_epoch']} samples an epoch, {plan['distinct_samples']} distinct; "
        f"decoded they take {plan['decoded_bytes'] / 1e9:.1f} GB of the disk while it trains; "
        f"judged on {plan['validation_samples'] or 'no'} held-out samples and {len(plan['validation_scenes'])} scenes"
    ]
    for row in plan["stages"]:
        ((part, count),) = row["trainable"].items()
        lines.append(
            f"stage {row['stage']}: {row['steps']} steps of {row['samples_per_step']} samples; trainable: {part} "
            f"{count:,} parameters, frozen or untouched: {row['frozen']:,}; judged {row['evaluations']} times, "
            f"{row['drives']} drives"
        )
    for stage in result.get("stages", []):
        lines += _describe_stage(StageResult(**stage))
    if result.get("policy"):
        lines.append(
            f"policy: {result['policy']}; drive it: olt closed-loop run nominal:7 --policy toy:{result['policy']}"
        )
    return lines


def _describe_stage(result: StageResult) -> list[str]:
    seconds = result.seconds_of
    spent = ", ".join(f"{name} {seconds[name] / result.seconds:.0%}" for name in sorted(seconds))
    lines = [
        f"stage {result.stage}: loss {result.losses[0]:.4g} at first, {result.final_loss:.4g} at last; "
        f"{result.seconds:.0f} s ({spent}); {result.saturated_tokens} tokens saturated; {result.checkpoint} goes on"
    ]
    if result.vlm_sha256:
        lines.append(f"  the vision-language model is unchanged: SHA-256 {result.vlm_sha256[:16]}... before and after")
    return lines + [f"  {describe_evaluation(evaluation)}" for evaluation in result.evaluations]


def describe_evaluation(evaluation: dict[str, Any]) -> str:
    """One evaluation (`validation.evaluate`) in one line."""
    parts = [f"step {evaluation['step']}:"]
    if evaluation["eval_loss"] is not None:
        parts.append(f"held-out loss {evaluation['eval_loss']:.4g}")
    if errors := evaluation["open_loop"]:
        parts.append(
            f"minADE {errors['min_ade']:.3g} m, ADE {errors['ade']:.3g} m, corners {errors['corner_distance']:.3g} m"
        )
    if driven := evaluation["closed_loop"]:
        score, collisions = driven["alpasim_score"], driven["collision_rate"]
        scored = "not measured" if score is None else f"AS {score:.2f}, CR {collisions:.2f}"
        parts.append(f"closed loop: {scored} on {driven['valid']} of {driven['rollouts']} drives")
    return " ".join([parts[0], "; ".join(parts[1:])])


def _arguments(
    out: Path,
    stages: tuple[Path | None, Path | None],
    stage: StageChoice,
    seed: int | None,
    rig: str,
    stores: Sequence[Path],
    report_to: Tracker,
) -> list[str]:
    """`olt` arguments by which the processes train what `launch_toy` would train alone."""
    arguments = ["sft", "train", "--mixture", str(out / "mixture.json"), "--out", str(out)]
    arguments += ["--stage", stage, "--rig", rig, "--report-to", report_to]
    arguments += [] if seed is None else ["--seed", str(seed)]
    for name, path in zip(("--stage1", "--stage2"), stages, strict=True):
        arguments += [name, str(path)] if path else []
    for store in stores:
        arguments += ["--judge-on", str(store)]
    for scene in VALIDATION_SCENES:
        arguments += ["--judge-scene", scene]
    return arguments
