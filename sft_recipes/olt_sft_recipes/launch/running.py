"""Running the commands of a launch on this machine, one after the other; what is finished is kept."""

import ctypes
import math
import os
import re
import signal
import subprocess
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from olt_generator.errors import InputError
from olt_generator.progress import Progress
from olt_sft_recipes.launch.checkpoints import check_stage1
from olt_sft_recipes.launch.following import follow, followed, keep
from olt_sft_recipes.launch.log_watch import LogWatch
from olt_sft_recipes.launch.plan import LaunchPlan, StageLaunch

ENVIRONMENT = {"PYTHONUNBUFFERED": "1", "HYDRA_FULL_ERROR": "1"}
# Between being asked to end and being ended: a checkpoint may be half written.
_SECONDS_TO_END = 30.0


def run_stage(plan: LaunchPlan, launch: StageLaunch, on_progress: Progress) -> dict[str, Any]:
    """Train one stage, unless an earlier launch finished it.

    The recipe cannot resume within a stage. What an interrupted one left is moved aside, so that its checkpoints are
    not taken for new ones.

    Raises:
        InputError: the command fails, or see `follow`; every process of it is ended.
    """
    stage = followed(plan, launch)
    if (kept := keep(stage)) is not None:
        return kept | {"kept": True}
    if launch.stage == 2 and plan.stage1 is not None:
        check_stage1(plan.stage1, plan.base)
    set_aside(stage.folder)
    with _running(plan.command(launch.arguments), plan) as lines:
        return follow(stage, lines, on_progress) | {"kept": False}


def run_evaluation(plan: LaunchPlan, on_progress: Progress) -> dict[str, float]:
    """Open-loop metrics of the last checkpoint by the recipe's own evaluation; InputError where one is not finite."""
    watch = LogWatch(plan.stages[-1].expected)
    with _running(plan.command(plan.evaluation), plan) as lines, _kept(plan, "evaluation.log") as log:
        for line in lines:
            log.write(line)
            watch.see_metric(line)
            on_progress(0.5)
    if not watch.metrics:
        raise InputError(f"{plan.places.out}/logs/evaluation.log: the evaluation printed no metric")
    endless = [name for name, value in watch.metrics.items() if not math.isfinite(value)]
    if endless:
        raise InputError(
            f"{plan.places.out}/logs/evaluation.log: {', '.join(endless)}: not finite; look at the validation "
            "clips and at the losses of the training"
        )
    return watch.metrics


def run_before(plan: LaunchPlan) -> None:
    """Rewrite the base, where it must be and was not yet."""
    for words in plan.left_before:
        with _running(words, plan) as lines, _kept(plan, "base.log") as log:
            log.writelines(lines)


def set_aside(folder: Path) -> Path | None:
    """Give a folder that is there another name; returns it."""
    if not folder.exists():
        return None
    number = 1
    while (aside := folder.with_name(f"{folder.name}_interrupted_{number}")).exists():
        number += 1
    folder.rename(aside)
    return aside


@contextmanager
def _kept(plan: LaunchPlan, name: str) -> Iterator[Any]:
    path = plan.places.out / "logs" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as log:
        yield log


@contextmanager
def _running(words: Sequence[str], plan: LaunchPlan) -> Iterator[Iterator[str]]:
    """The output of a command, line by line; whatever happens, nothing of it runs on afterwards."""
    folder = plan.places.recipe(plan.recipe)
    environment: Mapping[str, str] = os.environ | ENVIRONMENT
    try:
        process = subprocess.Popen(
            words,
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
            preexec_fn=_end_with_parent,
        )
    except OSError as error:
        raise InputError(
            f"{words[0]}: cannot be started in {folder} ({error.strerror}); is --python of the recipe's environment?"
        ) from error
    try:
        yield _lines(process, Path(words[0]).name)
    finally:
        _end(process)


def _lines(process: "subprocess.Popen[str]", name: str) -> Iterator[str]:
    """What a process prints; InputError once it has ended with another status than 0."""
    assert process.stdout is not None
    last: deque[str] = deque(maxlen=200)
    for line in process.stdout:
        last.append(line.strip())
        yield line
    if process.wait() != 0:
        # A launcher of several processes has the last word, and the reason stands above it.
        telling = [line for line in last if re.match(r"[\w.]*(Error|Exception)\b", line)] or [
            line for line in last if line
        ]
        raise InputError(f"{name} ended with status {process.returncode}: {telling[-1] if telling else 'no output'}")


_LIBC = ctypes.CDLL(None)
_PR_SET_PDEATHSIG = 1


def _end_with_parent() -> None:
    """Ask the kernel to end this process when the launch is killed: two trainings must not write to one folder."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def _end(process: "subprocess.Popen[str]") -> None:
    """End the whole group of processes."""
    for how in (signal.SIGTERM, signal.SIGKILL):
        try:
            os.killpg(process.pid, how)
        except ProcessLookupError:
            break
        try:
            process.wait(_SECONDS_TO_END)
        except subprocess.TimeoutExpired:
            continue
    if process.stdout is not None:
        process.stdout.close()
    process.wait()
