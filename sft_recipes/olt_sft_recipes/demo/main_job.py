"""The main job from end to end."""

from pathlib import Path
from typing import Any

from olt_sft_recipes.demo.clips import build_clips
from olt_sft_recipes.demo.evaluation import score_policies
from olt_sft_recipes.demo.input_clip import open_video
from olt_sft_recipes.demo.job import Job, Stage, run_stages
from olt_sft_recipes.demo.mixtures import compose_mixtures
from olt_sft_recipes.demo.report import draw_report
from olt_sft_recipes.demo.scenes import write_scenes
from olt_sft_recipes.demo.settings import DemoSettings
from olt_sft_recipes.demo.summary import summarize_job, write_summary
from olt_sft_recipes.demo.training import train_policies
from olt_toolkit.runtime.console import make_progress
from olt_toolkit.runtime.threads import use_one_thread
from olt_toolkit.runtime.workers import default_workers

STAGES = [
    Stage("scenes", "driving scenes", write_scenes),
    Stage("clips", "front video and training clips", build_clips),
    Stage("mixtures", "mixtures", compose_mixtures),
    Stage("training", "two-stage training", train_policies),
    Stage("closed_loop", "closed loop", score_policies),
]


class RichBar:
    """One bar on standard error that names the stage."""

    def __init__(self) -> None:
        self.progress = make_progress()
        self.task = self.progress.add_task("", total=100)

    def start(self, stage: str) -> None:
        """See `StageBar.start`."""
        self.progress.update(self.task, description=f"{stage:<34}", completed=0)

    def share(self, share: float) -> None:
        """See `StageBar.share`."""
        self.progress.update(self.task, completed=int(100 * share))


def run_demo(out: Path, settings: DemoSettings, video: Path | None = None, workers: int = 0) -> dict[str, Any]:
    """Run every stage that is not finished in `out`, write `summary.json` and `report.html`, return the summary.

    Args:
        out: folder of the run.
        settings: sizes and seed.
        video: front video; None for a drive of the synthetic world.
        workers: processes; 0 for one per core. The results do not depend on it.

    Raises:
        InputError: the video cannot be used, or the folder is not writable or holds another run.
    """
    use_one_thread()
    bar = RichBar()
    job = Job(out, settings, video, workers or default_workers(), bar)
    if video is not None:
        job.recording = open_video(video, settings)  # unusable: nothing is written
    with bar.progress:
        seconds = run_stages(job, STAGES)
        bar.start("report")
        summary = summarize_job(job, seconds)
        write_summary(job, summary)
        draw_report(job, summary)
        bar.share(1.0)
    return summary
