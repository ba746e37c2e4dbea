"""How far a training is, for whoever asks from outside: one small file that is written again and again."""

import json
import os
import socket
import time
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Literal

from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_toolkit.runtime.json_files import read_json

STATUS_FILE = "status.json"
_MOST_BYTES = 1 << 20
# The file is written at most so often, seconds.
INTERVAL = 1.0

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


def read_statuses(folder: Path) -> list[StageStatus]:
    """The stages of a training, or the one stage whose folder it is.

    Raises:
        InputError: no training was begun there.
    """
    found = [read_status(place) for place in (folder / "stage1", folder / "stage2", folder)]
    statuses = [status for status in found if status is not None]
    if not statuses:
        raise InputError(f"{folder}: no training was begun here; give the --out of `olt sft train` or `olt sft launch`")
    return statuses


def refuse_second_training(folder: Path) -> None:
    """Refuse to train where another living process does.

    Raises:
        InputError: it does.
    """
    status = read_status(folder)
    if status is not None and status.is_alive() and status.process != os.getpid():
        raise InputError(f"{folder}: process {status.process} is training here; wait for it, or choose another --out")


def _start_of(process: int) -> str:
    """When a process of this machine started, in ticks of its clock; "" where there is none or it has ended."""
    try:
        after_name = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return ""
    return "" if after_name[0] == "Z" else after_name[19]
