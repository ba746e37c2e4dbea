"""Two-stage training of the toy policy.

Stage 1 trains the vision-language model on trajectory tokens. Its loss is the mean cross-entropy over the future
tokens; the real recipe adds a second mean over the other labelled tokens (reasoning, end of message), which the toy
does not have, and the toy adds losses of its own (`training.auxiliary`). Stage 2 takes that model, freezes it, and
trains the action expert alone by flow matching (docs/formats/alpamayo.md, docs/formats/sft_recipes.md).

`OUT/stage1` and `OUT/stage2` hold checkpoints, a status and curves; `OUT/policy` is what drives
(docs/formats/training_folder.md).
"""

import json
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypedDict

import numpy as np
import torch

from olt_datasets import Mixture, MixtureDataset
from olt_generator.errors import InputError
from olt_generator.files import find_whole_folder, remove_whole_folder, sync_folder, write_whole_folder
from olt_generator.progress import Progress, silent
from olt_generator.seeds import derive_seed
from olt_sft_recipes.toy.checkpoint import ToyModel, load_tensors, read_config, read_model, read_tensors, write_model
from olt_sft_recipes.toy.config import ToyPolicyConfig
from olt_sft_recipes.training.checkpoints import (
    TrainerState,
    check_files,
    checkpoint_name,
    hash_tensors,
    list_checkpoints,
    read_state,
)
from olt_sft_recipes.training.curves import CURVES_FILE, draw_curves
from olt_sft_recipes.training.optimization import StageTraining
from olt_sft_recipes.training.processes import check_tracker, join_processes, tracking
from olt_sft_recipes.training.sample_arrays import LoadSamples, NameSample, SampleArrays, name_by_key
from olt_sft_recipes.training.stage_config import StageConfig
from olt_sft_recipes.training.status import (
    StageStatus,
    read_status,
    status_of,
    write_status,
    write_stopped,
)
from olt_sft_recipes.training.validation import Validation
from olt_toolkit import SampleKey
from olt_toolkit.runtime.folder_lock import alone_in
from olt_toolkit.runtime.json_files import read_json
from olt_toolkit.runtime.version import code_version
from olt_toolkit.runtime.workers import default_workers

Batches = Callable[[int, int], Sequence[Sequence[SampleKey]]]
"""The batches of an epoch, given its number and the samples of an optimizer step (`Mixture.epoch`)."""

StageChoice = Literal["1", "2", "both"]
SAMPLES_FOLDER = "samples"
POLICY_FOLDER = "policy"
VLM_PREFIX = "vlm."
# In the folder of a stage, under names that only files have which are being written or removed.
_LEFTOVERS = (".checkpoint-*", ".not-finite-*", ".status.*", ".curves.*", "checkpoint-*/.trainer_state.*")
# Most processes that decode ahead of a training; each holds samples of a piece and what it has imported.
_MOST_AHEAD = 4


@dataclass(frozen=True)
class StageResult:
    """What training one stage gave.

    Attributes:
        stage: 1 or 2.
        checkpoint: name of the checkpoint that goes on: into Stage 2, or as the policy. The best where the stage was
            judged, else the last.
        steps: optimizer steps after the regression warm-up.
        samples: distinct samples.
        losses: loss of each of the steps.
        final_loss: mean loss of the last tenth of the steps.
        regression_warmup_losses: before them, the loss of every step of the regression warm-up.
        saturated_tokens: future tokens of the samples as they are that stand for the end of the range.
        evaluations: step and errors of every evaluation (`validation.evaluate`), without its run time.
        vlm_sha256: hash of the vision-language model, which Stage 2 ends with as it began; None in Stage 1.
        seconds: run time, over all starts, with what was lost at a kill left out.
        seconds_of: of them were spent waiting for data, saving and evaluating; equal trainings differ in these two.
    """

    stage: int
    checkpoint: str
    steps: int
    samples: int
    losses: list[float]
    final_loss: float
    regression_warmup_losses: list[float]
    saturated_tokens: int
    evaluations: list[dict[str, Any]]
    vlm_sha256: str | None
    seconds: float
    seconds_of: dict[str, float]


def train_on_mixture(
    mixture: Mixture,
    stages: tuple[StageConfig, StageConfig],
    seed: int | None,
    out: Path,
    on_progress: Progress = silent,
    model_config: ToyPolicyConfig | None = None,
    validation: Validation = Validation(),  # noqa: B008 - frozen
    only: StageChoice = "both",
) -> list[StageResult]:
    """Train on a mixture, as `train_two_stages` does; a `seed` replaces those of the stages.

    The samples have the cameras of the model's contract.

    Raises:
        InputError: as `train_two_stages`, or a sample of the mixture cannot be loaded.
    """
    first, second = stages if seed is None else (stage.model_copy(update={"seed": seed}) for stage in stages)
    config = model_config or ToyPolicyConfig()
    dataset = MixtureDataset(mixture, image_size=None, contract=config.contract, **_sample_options(stages))
    return train_two_stages(
        (first, second),
        mixture.epoch,
        dataset.load_batch,
        out,
        config,
        on_progress,
        validation,
        only,
        min(default_workers() - 1, _MOST_AHEAD),
        dataset.name_sample,
    )


def train_two_stages(
    stages: tuple[StageConfig, StageConfig],
    batches: Batches,
    load_samples: LoadSamples,
    out: Path,
    model_config: ToyPolicyConfig | None = None,
    on_progress: Progress = silent,
    validation: Validation = Validation(),  # noqa: B008 - frozen
    only: StageChoice = "both",
    workers: int = 0,
    name_sample: NameSample = name_by_key,
) -> list[StageResult]:
    """Train both stages, or one; `out/policy` is what drives once Stage 2 is finished.

    A stage that the same code began with the same configuration, samples and Stage 1 goes on at its last checkpoint,
    and is taken as it is where it was finished; any other is trained anew. It goes on exactly: the losses are those of
    a training that was never interrupted.

    Args:
        stages: how to train.
        batches: the batches of each epoch.
        load_samples: loads samples by key; each distinct sample is loaded once and kept in files while it trains.
        out: folder of the training.
        model_config: sizes of a new model; None for the usual ones.
        on_progress: told the share of the work that is done.
        validation: what the stages are judged by while they train.
        only: which stage to train; "2" goes on from the finished Stage 1 in `out`.
        workers: most processes that decode samples while this one trains; `load_samples` can be pickled then.
        name_sample: what tells a sample from any other: a stage is trained anew where it changes.

    Raises:
        InputError: the stages are not 1 and 2, Stage 1 is missing, unfinished or of another model, another process
            trains there, a loss is not finite, a sample or checkpoint is damaged, or a stage's weights do not match
            the model.
    """
    first, second = (stage.stage for stage in stages)
    if (first, second) != (1, 2):
        raise InputError(f"training: stages {first} and {second} were given; give stage 1, then stage 2")
    config = model_config or ToyPolicyConfig()
    steps = [_list_steps(stage, batches) for stage in stages]
    chosen = [0, 1] if only == "both" else [int(only) - 1]
    keys = sorted({key for index in chosen for epoch in steps[index] for batch in epoch for key in batch})
    results: list[StageResult] = []
    with _keeping_samples(stages, keys, load_samples, config, out, workers, name_sample) as samples:
        for index in chosen:
            folder, after = out / f"stage{index + 1}", [out / POLICY_FOLDER, out / "stage2"][: 2 - index]
            before = None if index == 0 else _finished_stage1(out / "stage1", config)
            share = lambda done, index=index: on_progress((chosen.index(index) + done) / len(chosen))  # noqa: E731
            plan = _StagePlan(stages[index], steps[index], name_sample, before, folder, after, config, validation)
            results.append(_train(plan, samples, share))
        if 1 in chosen:
            _publish(out / "stage2" / results[-1].checkpoint, out / POLICY_FOLDER)
    return results


def train_stage(
    stage: StageConfig,
    batches: Batches,
    load_samples: LoadSamples,
    checkpoint_in: Path | None,
    out: Path,
    model_config: ToyPolicyConfig | None = None,
    on_progress: Progress = silent,
    validation: Validation = Validation(),  # noqa: B008 - frozen
) -> StageResult:
    """Train one stage into a folder of its own, as `train_two_stages` does.

    Args:
        stage: how to train.
        batches, load_samples, on_progress, validation: as there.
        checkpoint_in: the Stage 1 checkpoint that Stage 2 starts from; None for Stage 1.
        out: folder of the stage.
        model_config: sizes of a new model; None for the usual ones, or those of the checkpoint.

    Raises:
        InputError: as there, or Stage 2 has no checkpoint.
    """
    steps = _list_steps(stage, batches)
    keys = sorted({key for epoch in steps for batch in epoch for key in batch})
    if stage.stage == 2 and checkpoint_in is None:
        raise InputError("stage 2 starts from a Stage 1 folder; give one")
    config = read_config(checkpoint_in) if checkpoint_in is not None else model_config or ToyPolicyConfig()
    plan = _StagePlan(stage, steps, name_by_key, checkpoint_in, out, [], config, validation)
    with _keeping_samples([stage], keys, load_samples, config, out) as samples:
        return _train(plan, samples, on_progress)


def read_results(out: Path, only: StageChoice = "both") -> list[StageResult]:
    """What the finished stages of a training gave.

    Raises:
        InputError: one of them has no checkpoint.
    """
    folders = [out / f"stage{number}" for number in ((1, 2) if only == "both" else (int(only),))]
    for folder in folders:
        if not list_checkpoints(folder):
            raise InputError(f"{folder}: holds no checkpoint; train this stage")
    return [_result(read_state(list_checkpoints(folder)[-1])) for folder in folders]


@dataclass(frozen=True)
class _StagePlan:
    """What a stage is to be trained from, before anything is loaded, and the folders of what is made from it."""

    stage: StageConfig
    epochs: list[list[list[SampleKey]]]
    name_sample: NameSample
    checkpoint_in: Path | None
    folder: Path
    after: list[Path]
    config: ToyPolicyConfig
    validation: Validation

    def identity(self) -> str:
        """What decides the result, as a hash."""
        before = "" if self.checkpoint_in is None else read_state(self.checkpoint_in).identity
        judged = self.validation.identity(self.stage.stage)
        order = derive_seed(*(self.name_sample(key) for epoch in self.epochs for step in epoch for key in step))
        settings = self.stage.decides_weights(), self.config.model_dump_json()
        return f"{derive_seed(code_version(), *settings, order, before, judged):x}"

    def max_steps(self) -> int:
        return sum(map(len, self.epochs))


def _list_steps(stage: StageConfig, batches: Batches) -> list[list[list[SampleKey]]]:
    """The keys of each optimizer step of each epoch."""
    sizes = stage.samples_per_step
    return [[list(batch) for batch in batches(epoch, sizes)] for epoch in range(stage.num_train_epochs)]


@contextmanager
def _keeping_samples(
    stages: Sequence[StageConfig],
    keys: list[SampleKey],
    load_samples: LoadSamples,
    config: ToyPolicyConfig,
    out: Path,
    workers: int = 0,
    name_sample: NameSample = name_by_key,
) -> Iterator[SampleArrays]:
    """The samples of a training, which is alone in its folder, and whose status tells why it stopped.

    They are removed when it has come to its end.
    """
    for stage in stages:
        check_tracker(stage.report_to)
    is_main = join_processes().is_main_process
    options = json.dumps(_sample_options(stages))
    busy = "another process is training here (`olt sft status`); wait for it, or choose another --out"
    with alone_in(out, busy) if is_main else nullcontext():
        folder = out / SAMPLES_FOLDER
        try:
            with SampleArrays(keys, load_samples, config, folder, workers, name_sample, options) as samples:
                yield samples
        except InputError as error:
            if is_main:
                write_stopped(out, str(error))
            raise
        if is_main:
            shutil.rmtree(folder, ignore_errors=True)


class _SampleOptions(TypedDict):
    with_origin: bool
    with_truth: bool


def _sample_options(stages: Sequence[StageConfig]) -> _SampleOptions:
    """What of the samples is loaded for these stages, as `MixtureDataset` takes it."""
    return {
        "with_origin": any(stage.invented_pixel_weight < 1.0 for stage in stages),
        "with_truth": any(stage.stage == 1 and stage.sight_weight > 0.0 for stage in stages),
    }


def _finished_stage1(folder: Path, config: ToyPolicyConfig) -> Path:
    """The checkpoint of Stage 1 that goes on into Stage 2.

    Raises:
        InputError: there is none, Stage 1 is not finished, or its model is of another configuration.
    """
    found = list_checkpoints(folder)
    if not found:
        raise InputError(f"{folder}: holds no Stage 1 for Stage 2 to start from; train stage 1 there first")
    state = read_state(found[-1])
    if state.global_step < state.max_steps:
        raise InputError(
            f"{folder}: Stage 1 is at step {state.global_step} of {state.max_steps}; finish it first, with --stage 1"
        )
    checkpoint = folder / (state.best_model_checkpoint or found[-1].name)
    check_files(checkpoint)
    trained, asked = read_config(checkpoint).model_dump(), config.model_dump()
    differing = [f"{name} {trained[name]} instead of {asked[name]}" for name in asked if trained[name] != asked[name]]
    if differing:
        raise InputError(f"{folder}: Stage 1 has {', '.join(differing)}; train both stages alike, as with one --rig")
    return checkpoint


def _train(plan: _StagePlan, samples: SampleArrays, on_progress: Progress) -> StageResult:
    """Train what is left of a stage."""
    accelerator = join_processes(plan.stage.report_to, plan.folder)
    identity, resumed = plan.identity(), None
    checkpoints = list_checkpoints(plan.folder)
    if checkpoints and read_state(checkpoints[-1]).identity == identity:
        resumed = checkpoints[-1]
    state = None if resumed is None else read_state(resumed)
    accelerator.wait_for_everyone()  # before one of them changes what all have read
    if accelerator.is_main_process:
        _remove_leftovers(plan)
    if state is not None and state.global_step == state.max_steps and not _is_to_be_judged(plan, state):
        if accelerator.is_main_process:
            _tell_finished(plan.folder, state)
        on_progress(1.0)
        return _result(state)
    if resumed is not None:
        check_files(resumed)
    if accelerator.is_main_process:
        if resumed is None:
            _clear(plan)
        reading = StageStatus(
            plan.stage.stage, "reading samples", 0 if state is None else state.global_step, plan.max_steps()
        )
        write_status(plan.folder, reading)
    rows = {key: row for row, key in enumerate(samples.keys)}
    steps = [[rows[key] for key in step] for epoch in plan.epochs for step in epoch]
    start = time.perf_counter()
    with accelerator.main_process_first():
        left = steps if state is None else steps[state.global_step :]
        samples.open(left, whole=accelerator.num_processes > 1)
    read = time.perf_counter() - start
    model = _make_model(plan) if resumed is None else _freeze(plan.stage, read_model(resumed))
    state = state or _new_state(plan, identity, model)
    for what in ("all", "waiting for data"):
        state.seconds[what] = state.seconds.get(what, 0.0) + read
    with tracking(accelerator, f"stage{plan.stage.stage}", plan.stage.model_dump()):
        StageTraining(
            plan.stage,
            plan.folder,
            model,
            samples,
            steps,
            state,
            resumed,
            plan.validation,
            accelerator,
            on_progress,
        ).run()
    accelerator.wait_for_everyone()
    return _result(read_state(list_checkpoints(plan.folder)[-1]))


def _is_to_be_judged(plan: _StagePlan, state: TrainerState) -> bool:
    """Whether the training was killed while its last checkpoint was judged."""
    judged = [evaluation["step"] for evaluation in state.evaluations]
    return plan.validation.judges(plan.stage.stage) and state.global_step not in judged


def _tell_finished(folder: Path, state: TrainerState) -> None:
    """Draw and tell what a training that was killed after its last step did not."""
    status = read_status(folder)
    if status is None or status.phase != "finished":
        draw_curves(folder / CURVES_FILE, state)
        write_status(folder, status_of(state, "finished"))


def _remove_leftovers(plan: _StagePlan) -> None:
    """Remove what killed processes left half written or half removed."""
    for path in [found for pattern in _LEFTOVERS for found in plan.folder.glob(pattern)]:
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    for folder in plan.after:
        for path in folder.parent.glob(f".{folder.name}.*"):
            if path != find_whole_folder(folder):
                shutil.rmtree(path)


def _clear(plan: _StagePlan) -> None:
    """Remove what another training left in the folder of a stage, after all that was made from it."""
    for path in [*plan.after, *plan.folder.glob("checkpoint-*"), *plan.folder.glob("not-finite-*")]:
        remove_whole_folder(path)
    (plan.folder / CURVES_FILE).unlink(missing_ok=True)


def _new_state(plan: _StagePlan, identity: str, model: ToyModel) -> TrainerState:
    stage = plan.stage
    return TrainerState(
        identity=identity,
        stage=stage.stage,
        seed=stage.seed,
        max_steps=plan.max_steps(),
        warmup_steps=sum(map(len, plan.epochs[: stage.regression_warmup_epochs])),
        samples=len({key for epoch in plan.epochs for step in epoch for key in step}),
        samples_per_step=stage.samples_per_step,
        num_train_epochs=stage.num_train_epochs,
        vlm_sha256=hash_tensors(model.vlm) if stage.stage == 2 else None,
    )


def _make_model(plan: _StagePlan) -> ToyModel:
    """A new model for Stage 1; for Stage 2 that of the checkpoint, frozen, with a new action expert."""
    with torch.random.fork_rng():
        if plan.checkpoint_in is None:
            torch.manual_seed(derive_seed("weights", plan.stage.seed))
            return ToyModel(plan.config)
        torch.manual_seed(derive_seed("weights", plan.stage.seed, 2))
        model = ToyModel(read_config(plan.checkpoint_in))
    tensors = read_tensors(plan.checkpoint_in)
    vlm = {name.removeprefix(VLM_PREFIX): tensor for name, tensor in tensors.items() if name.startswith(VLM_PREFIX)}
    load_tensors(model.vlm, vlm, plan.checkpoint_in)
    return _freeze(plan.stage, model)


def _freeze(stage: StageConfig, model: ToyModel) -> ToyModel:
    if stage.stage == 2:
        model.vlm.requires_grad_(False)
    return model


def _result(state: TrainerState) -> StageResult:
    assert state.saturated_tokens is not None, "counted at the last step"
    losses, warmup = [row["loss"] for row in state.log_history], state.warmup_steps
    last = losses[-max(1, len(losses[warmup:]) // 10) :]
    return StageResult(
        stage=state.stage,
        checkpoint=state.best_model_checkpoint or checkpoint_name(state.global_step),
        steps=len(losses[warmup:]),
        samples=state.samples,
        losses=losses[warmup:],
        final_loss=round(float(np.mean(last)), 6),
        regression_warmup_losses=losses[:warmup],
        saturated_tokens=state.saturated_tokens,
        evaluations=[{name: of for name, of in row.items() if name != "seconds"} for row in state.evaluations],
        vlm_sha256=state.vlm_sha256,
        seconds=state.seconds["all"],
        seconds_of={name: seconds for name, seconds in state.seconds.items() if name != "all"},
    )


def _publish(checkpoint: Path, policy: Path) -> None:
    """Make the policy folder from a checkpoint, unless it is that already."""
    about = {"identity": read_state(checkpoint).identity, "checkpoint": checkpoint.name}
    said = find_whole_folder(policy) / "trained.json"
    if join_processes().is_main_process and not (said.exists() and read_json(said, "origin of a policy") == about):
        check_files(checkpoint)
        with write_whole_folder(policy) as temporary:
            write_model(temporary, read_model(checkpoint))
            (temporary / "trained.json").write_text(json.dumps(about, indent=2) + "\n")
            sync_folder(temporary)
    join_processes().wait_for_everyone()
