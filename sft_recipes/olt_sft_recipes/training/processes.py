"""The processes that train together, through accelerate, and whoever is told of the losses while they train."""

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any

from accelerate import Accelerator, InitProcessGroupKwargs
from accelerate.utils import is_tensorboard_available, is_wandb_available

from olt_generator.errors import InputError
from olt_sft_recipes.training.stage_config import Tracker

# While the main process decodes or judges, the others wait; one that dies is noticed by torchrun.
_LONGEST_WAIT = timedelta(hours=24)
_AVAILABLE = {"tensorboard": is_tensorboard_available, "wandb": is_wandb_available}


def join_processes(tracker: Tracker = "none", folder: Path | None = None) -> Accelerator:
    """The processes that torchrun or `accelerate launch` started, or this one alone; the toy needs no accelerator.

    Args:
        tracker: who is told what `Accelerator.log` is given.
        folder: where TensorBoard's files go.

    Raises:
        InputError: the tracker is not installed.
    """
    check_tracker(tracker)
    return Accelerator(
        cpu=True,
        log_with=None if tracker == "none" else tracker,
        project_dir=folder,
        kwargs_handlers=[InitProcessGroupKwargs(timeout=_LONGEST_WAIT)],
    )


@contextmanager
def tracking(accelerator: Accelerator, name: str, settings: dict[str, Any]) -> Iterator[None]:
    """Open the tracker of `join_processes`, if there is one, and close it."""
    if accelerator.log_with:
        accelerator.init_trackers(name, config=settings)
    try:
        yield
    finally:
        for tracker in accelerator.trackers:
            tracker.finish()


def run_on_processes(arguments: Sequence[str], processes: int) -> None:
    """Run `olt ARGUMENTS` on so many processes of this machine, by torchrun.

    Raises:
        InputError: it fails; the processes have said why.
    """
    torchrun = [sys.executable, "-m", "torch.distributed.run", "--standalone", f"--nproc-per-node={processes}"]
    done = subprocess.run([*torchrun, "-m", "olt_toolkit", *arguments], env={**os.environ, "OMP_NUM_THREADS": "1"})
    if done.returncode:
        raise InputError(f"{processes} processes: training ended with status {done.returncode}; see above why")


def is_main_process() -> bool:
    """Whether this process is the one that speaks, asked before any others are joined."""
    return os.environ.get("RANK", "0") == "0"


def check_tracker(tracker: Tracker) -> None:
    """Check that whoever is to be told of the losses is installed.

    Raises:
        InputError: it is not.
    """
    if tracker != "none" and not _AVAILABLE[tracker]():
        raise InputError(f"report_to {tracker}: {tracker} is not installed; `pip install {tracker}`, or take none")
