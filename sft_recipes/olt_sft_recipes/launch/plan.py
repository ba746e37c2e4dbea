"""What a launch of a public recipe is going to do: its data, its commands, and what their logs must say."""

import shlex
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from olt_datasets.mixtures.training_arithmetic import training_arithmetic
from olt_generator.errors import InputError
from olt_sft_recipes.launch.log_watch import Expected
from olt_sft_recipes.launch.lora import lora_groups
from olt_sft_recipes.launch.pai_data import PaiData
from olt_sft_recipes.launch.public_recipes import PublicRecipe, Stage
from olt_sft_recipes.launch.slurm import write_batch
from olt_sft_recipes.launch.stage_settings import (
    Difference,
    StageSettings,
    find_differences,
    shipped_values,
    to_overrides,
)
from olt_sft_recipes.launch.torchrun import Machines, recipe_words, to_shell
from olt_sft_recipes.launch.trainable import LORA_RANK, ModuleCount, count_trained
from olt_sft_recipes.preflight.checkpoint_folder import CONFIG
from olt_sft_recipes.preflight.parameters import ModelSizes
from olt_sft_recipes.preflight.plan import StagePlan

FINISHED = "finished.json"


@dataclass(frozen=True)
class Places:
    """Files and folders of a launch, all absolute.

    Attributes:
        out: everything that it writes.
        recipes: a clone of NVlabs/alpamayo-recipes.
        base: the released checkpoint, as it was downloaded.
        python: interpreter of the recipe's environment.
        vlm: local folder of the vision-language model's processor and vocabulary; None takes it from Hugging Face.
    """

    out: Path
    recipes: Path
    base: Path
    python: Path
    vlm: Path | None = None

    @property
    def torchrun(self) -> str:
        """Beside the interpreter."""
        return str(self.python.parent / "torchrun")

    @property
    def converted_base(self) -> Path:
        """Where the base is rewritten to the format that the recipe reads."""
        return self.out / "base"

    def recipe(self, recipe: PublicRecipe) -> Path:
        """The folder in which the recipe is run."""
        return self.recipes / "recipes" / recipe.package

    def stage(self, stage: Stage) -> Path:
        """`paths.output_dir` of a stage."""
        return self.out / f"stage{stage}"


@dataclass(frozen=True)
class StageLaunch:
    """One stage, ready to run.

    Attributes:
        stage: 1 or 2.
        arguments: what follows `torchrun` and its rendezvous.
        checkpoint: the last one, by the arithmetic of steps.
        expected: what its log must say.
        arithmetic: samples and steps.
        modules: what is trained.
        differences: from the shipped recipe.
        planned: the stage for preflight.
    """

    stage: Stage
    arguments: tuple[str, ...]
    checkpoint: Path
    expected: Expected
    arithmetic: dict[str, int]
    modules: tuple[ModuleCount, ...]
    differences: tuple[Difference, ...]
    planned: StagePlan


@dataclass(frozen=True)
class LaunchPlan:
    """A launch of a public recipe.

    Attributes:
        before: commands that run once before the stages.
        stages: those that run.
        base: the released checkpoint in the format that the recipe reads.
        stage1: Stage 1's checkpoint, which Stage 2 is given; None where Stage 2 does not run.
        evaluation: arguments of the evaluation behind `torchrun`; empty without validation clips.
    """

    recipe: PublicRecipe
    places: Places
    machines: Machines
    train: PaiData
    validation: PaiData | None
    before: tuple[tuple[str, ...], ...]
    stages: tuple[StageLaunch, ...]
    base: Path
    stage1: Path | None
    evaluation: tuple[str, ...]

    @property
    def left_before(self) -> tuple[tuple[str, ...], ...]:
        """Of `before`, what is still to be run: nothing once the base is rewritten, whose configuration comes last."""
        return () if (self.base / CONFIG).exists() else self.before

    def shell_before(self) -> list[str]:
        """The same for a shell, which looks when it runs."""
        written = shlex.quote(str(self.base / CONFIG))
        return [f"[ -f {written} ] || {to_shell(words)}" for words in self.before]

    def command(self, arguments: Sequence[str]) -> list[str]:
        """A whole `torchrun` command on one of the machines."""
        return [self.places.torchrun, *self.machines.rendezvous(), *arguments]

    def batch(self, options: Sequence[str] = ()) -> str:
        """The batch file for SLURM."""
        places = self.places
        return write_batch(
            places.out,
            places.recipe(self.recipe),
            places.torchrun,
            str(Path(sys.executable).parent / "olt"),
            self.machines.nodes,
            self.machines.gpus,
            [(each.stage, each.checkpoint, each.arguments) for each in self.stages],
            options,
            self.shell_before(),
            self.evaluation,
        )

    def to_dict(self) -> dict[str, Any]:
        """What `launch.json` and `--json` tell; equal for equal launches."""
        return {
            "policy": self.recipe.policy,
            "out": str(self.places.out),
            "base": str(self.base),
            "stage1_checkpoint": None if self.stage1 is None else str(self.stage1),
            "nodes": self.machines.nodes,
            "gpus": self.machines.gpus,
            "data": _data_to_dict(self.train),
            "validation": None if self.validation is None else _data_to_dict(self.validation),
            "before": [list(words) for words in self.before],
            "stages": [
                {
                    "stage": each.stage,
                    "arguments": list(each.arguments),
                    "checkpoint": str(each.checkpoint),
                    "expected": _expected_to_dict(each.expected),
                    "arithmetic": each.arithmetic,
                    "modules": [asdict(module) for module in each.modules],
                    "trained": sum(module.trained for module in each.modules),
                    "differences": [asdict(difference) for difference in each.differences],
                }
                for each in self.stages
            ],
            "evaluation": list(self.evaluation),
        }


def _data_to_dict(data: PaiData) -> dict[str, Any]:
    return {
        "local_dir": str(data.folder),
        "chunk_ids": data.chunk_ids,
        "clips": data.clips,
        "use_default_keyframe": not data.own_times,
        "notes": list(data.notes),
    }


def _expected_to_dict(expected: Expected) -> dict[str, Any]:
    return {
        name: [value.start, value.stop] if isinstance(value, range) else value
        for name, value in asdict(expected).items()
    }


def make_plan(
    recipe: PublicRecipe,
    places: Places,
    machines: Machines,
    train: PaiData,
    validation: PaiData | None,
    settings: Sequence[tuple[Stage, StageSettings]],
    sizes: ModelSizes,
    base_config: dict[str, Any] | None,
    stage1_checkpoint: Path | None = None,
    lora: bool = False,
) -> LaunchPlan:
    """Put a launch together.

    Args:
        settings: of the stages that run, in their order.
        sizes: of the model, to count what is trained.
        base_config: `config.json` of the released checkpoint; None where it is not here.
        stage1_checkpoint: for Stage 2 alone; else Stage 1's last one is taken.
        lora: Stage 1 trains adapters alone, where the recipe can.

    Raises:
        InputError: Stage 2 alone has no checkpoint of Stage 1, the recipe has no adapters, or a value cannot be given
            to Hydra.
    """
    before, base = _prepare_base(recipe, places, base_config)
    launches: list[StageLaunch] = []
    stage1 = stage1_checkpoint
    for stage, chosen in settings:
        if stage == 2 and stage1 is None:
            raise InputError("Stage 2 alone: give --stage1-checkpoint, the last checkpoint that Stage 1 left")
        added, adapters = _adapters(recipe, places, chosen) if lora and stage == 1 else ({}, {})
        groups = dict(chosen.groups) | added
        computed = _computed(recipe, places, stage, train, validation, base, stage1, base_config)
        values = dict(chosen.values) | computed | adapters
        launches.append(
            _stage_launch(recipe, places, machines, train, validation, stage, chosen, groups, values, sizes, adapters)
        )
        if stage == 1:
            stage1 = launches[-1].checkpoint
    used = stage1 if launches[-1].stage == 2 else None
    evaluation = _evaluation(recipe, places, machines, validation, launches[-1]) if validation else ()
    return LaunchPlan(recipe, places, machines, train, validation, before, tuple(launches), base, used, evaluation)


def _prepare_base(
    recipe: PublicRecipe, places: Places, config: dict[str, Any] | None
) -> tuple[tuple[tuple[str, ...], ...], Path]:
    """The base in the format that the recipe reads, and the commands that make it."""
    if not recipe.base_is_converted or (config or {}).get("model_type") == "alpamayo_r1":
        return (), places.base
    script = str(places.recipes / "scripts" / "convert_checkpoint.py")
    made = places.converted_base
    words = (str(places.python), script, "to-a1", "--input", str(places.base), "--output", str(made), "--overwrite")
    return (words,), made


def _adapters(recipe: PublicRecipe, places: Places, chosen: StageSettings) -> tuple[dict[str, str], dict[str, Any]]:
    """The group and the values that adapters need; what a file says of these values, where one was given, holds."""
    groups, values = lora_groups(places.recipe(recipe))
    kept = () if chosen.is_builtin else chosen.values
    return groups, {key: value for key, value in values.items() if key not in kept}


def _computed(
    recipe: PublicRecipe,
    places: Places,
    stage: Stage,
    train: PaiData,
    validation: PaiData | None,
    base: Path,
    stage1: Path | None,
    base_config: dict[str, Any] | None,
) -> dict[str, Any]:
    """What a launch must set, whatever the file of a stage: folders, chunks, times of samples, and what is logged."""
    values: dict[str, Any] = {
        "paths.output_dir": places.stage(stage),
        "hydra.run.dir": places.out / f"hydra/stage{stage}",
        "trainer.log_level": "info",
    }
    for name, data in (("train", train), ("val", validation or train)):
        prefix = f"data.{name}_dataset."
        values[f"{prefix}local_dir"] = data.folder
        values[f"{prefix}chunk_ids"] = data.chunk_ids
        values[f"{prefix}use_default_keyframe"] = not data.own_times
        if recipe.shows_camera_names:
            for key in ("include_camera_ids", "include_frame_nums"):
                values[f"{prefix}vla_preprocess_args.{key}"] = bool((base_config or {}).get(key, True))
    if stage == 1:
        values["model.checkpoint_path"] = base
        values["trainer.deepspeed"] = places.recipe(recipe) / "configs" / "deepspeed" / "zero2.json"
        if places.vlm is not None:
            values["model.vlm_name_or_path"] = places.vlm
    else:
        values["model.pretrained_model_name_or_path"] = base
        values["model.stage1_vlm_checkpoint_path"] = stage1
    return {key: str(value) if isinstance(value, Path) else value for key, value in values.items()}


def _stage_launch(
    recipe: PublicRecipe,
    places: Places,
    machines: Machines,
    train: PaiData,
    validation: PaiData | None,
    stage: Stage,
    chosen: StageSettings,
    groups: dict[str, str],
    values: dict[str, Any],
    sizes: ModelSizes,
    adapters: dict[str, Any],
) -> StageLaunch:
    arithmetic = training_arithmetic(train.clips, chosen.training(machines.devices))
    overrides = to_overrides(recipe.policy, stage, values, groups)
    planned = _stage_plan(stage, shipped_values(recipe.policy, stage) | values, bool(adapters))
    modules = tuple(count_trained(sizes, planned))
    steps = arithmetic["total_steps"]
    expected = Expected(
        stage,
        str(train.folder),
        train.chunks,
        train.clips,
        steps,
        sum(module.trained for module in modules),
        validation.chunks if validation and validation.folder == train.folder else None,
    )
    return StageLaunch(
        stage,
        (*recipe_words(machines.gpus, recipe.package, chosen.config_name, "train_hf"), *overrides),
        places.stage(stage) / f"checkpoint-{steps}",
        expected,
        arithmetic,
        modules,
        tuple(find_differences(recipe.policy, stage, values, adapters)),
        planned,
    )


def _stage_plan(stage: Stage, values: dict[str, Any], lora: bool) -> StagePlan:
    """A stage with all its values, set or shipped, for preflight."""
    trainer = {key.removeprefix("trainer."): value for key, value in values.items() if key.startswith("trainer.")}
    known = ("per_device_train_batch_size", "gradient_accumulation_steps", "num_train_epochs", "learning_rate")
    more = ("warmup_steps", "gradient_checkpointing", "save_steps", "save_total_limit")
    plan = StagePlan(stage, **{key: trainer[key] for key in (*known, *more) if trainer.get(key) is not None})
    return replace(
        plan,
        min_lr=float(trainer.get("lr_scheduler_kwargs.min_lr", 0.0)),
        zero_stage=2 if trainer.get("deepspeed") else 0,
        lora_rank=LORA_RANK if lora else None,
    )


def _evaluation(
    recipe: PublicRecipe, places: Places, machines: Machines, validation: PaiData, last: StageLaunch
) -> tuple[str, ...]:
    """Open-loop metrics of the trained policy; those of Stage 1 alone are of its tokens."""
    keys = {
        "data.val_dataset.local_dir",
        "data.val_dataset.chunk_ids",
        "data.val_dataset.use_default_keyframe",
        "hydra.run.dir",
        "paths.output_dir",
        "model.vlm_name_or_path",
        "model.cotrain_vlm",
        "trainer.deepspeed",
    }
    start = last.arguments.index("--config-name") + 2
    kept = []
    for word in last.arguments[start:]:
        key = word.partition("=")[0].lstrip("+")
        if key in keys or key.startswith(("data.val_dataset.vla_preprocess_args.", "evaluate.")) or "@" in key:
            kept.append(word)
    checkpoint = to_overrides(recipe.policy, last.stage, {"evaluate.eval_ckpt": str(last.checkpoint)})
    name = last.arguments[start - 1]
    return (*recipe_words(machines.gpus, recipe.package, name, "evaluate_hf"), *kept, *checkpoint)
