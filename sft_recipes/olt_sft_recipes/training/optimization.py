"""The steps of a stage: prepared ahead, taken on one process or more, saved, judged, and gone on with after a kill."""

import math
import time
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from accelerate import Accelerator
from torch import Tensor, nn

from olt_generator.errors import InputError
from olt_generator.poses import Array
from olt_generator.progress import Progress
from olt_generator.seeds import derive_seed
from olt_sft_recipes.toy.checkpoint import ToyModel
from olt_sft_recipes.toy.tokens import encode_actions
from olt_sft_recipes.training.checkpoints import (
    TrainerState,
    checkpoint_name,
    hash_tensors,
    list_checkpoints,
    prune_checkpoints,
    restore_optimizer,
    save_checkpoint,
    update_state,
)
from olt_sft_recipes.training.curves import CURVES_FILE, draw_curves
from olt_sft_recipes.training.failed_step import save_failed_step
from olt_sft_recipes.training.objectives import TrainingBatch, draw_step, prepare_batch, sample_losses
from olt_sft_recipes.training.sample_arrays import SampleArrays
from olt_sft_recipes.training.stage_config import StageConfig
from olt_sft_recipes.training.status import INTERVAL, Phase, status_of, write_status
from olt_sft_recipes.training.validation import Validation, evaluate, rank

# Steps whose batches are prepared while one is taken.
_AHEAD = 2
# Samples whose tokens are counted at once.
_AT_ONCE = 1024

Parts = list[tuple[TrainingBatch, Tensor]]
"""What one process computes of a step: batches, and the weight of each of their samples in the loss."""


@dataclass
class StageTraining:
    """One stage while it is trained.

    Attributes:
        stage: how to train.
        folder: of the stage; its checkpoints stand there.
        model: with the weights of the last checkpoint, or the first ones.
        samples: all samples, some of which are still decoded.
        steps: the samples of every optimizer step.
        state: how far it is.
        resumed: the checkpoint that it goes on from; None for none.
        validation: what it is judged by.
        accelerator: the processes that train.
        on_progress: told the share of the steps that is done.
    """

    stage: StageConfig
    folder: Path
    model: ToyModel
    samples: SampleArrays
    steps: list[list[int]]
    state: TrainerState
    resumed: Path | None
    validation: Validation
    accelerator: Accelerator
    on_progress: Progress

    def __post_init__(self) -> None:
        self.trained = self.model.vlm if self.stage.stage == 1 else self.model.expert
        self.optimizer = torch.optim.AdamW(
            self.trained.parameters(), lr=self.stage.learning_rate, weight_decay=self.stage.weight_decay
        )
        if self.resumed is not None:
            restore_optimizer(self.resumed, self.trained, self.optimizer)
        self.started, self.told, self.first_step = time.perf_counter(), 0.0, self.state.global_step
        self.seconds_before = dict(self.state.seconds)

    def run(self) -> None:
        """Take the steps that are left.

        Raises:
            InputError: a loss or gradient is not finite, or a sample is damaged.
        """
        try:
            with _reproducible():
                self._take_steps()
        except InputError as error:
            self._tell("stopped", str(error), now=True)
            raise
        if self.accelerator.is_main_process:
            draw_curves(self.folder / CURVES_FILE, self.state)
        self._tell("finished", now=True)

    def _take_steps(self) -> None:
        self._judge_if_due()
        for step, parts in self._prepared():
            self._take_step(step, parts)
            self._save_if_due()
            self._judge_if_due()
            self._tell("training")
            self.on_progress(self.state.global_step / len(self.steps))

    def _prepared(self) -> Iterator[tuple[int, Parts]]:
        """The steps that are left, each with its batches, which a thread prepares while others are computed."""
        left = iter(range(self.state.global_step, len(self.steps)))
        with ThreadPoolExecutor(1) as pool:
            waiting: deque[tuple[int, Future[Parts]]] = deque()
            while True:
                while len(waiting) < _AHEAD and (step := next(left, None)) is not None:
                    waiting.append((step, pool.submit(self._prepare, step)))
                if not waiting:
                    return
                step, future = waiting.popleft()
                with self._timed("waiting for data"):
                    parts = future.result()
                yield step, parts

    def _prepare(self, step: int) -> Parts:
        """This process's parts of a step: which they are has no influence on what is drawn."""
        rows, world = np.asarray(self.steps[step]), self.accelerator.num_processes
        samples = self.samples.having(self.steps[step])
        weights = _normalised(samples.weights(self.stage.invented_pixel_weight, rows))
        draws = draw_step(self.stage, len(rows), step)
        parts = min(self.stage.gradient_accumulation_steps * world, len(rows))
        mine = np.array_split(np.arange(len(rows)), parts)[self.accelerator.process_index :: world]
        if not mine:  # a process for which no sample is left steps along, with one that counts nothing
            mine, weights = [np.arange(1)], np.zeros(len(rows))
        return [
            (
                prepare_batch(samples.take(rows[part].tolist()), {name: of[part] for name, of in draws.items()}),
                torch.from_numpy(weights[part].astype(np.float32)),
            )
            for part in mine
        ]

    def _take_step(self, step: int, parts: Parts) -> None:
        rate = self.stage.learning_rate_at(step, len(self.steps))
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        torch.manual_seed(derive_seed("model", self.stage.seed, self.stage.stage, step))
        loss = 0.0
        for batch, weights in parts:
            weighted = sample_losses(self.model, self.stage, batch, step < self.state.warmup_steps) @ weights
            weighted.backward()
            loss += weighted.item()
        loss, norm = self._sum_over_processes(loss), self._clip_gradient()
        if not (math.isfinite(loss) and math.isfinite(norm)):
            self._stop(step, loss, norm)
        self.optimizer.step()
        self.optimizer.zero_grad()
        self.state.global_step = step + 1
        epoch = (step + 1) * self.state.num_train_epochs / len(self.steps)
        row = {"step": step + 1, "epoch": epoch, "loss": loss, "learning_rate": rate, "grad_norm": norm}
        self.state.log_history.append(row)
        self.accelerator.log({name: row[name] for name in ("loss", "learning_rate", "grad_norm")}, step=step + 1)

    def _sum_over_processes(self, loss: float) -> float:
        if self.accelerator.num_processes == 1:
            return loss
        total = self.accelerator.reduce(torch.tensor(loss, dtype=torch.float64))
        return float(total)  # pyright: ignore[reportArgumentType] - a tensor gives a tensor

    def _clip_gradient(self) -> float:
        """Sum the gradients of all processes, and scale them down to the largest norm; returns the norm before.

        Each process's loss is its share of one weighted mean, so the gradients are summed, where DDP would average.
        """
        gradients = [parameter.grad for parameter in self.trained.parameters() if parameter.grad is not None]
        if self.accelerator.num_processes > 1:
            flat: Any = self.accelerator.reduce(torch.cat([gradient.flatten() for gradient in gradients]))
            for gradient, part in zip(gradients, flat.split([gradient.numel() for gradient in gradients]), strict=True):
                gradient.copy_(part.view_as(gradient))
        return nn.utils.clip_grad_norm_(self.trained.parameters(), self.stage.max_grad_norm).item()

    def _stop(self, step: int, loss: float, norm: float) -> None:
        where = self.folder / f"not-finite-step-{step + 1}"
        why = f"the loss of step {step + 1} is {loss}, the norm of its gradient {norm}"
        if self.accelerator.is_main_process:
            rows = self.steps[step]
            keys = [self.samples.keys[row] for row in rows]
            save_failed_step(where, self.samples.having(rows).take(rows), keys, step, why)
        self.accelerator.wait_for_everyone()  # the first process that ends takes the others with it
        kept = list_checkpoints(self.folder)
        last = f"{kept[-1].name} is kept" if kept else "none was saved before"
        raise InputError(
            f"stage {self.stage.stage}: {why}; its batch is in {where}. Look at these samples, or lower learning_rate "
            f"or max_grad_norm ({last})"
        )

    def _count_saturated(self) -> int:
        """Future tokens of all samples that stand for the end of the range."""
        samples = self.samples.having(range(len(self.samples.keys)))
        parts = [slice(start, start + _AT_ONCE) for start in range(0, len(samples), _AT_ONCE)]
        return sum(encode_actions(samples.take(part).actions())[1] for part in parts)

    def _is_due(self, interval: int) -> bool:
        step = self.state.global_step
        return step == len(self.steps) or (step > 0 and step % interval == 0)

    def _judging_is_due(self) -> bool:
        interval = self.stage.evaluation_interval(len(self.steps))
        return self.validation.judges(self.stage.stage) and self._is_due(interval)

    def _save_if_due(self) -> None:
        if not (self._is_due(self.stage.save_steps) or self._judging_is_due()):
            return
        if self.stage.stage == 2 and hash_tensors(self.model.vlm) != self.state.vlm_sha256:
            raise RuntimeError("stage 2 changed the frozen vision-language model")
        if self.state.global_step == len(self.steps):
            self._tell("reading samples", now=True)  # who goes on late in an epoch has most of them still to decode
            with self._timed("waiting for data"):
                self.state.saturated_tokens = self._count_saturated()
        if self.accelerator.is_main_process:
            with self._timed("saving"):
                save_checkpoint(self.folder, self.model, self.trained, self.optimizer, self._timed_state())
                self._prune()
        self.accelerator.wait_for_everyone()

    def _judge_if_due(self) -> None:
        """Judge the checkpoint that was just saved, or that training goes on from and was killed before."""
        step, judged = self.state.global_step, [evaluation["step"] for evaluation in self.state.evaluations]
        if not self._judging_is_due() or step in judged:
            return
        if self.accelerator.is_main_process:
            self._tell("evaluating", now=True)
            checkpoint = self.folder / checkpoint_name(step)
            with self._timed("evaluating"):
                evaluation = {"step": step, **evaluate(checkpoint, self.stage, self.validation)}
            self.state.evaluations.append(evaluation)
            best = min(self.state.evaluations, key=rank)
            self.state.best_model_checkpoint = checkpoint_name(best["step"])
            update_state(checkpoint, self._timed_state())
            self._prune()
            draw_curves(self.folder / CURVES_FILE, self.state)
            self.accelerator.log(_numbers(evaluation), step=step)
        self.accelerator.wait_for_everyone()

    def _prune(self) -> None:
        prune_checkpoints(self.folder, self.stage.save_total_limit, self.state.best_model_checkpoint)

    @contextmanager
    def _timed(self, what: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.state.seconds[what] = self.state.seconds.get(what, 0.0) + time.perf_counter() - start

    def _timed_state(self) -> TrainerState:
        """The state, with the run time up to now."""
        self.state.seconds["all"] = self.seconds_before.get("all", 0.0) + time.perf_counter() - self.started
        return self.state

    def _tell(self, phase: Phase, why: str | None = None, now: bool = False) -> None:
        """Write the status, at most once a second unless it is `now` that matters."""
        elapsed = time.perf_counter() - self.started
        if not self.accelerator.is_main_process or (elapsed - self.told < INTERVAL and not now):
            return
        self.told = elapsed
        state, taken = self.state, self.state.global_step - self.first_step
        waited = state.seconds.get("waiting for data", 0.0) - self.seconds_before.get("waiting for data", 0.0)
        status = status_of(
            state,
            phase,
            seconds_left=elapsed / taken * (len(self.steps) - state.global_step) if taken else None,
            waiting_share=waited / elapsed if taken else None,
            why=why,
        )
        write_status(self.folder, status)


def _normalised(weights: Array) -> Array:
    """Weights divided by their sum; where nothing of any sample counts, the step learns nothing."""
    return weights / total if (total := weights.sum()) > 0.0 else weights


def _numbers(evaluation: dict[str, Any]) -> dict[str, float]:
    """The errors of an evaluation, for a tracker."""
    nested = {**(evaluation["open_loop"] or {}), **(evaluation["closed_loop"] or {}), "loss": evaluation["eval_loss"]}
    return {f"eval/{name}": float(value) for name, value in nested.items() if value is not None}


@contextmanager
def _reproducible() -> Iterator[None]:
    """One thread and algorithms that sum in one order make equal trainings equal byte for byte."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    torch.use_deterministic_algorithms(True)
    try:
        with torch.random.fork_rng():
            yield
    finally:
        torch.set_num_threads(threads)
        torch.use_deterministic_algorithms(False)
