"""A launch of a public Alpamayo recipe: prepared and looked at, then run here or handed to SLURM."""

import json
import math
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from olt_datasets.export.contents import Contents, contents_of_mixture
from olt_datasets.export.pai import export_pai
from olt_datasets.mixtures.mixture import Mixture
from olt_generator.errors import InputError
from olt_generator.files import make_folder, write_whole
from olt_generator.progress import Progress
from olt_sft_recipes.launch.checkpoints import check_pixel_budget, read_checkpoint
from olt_sft_recipes.launch.following import LAUNCH_FILE
from olt_sft_recipes.launch.handoff import handoff_lines
from olt_sft_recipes.launch.pai_data import PaiData, Saturation, count_saturation, existing_data, planned_data
from olt_sft_recipes.launch.plan import FINISHED, LaunchPlan, Places, make_plan
from olt_sft_recipes.launch.public_recipes import Stage, find_public_recipe
from olt_sft_recipes.launch.running import run_before, run_evaluation, run_stage
from olt_sft_recipes.launch.stage_settings import StageSettings, builtin_stage_settings, read_stage_settings
from olt_sft_recipes.launch.torchrun import Machines, to_shell
from olt_sft_recipes.launch.trainable import model_sizes
from olt_sft_recipes.preflight.check import check
from olt_sft_recipes.preflight.checkpoint_folder import CheckpointFolder
from olt_sft_recipes.preflight.plan import MOST_SATURATED, PreflightPlan
from olt_sft_recipes.preflight.rows import PreflightReport
from olt_toolkit.rigs.contracts import find_contract
from olt_toolkit.runtime.json_files import read_json

BATCH_FILE, COMMANDS_FILE = "launch.sbatch", "commands.sh"
Stages = Literal["1", "2", "both"]
_STAGES: dict[Stages, tuple[Stage, ...]] = {"1": (1,), "2": (2,), "both": (1, 2)}


@dataclass(frozen=True)
class LaunchRequest:
    """What is asked for.

    Attributes:
        policy: alpamayo-r1 or alpamayo-1.5.
        places: files and folders.
        machines: nodes and processes.
        mixture: what is exported and trained on; None takes `pai`.
        pai, chunk_ids: a folder that is in PhysicalAI-AV layout already, and which of its chunks; None is all.
        validation, validation_chunks: the same for the recipe's evaluation.
        stages: which of them run.
        stage_files: settings of Stage 1 and 2; None takes the built-in ones.
        stage1_checkpoint: for Stage 2 alone.
        lora: adapters in Stage 1.
        most_saturated: share of saturated tokens beyond which nothing runs.
        gpu_memory_gib: of each card, for preflight.
        slurm_options: a batch file with these options is submitted; None runs here.
    """

    policy: str
    places: Places
    machines: Machines
    mixture: Mixture | None = None
    pai: Path | None = None
    chunk_ids: str | None = None
    validation: Path | None = None
    validation_chunks: str | None = None
    stages: Stages = "both"
    stage_files: tuple[Path | None, Path | None] = (None, None)
    stage1_checkpoint: Path | None = None
    lora: bool = False
    most_saturated: float = MOST_SATURATED
    gpu_memory_gib: float | None = None
    slurm_options: tuple[str, ...] | None = None


@dataclass(frozen=True)
class PreparedLaunch:
    """A launch that is planned and looked at; `contents` are still to be exported, None where data are there."""

    request: LaunchRequest
    plan: LaunchPlan
    contents: Contents | None
    saturation: Saturation | None

    def to_dict(self) -> dict[str, Any]:
        """What `--json` tells."""
        counted, options = self.saturation, self.request.slurm_options
        return self.plan.to_dict() | {
            "commands": [to_shell(words) for words in commands_of(self.plan)] if options is None else [],
            "batch": None if options is None else self.plan.batch(options),
            "saturation": None if counted is None else vars(counted) | {"share": counted.share},
            "handoff": handoff_lines(self.plan.recipe.policy, self.plan.stages[-1].checkpoint)
            if self.plan.stages[-1].stage == 2
            else [],
        }


def prepare_launch(request: LaunchRequest, on_progress: Progress) -> PreparedLaunch:
    """Plan a launch; writes nothing.

    Raises:
        InputError: the policy has no recipe, settings or data are wrong, or the base is not whole.
    """
    recipe = find_public_recipe(request.policy)
    contents, train = _training_data(request)
    validation = _validation_data(request, train)
    base = _look_at_base(request.places.base)
    settings: list[tuple[Stage, StageSettings]] = [
        (stage, _settings(request, stage)) for stage in _STAGES[request.stages]
    ]
    plan = make_plan(
        recipe,
        request.places,
        request.machines,
        train,
        validation,
        settings,
        model_sizes(base),
        base.config if base else None,
        request.stage1_checkpoint or _finished_stage1(request),
        request.lora,
    )
    saturation = count_saturation(train, on_progress)
    return PreparedLaunch(request, plan, contents, saturation)


def refuse_saturated(prepared: PreparedLaunch) -> None:
    """InputError where more future tokens are cut off than the request allows."""
    counted = prepared.saturation
    if counted is not None and counted.share > prepared.request.most_saturated:
        allowing = math.ceil(1000 * counted.share) / 1000
        raise InputError(
            f"{counted.tokens} future tokens of {counted.samples_touched} samples saturate, {counted.share:.2%} of "
            f"all, first in clip {counted.first_clip}: the policy would learn weaker braking and wider turns than were "
            f"driven; look at its ego motion, or allow more with --most-saturated {allowing:g}"
        )


def look_before(prepared: PreparedLaunch) -> PreflightReport:
    """Preflight of what is there by now."""
    request, plan = prepared.request, prepared.plan
    there = plan.train.folder.exists()
    to_be_rewritten = bool(plan.left_before)
    validation = plan.validation
    return check(
        PreflightPlan(
            policy=request.policy,
            stages=tuple(each.planned for each in plan.stages),
            data=plan.train.folder if there else None,
            chunk_ids=plan.train.chunk_ids,
            val_data=validation.folder if validation else None,
            val_chunk_ids=validation.chunk_ids if validation else None,
            use_default_keyframe=not plan.train.own_times,
            # Rewriting a base changes its model type and the names of classes alone.
            base=request.places.base if to_be_rewritten else plan.base,
            base_is_rewritten=to_be_rewritten,
            stage1=plan.stage1 if request.stages == "2" else None,
            vlm=request.places.vlm,
            out=request.places.out,
            nodes=request.machines.nodes,
            gpus=request.machines.gpus,
            gpu_memory_gib=request.gpu_memory_gib,
            python=request.places.python,
            most_saturated=request.most_saturated,
        )
    )


def refuse_before_export(prepared: PreparedLaunch) -> None:
    """InputError where anything but the data, which are still to be exported, is not ready."""
    if prepared.contents is not None and not prepared.plan.train.folder.exists():
        look_before(prepared).refuse()


def write_launch(prepared: PreparedLaunch) -> None:
    """Write `launch.json`, and the commands or the batch file.

    Raises:
        InputError: the folder holds another launch.
    """
    plan, out = prepared.plan, prepared.plan.places.out
    text = json.dumps(plan.to_dict(), indent=2) + "\n"
    path = out / LAUNCH_FILE
    if path.exists() and not _goes_on(read_json(path, "launch"), json.loads(text)):
        raise InputError(f"{path}: another launch was made there; choose another --out, or ask for the same again")
    make_folder(out / "logs")
    options = prepared.request.slurm_options
    commands = (COMMANDS_FILE, write_commands(plan)) if options is None else (BATCH_FILE, plan.batch(options))
    for name, content in ((LAUNCH_FILE, text), commands):
        with write_whole(out / name) as temporary:
            temporary.write_text(content, encoding="utf-8")


def _goes_on(before: Any, now: dict[str, Any]) -> bool:
    """Whether a launch is an earlier one again, or the same with other stages of it."""
    if not isinstance(before, dict) or not isinstance(before.get("stages"), list):
        return False
    of_stages = ("stages", "evaluation", "stage1_checkpoint")
    same = [{key: value for key, value in each.items() if key not in of_stages} for each in (before, now)]
    earlier = {each["stage"]: each for each in before["stages"]}
    return same[0] == same[1] and all(earlier.get(each["stage"], each) == each for each in now["stages"])


def export_data(prepared: PreparedLaunch, workers: int, on_progress: Progress) -> dict[str, Any] | None:
    """Export the mixture, unless it is there; None where the data were given."""
    if prepared.contents is None:
        return None
    summary = export_pai(prepared.contents, prepared.plan.train.folder, workers=workers, on_progress=on_progress)
    if summary["clips"] != prepared.plan.train.clips:
        raise InputError(f"{prepared.plan.train.folder}: {summary['clips']} clips, not {prepared.plan.train.clips}")
    return summary


def run_launch(prepared: PreparedLaunch, show: Callable[[str], Progress]) -> dict[str, Any]:
    """Run what is left to be run on this machine; the results by stage.

    Args:
        show: takes the name of a step and gives where its progress is told.

    Raises:
        InputError: several nodes are asked for, the pixel budget is missing, or see `run_stage`.
    """
    plan = prepared.plan
    run_before(plan)
    check_pixel_budget(read_checkpoint(plan.base))
    if plan.machines.nodes > 1:
        raise InputError(
            f"{plan.machines.nodes} nodes cannot be started from one of them: run the commands of "
            f"{plan.places.out / COMMANDS_FILE} on each, or launch with --slurm"
        )
    results = {f"stage{each.stage}": run_stage(plan, each, show(f"Stage {each.stage}")) for each in plan.stages}
    if plan.evaluation:
        results["evaluation"] = run_evaluation(plan, show("evaluation"))
    return results


def submit(plan: LaunchPlan) -> str:
    """Hand the batch file to SLURM; what sbatch says."""
    path = plan.places.out / BATCH_FILE
    program = shutil.which("sbatch")
    if program is None:
        raise InputError(f"there is no sbatch here; submit {path} where there is one")
    done = subprocess.run([program, str(path)], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise InputError(f"sbatch {path}: {done.stderr.strip() or 'failed'}")
    return done.stdout.strip()


def commands_of(plan: LaunchPlan) -> list[list[str]]:
    """Every command in its order, as it runs on one of the machines."""
    return [*map(list, plan.before), *_on_each(plan)]


def _on_each(plan: LaunchPlan) -> list[list[str]]:
    """Those that run on each of the machines."""
    trained = [plan.command(each.arguments) for each in plan.stages]
    return [*trained, plan.command(plan.evaluation)] if plan.evaluation else trained


def write_commands(plan: LaunchPlan) -> str:
    """The commands as a script; with several nodes it is run on each of them."""
    head = ["#!/bin/bash", "set -euo pipefail", "export PYTHONUNBUFFERED=1 HYDRA_FULL_ERROR=1"]
    folder = to_shell(["cd", str(plan.places.recipe(plan.recipe))])
    return "\n".join([*head, folder, *plan.shell_before(), *map(to_shell, _on_each(plan))]) + "\n"


def _training_data(request: LaunchRequest) -> tuple[Contents | None, PaiData]:
    if request.mixture is not None:
        contents = contents_of_mixture(request.mixture, find_contract(request.policy))
        return contents, planned_data(contents, request.places.out / "pai")
    if request.pai is None:
        raise InputError("no data: give --recipe with --stores, --mixture, or --pai")
    return None, existing_data(request.pai, request.chunk_ids)


def _validation_data(request: LaunchRequest, train: PaiData) -> PaiData | None:
    if request.validation is None:
        return None
    data = existing_data(request.validation, request.validation_chunks)
    if data.folder == train.folder and set(data.chunks) & set(train.chunks):
        raise InputError(
            f"{data.folder}: chunks {data.chunk_ids} for validation and {train.chunk_ids} for training share some, so "
            "the policy would be judged on what it was trained on; give --chunks and --validation-chunks apart"
        )
    return data


def _finished_stage1(request: LaunchRequest) -> Path | None:
    """What an earlier launch into the same folder left, for Stage 2 alone."""
    note = request.places.stage(1) / FINISHED
    if request.stages != "2" or not note.exists():
        return None
    return Path(read_json(note, "note of a finished stage")["checkpoint"])


def _settings(request: LaunchRequest, stage: Stage) -> StageSettings:
    path = request.stage_files[stage - 1]
    return builtin_stage_settings(request.policy, stage) if path is None else read_stage_settings(path, stage)


def _look_at_base(base: Path) -> CheckpointFolder | None:
    """What it is; None where it is not on this machine. InputError where it is not whole."""
    return read_checkpoint(base) if base.exists() else None
