"""Stage: all clips of the job, the input's and those that the policies are trained on, side by side."""

from typing import Any

from olt_sft_recipes.demo.input_clip import InputOrder, build_input_clip
from olt_sft_recipes.demo.job import Job
from olt_sft_recipes.demo.training_clips import (
    ClipOrder,
    build_clip_to_order,
    order_training_clips,
    summarize_training_clips,
)
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.runtime.workers import map_parallel


def build_clips(job: Job) -> dict[str, Any]:
    """Build and store every clip; returns the numbers of the input clip and of the training clips.

    Raises:
        InputError: the input cannot be used.
    """
    training_orders = order_training_clips(job)
    # The input takes longest, so it starts first.
    made_input, *made = map_parallel(_build, [_order_input(job), *training_orders], job.workers, job.on_progress)
    ClipStore(job.clips).commit([clip["clip_id"] for clip in made])
    return {"input": made_input, "training": summarize_training_clips(training_orders, made)}


def _order_input(job: Job) -> InputOrder:
    """The user's video, or else a drive of the synthetic world, whose truth is known."""
    given, job.recording = job.recording, None  # its frames are large; nothing after this stage needs them
    if given is None:
        given = job.scenes / f"{job.results['scenes']['input'][0]}.usda"
    return InputOrder(given, job.clips, job.pictures, job.settings)


def _build(order: InputOrder | ClipOrder) -> dict[str, Any]:
    return build_input_clip(order) if isinstance(order, InputOrder) else build_clip_to_order(order)
