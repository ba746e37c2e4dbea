"""How far a training is, for whoever asks from outside: one small file that is written again and again."""

import json
import os
import socket
import time
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_sft_recipes.training.checkpoints import TrainerState, checkpoint_name
from olt_toolkit.runtime.json_files import read_json

STATUS_FILE = "status.json"
_MOST_BYTES = 1 << 20
# The file is written at most so often, seconds.
INTERVAL = 1.0
# Steps over which the loss is averaged.
_RECENT = 20

Phase = Literal["reading samples", "training", "evaluating", "finished", "stopped"]


@dataclass
class StageStatus:
    """How far a stage is.

    Attributes:
        stage: 1 or 2.
        phase: what it does, or how it ended.
        step, steps: optimizer steps taken and in all.
        loss: mean loss of the last 20 steps; None before the first.
        seconds_left: of this stage, by the time of its steps since it was started, evaluations included; None before
            there are any.
        waiting_share: share of the time since it was started in which it waited for data.
        best: step and errors of the best evaluation; None where nothing was judged.
        why: why it stopped.
        host, process, process_start: who writes this; `process_start` tells a process from a later one of its number.
        time: when it was written, seconds since 1970.
    """

    stage: int
    phase: Phase
    step: int
    steps: int
    loss: float | None = None
    seconds_left: float | None = None
    waiting_share: float | None = None
    best: dict[str, Any] | None = None
    why: str | None = None
    host: str = ""
    process: int = 0
    process_start: str = ""
    time: float = 0.0

    def is_alive(self) -> bool | None:
        """Whether the process that wrote this still runs; None where it is on another machine."""
        if self.phase in ("finished", "stopped"):
            return False
        if self.host != socket.gethostname():
            return None
        return self.process_start != "" and _start_of(self.process) == self.process_start

    def describe(self) -> str:
        """Whether it runs, in words."""
        alive = self.is_alive()
        if alive is None:
            return f"not known: it ran on {self.host}, last sign {time.time() - self.time:.0f} s ago"
        if alive:
            return f"alive: process {self.process}, {self.phase}"
        if self.phase == "finished":
            return "finished"
        return (
            f"stopped: {self.why}" if self.phase == "stopped" else "dead; the same command goes on where it was saved"
        )


def status_of(state: TrainerState, phase: Phase, **further: Any) -> StageStatus:
    """The status of a stage that is so far; `further` are other fields of it."""
    losses = [row["loss"] for row in state.log_history[-_RECENT:]]
    best = next((e for e in state.evaluations if checkpoint_name(e["step"]) == state.best_model_checkpoint), None)
    loss = sum(losses) / len(losses) if losses else None
    return StageStatus(state.stage, phase, state.global_step, state.max_steps, loss, best=best, **further)


def write_status(folder: Path, status: StageStatus) -> None:
    """Write the status of a stage into its folder, as of now and by this process."""
    status.host, status.process, status.time = socket.gethostname(), os.getpid(), time.time()
    status.process_start = _start_of(status.process)
    with write_whole(folder / STATUS_FILE) as path:
        path.write_text(json.dumps(asdict(status), indent=2) + "\n")


def read_status(folder: Path) -> StageStatus | None:
    """The status of the stage in a folder; None where none was begun.

    Raises:
        InputError: the file is damaged or of another release.
    """
    path = folder / STATUS_FILE
    if not path.exists():
        return None
    content = read_json(path, "status of a training", _MOST_BYTES)
    if not isinstance(content, dict) or content.keys() != {known.name for known in fields(StageStatus)}:
        raise InputError(f"{path}: not the status of a training by this release; remove it")
    return StageStatus(**content)


def _places(folder: Path) -> tuple[Path, Path, Path]:
    """Where a training, or one stage, has its status."""
    return folder / "stage1", folder / "stage2", folder


def read_statuses(folder: Path) -> list[StageStatus]:
    """The stages of a training, or the one stage whose folder it is.

    Raises:
        InputError: no training was begun there.
    """
    found = [read_status(place) for place in _places(folder)]
    statuses = [status for status in found if status is not None]
    if not statuses:
        raise InputError(f"{folder}: no training was begun here; give the --out of `olt sft train` or `olt sft launch`")
    return statuses


def write_stopped(folder: Path, why: str) -> None:
    """Tell why a training stopped, or was not gone on with, in each stage that was begun and is not finished."""
    with suppress(InputError):  # who trains is told why anyway; a full disk takes no status
        for place in _places(folder):
            status = read_status(place)
            if status is not None and status.phase != "finished":
                write_status(place, replace(status, phase="stopped", why=why))


def _start_of(process: int) -> str:
    """When a process of this machine started, in ticks of its clock; "" where there is none or it has ended."""
    try:
        after_name = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return ""
    return "" if after_name[0] == "Z" else after_name[19]
