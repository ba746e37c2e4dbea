"""Runs the stages of the main job in order, and goes on where an interrupted one stopped."""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol

from olt_generator.files import make_folder
from olt_generator.progress import Progress
from olt_sft_recipes.demo.settings import DemoSettings
from olt_sft_recipes.demo.stage_log import StageLog, checksum
from olt_toolkit.recordings.recording import Recording


class StageBar(Protocol):
    """Shows which stage runs and how far it is."""

    def start(self, stage: str) -> None:
        """A stage or a part of one starts."""
        ...

    def share(self, share: float) -> None:
        """The share of the stage that is done."""
        ...


@dataclass
class Job:
    """What every stage may use.

    Attributes:
        out: folder of the run.
        settings: sizes and seed.
        video: front video given by the user; None for the synthetic world.
        workers: processes for work that can be split; results do not depend on it.
        bar: the progress display.
        recording: what the video holds, until the stage that makes its clip takes it.
        results: what the finished stages returned, by stage.
    """

    out: Path
    settings: DemoSettings
    video: Path | None
    workers: int
    bar: StageBar
    recording: Recording | None = None
    results: dict[str, dict[str, Any]] = field(default_factory=dict)

    @property
    def on_progress(self) -> Progress:
        """Where a stage reports its progress."""
        return self.bar.share

    @property
    def scenes(self) -> Path:
        """Folder of the closed-loop scenes."""
        return self.out / "scenes"

    @property
    def clips(self) -> Path:
        """Folder of the clip store."""
        return self.out / "clips"

    @property
    def pictures(self) -> Path:
        """Folder of what the report shows."""
        return self.out / "pictures"

    def policy(self, mixture: str) -> Path:
        """Folder of what is trained on the named mixture."""
        return self.out / "training" / mixture

    def rollouts(self, mixture: str) -> Path:
        """Folder of the closed-loop results of the policy trained on the named mixture."""
        return self.out / "closed_loop" / mixture


@dataclass(frozen=True)
class Stage:
    """One step of the job: `work` returns what JSON can hold; its files must be whole when it returns."""

    name: str
    title: str
    work: Callable[[Job], dict[str, Any]]


def run_stages(job: Job, stages: list[Stage]) -> dict[str, float]:
    """Run what is not finished, filling `job.results`; returns the seconds that each stage took when it ran.

    Raises:
        InputError: the folder holds another job, or a stage cannot use its input.
    """
    make_folder(job.out)
    log = StageLog(job.out / "stages", _identity(job))
    seconds = {}
    for number, stage in enumerate(stages, start=1):
        job.bar.start(f"{number}/{len(stages)} {stage.title}")
        finished = log.run(stage.name, lambda stage=stage: _timed(job, stage))
        job.results[stage.name], seconds[stage.name] = finished["result"], finished["seconds"]
    return seconds


def _timed(job: Job, stage: Stage) -> dict[str, Any]:
    start = time.perf_counter()
    result = stage.work(job)
    return {"result": result, "seconds": round(time.perf_counter() - start, 3)}


def _identity(job: Job) -> dict[str, Any]:
    return {"settings": asdict(job.settings), "video": None if job.video is None else checksum(job.video)}
