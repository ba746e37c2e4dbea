"""Following one stage while it runs: its log is kept and read, its checkpoints are looked at as they appear."""

import json
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from olt_generator.errors import InputError
from olt_generator.files import make_folder, write_whole
from olt_generator.progress import Progress, silent
from olt_sft_recipes.launch.checkpoints import (
    SAMPLE_BYTES,
    check_expert,
    check_stage1,
    checkpoints_of,
    compare_vlm,
)
from olt_sft_recipes.launch.log_watch import Expected, LogWatch
from olt_sft_recipes.launch.plan import FINISHED, LaunchPlan, StageLaunch
from olt_sft_recipes.launch.public_recipes import Stage
from olt_toolkit.runtime.json_files import read_json

LAUNCH_FILE = "launch.json"
# Folders are listed so often at most while lines come.
_SECONDS = 5.0
# The Trainer writes this file last.
_LAST_FILE = "trainer_state.json"


@dataclass(frozen=True)
class FollowedStage:
    """A stage as it is followed: what its log must say, and where it leaves what.

    Attributes:
        out: folder of the launch.
        checkpoint: the last one that it must leave.
        base, stage1: the released checkpoint, and the one that Stage 2 starts from.
    """

    out: Path
    expected: Expected
    checkpoint: Path
    base: Path
    stage1: Path | None

    @property
    def stage(self) -> Stage:
        """1 or 2."""
        return self.expected.stage

    @property
    def folder(self) -> Path:
        """Where its checkpoints appear."""
        return self.checkpoint.parent

    @property
    def log(self) -> Path:
        """Where its log is kept."""
        return self.out / "logs" / f"stage{self.stage}.log"


def followed(plan: LaunchPlan, launch: StageLaunch) -> FollowedStage:
    """A stage of a plan."""
    return FollowedStage(plan.places.out, launch.expected, launch.checkpoint, plan.base, plan.stage1)


def followed_of_launch(out: Path, stage: Stage) -> FollowedStage:
    """A stage of a launch that was prepared before; InputError where there is none."""
    content = read_json(out / LAUNCH_FILE, "launch")
    try:
        entry = next((each for each in content["stages"] if each["stage"] == stage), None)
        if entry is None:
            raise InputError(f"{out / LAUNCH_FILE}: Stage {stage} is not launched there")
        told: dict[str, Any] = {
            name: range(*value) if name.endswith("chunks") and value is not None else value
            for name, value in entry["expected"].items()
        }
        given = content["stage1_checkpoint"]
        stage1 = None if given is None else Path(given)
        return FollowedStage(out, Expected(**told), Path(entry["checkpoint"]), Path(content["base"]), stage1)
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{out / LAUNCH_FILE}: is no launch ({error!r}); launch again into a new folder") from error


def follow(stage: FollowedStage, lines: Iterable[str], on_progress: Progress = silent) -> dict[str, Any]:
    """Read the log of a stage to its end, and look at what it left.

    Progress bars are read and not kept. At success `finished.json` appears in the stage's folder, so that a launch
    that is repeated keeps the stage.

    Raises:
        InputError: a silent failure shows, or the stage ended without its last checkpoint.
    """
    watch = LogWatch(stage.expected)
    with _checkpoints_looked_at(stage) as look:
        make_folder(stage.log.parent)
        with stage.log.open("a", encoding="utf-8") as log:
            for line in lines:
                if "\r" not in line and "it/s]" not in line and "s/it]" not in line:
                    log.write(line)
                    log.flush()
                watch.see(line)
                look()
                on_progress(watch.share)
    return finish(stage, watch)


def keep(stage: FollowedStage) -> dict[str, Any] | None:
    """What was noted of a stage that an earlier launch finished; None where none did.

    Raises:
        InputError: Stage 1 was trained anew since a Stage 2 that would be kept, which holds the model of before; or a
            stage that a batch file finished without `olt` is not good.
    """
    note = stage.folder / FINISHED
    if not note.exists():
        return None
    kept = read_json(note, "note of a finished stage")
    unchecked = kept["checked"] is None
    if unchecked or (stage.stage == 2 and stage.stage1 is not None and stage.stage1.exists()):
        try:
            said = check_checkpoint(stage, Path(kept["checkpoint"]), whole=unchecked)
        except InputError as error:
            raise InputError(
                f"{note}: Stage {stage.stage} was finished by an earlier launch, and does not fit ({error}); move "
                f"{stage.folder} away, and it is trained again"
            ) from error
        if unchecked:
            kept["checked"] = said
    return kept


@contextmanager
def _checkpoints_looked_at(stage: FollowedStage) -> Iterator[Any]:
    """Gives a function that looks at checkpoints as they appear; each one once."""
    looked: set[int] = set()
    last = 0.0

    def look() -> None:
        nonlocal last
        if time.monotonic() - last < _SECONDS:
            return
        last = time.monotonic()
        for number, path in checkpoints_of(stage.folder).items():
            if number not in looked and (path / _LAST_FILE).exists():
                looked.add(number)
                check_checkpoint(stage, path)

    yield look


def check_checkpoint(stage: FollowedStage, path: Path, whole: bool = False) -> str:
    """Look at one checkpoint: complete, and Stage 2's with Stage 1's vision-language model; says what was compared.

    While training goes on a sample of tensors is compared, at its end all of them (`whole`).
    """
    if stage.stage == 1:
        comparison = check_stage1(path, stage.base)
        return f"{comparison.telling} of {comparison.compared} compared tensors differ from {stage.base.name}"
    if stage.stage1 is None:
        raise InputError(f"{path}: Stage 1's checkpoint is not told, so nothing can be compared; launch again")
    compared = compare_vlm(stage.stage1, path, stage.base, None if whole else SAMPLE_BYTES)
    compared.refuse(stage.stage1, path)
    trained = check_expert(path, stage.base, whole)
    return f"{compared.word()}; {trained}"


def finish(stage: FollowedStage, watch: LogWatch) -> dict[str, Any]:
    """Look at what a stage left, and note that it is finished.

    Raises:
        InputError: it left no checkpoint, or another last one than the arithmetic says, or see `check_checkpoint`.
    """
    found = checkpoints_of(stage.folder)
    if not found:
        raise InputError(f"{stage.folder}: Stage {stage.stage} ended without a checkpoint; its log is {stage.log}")
    last = found[max(found)]
    if last.name != stage.checkpoint.name:
        raise InputError(
            f"{stage.folder}: the last checkpoint is {last.name}, and {stage.checkpoint.name} was to come: Stage "
            f"{stage.stage} did not train on {stage.expected.samples:,} samples as planned; its log is {stage.log}"
        )
    said = check_checkpoint(stage, last, whole=True)
    if unseen := watch.unseen():
        said += f"; not in the log, so not compared: {', '.join(unseen)}"
    result = {
        "stage": stage.stage,
        "checkpoint": str(last),
        "checked": said,
        "first_loss": watch.losses[0][1] if watch.losses else None,
        "last_loss": watch.losses[-1][1] if watch.losses else None,
        "trained_parameters_logged": watch.seen.get("trained parameters"),
        "samples_logged": watch.seen.get("samples"),
    }
    with write_whole(stage.folder / FINISHED) as temporary:
        temporary.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    return result
