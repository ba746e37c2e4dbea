"""The clips that the toy policies are trained on, recorded in the closed loop's own scenes."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from olt_closed_loop.scenes.scene_file import read_scene
from olt_closed_loop.sensors.recorder import record_drive
from olt_sft_recipes.demo.job import Job
from olt_sft_recipes.demo.settings import DemoSettings
from olt_toolkit.clips.builder import build_clip
from olt_toolkit.clips.clip import Split
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.views import BuildOptions
from olt_toolkit.rigs.rig import FRONT_WIDE, POLICY_CAMERAS


@dataclass(frozen=True)
class ClipOrder:
    """One clip to record and build.

    Attributes:
        scene: the stage to drive.
        store: the clip store that it is prepared in.
        real_views: whether all views are rendered (GT); otherwise the side views are synthesized (Syn).
        split: split of the clip.
        settings: sizes and seed.
    """

    scene: Path
    store: Path
    real_views: bool
    split: Split
    settings: DemoSettings


def order_training_clips(job: Job) -> list[ClipOrder]:
    """All training and validation clips."""
    names = job.results["scenes"]
    roles: list[tuple[str, bool, Split]] = [
        ("nominal", True, "train"),
        ("long_tail", False, "train"),
        ("validation", True, "val"),
    ]
    return [
        ClipOrder(job.scenes / f"{name}.usda", job.clips, real_views, split, job.settings)
        for role, real_views, split in roles
        for name in names[role]
    ]


def summarize_training_clips(orders: list[ClipOrder], made: list[dict[str, Any]]) -> dict[str, Any]:
    """How many clips were made to the orders, and their errors."""
    position_errors = [clip["ate_m"] for clip in made if clip["ate_m"] is not None]
    observed = [clip["observed_share"] for clip in made if clip["observed_share"] is not None]
    return {
        "clips": len(made),
        "gt": sum(order.real_views for order in orders),
        "syn": sum(not order.real_views for order in orders),
        "syn_ate_m_median": float(np.median(position_errors)) if position_errors else None,
        "syn_ate_m_max": max(position_errors, default=None),
        "frames_left_out_of_each_view": sum(clip["frames_left_out"] for clip in made),
        "syn_observed_share_of_cross_views": float(np.mean(observed)) if observed else None,
    }


def build_clip_to_order(order: ClipOrder) -> dict[str, Any]:
    """Record one scene's drive, build its clip and prepare it; returns its id and errors."""
    scene = read_scene(order.scene)
    settings = order.settings
    height, width = settings.training_size if order.real_views else settings.training_front_size
    cameras = POLICY_CAMERAS if order.real_views else (FRONT_WIDE,)
    recording = record_drive(scene, width, height, settings.frame_rate, cameras)
    options = BuildOptions(
        width=settings.training_size[1],
        height=settings.training_size[0],
        frames="sampled",
        use_reference_views=order.real_views,
        image_kind="rendered",
        category=scene.category,
        factors=scene.factors,
        split=order.split,
        seed=settings.seed,
    )
    built = build_clip(recording, options)
    ClipStore(order.store).prepare(built.clip)
    shares = [float(observed.mean()) for observed in built.observed.values()]
    return {
        "clip_id": built.clip.clip_id,
        "ate_m": built.motion.errors.metric.ate_m if built.motion and built.motion.errors else None,
        "frames_left_out": len(recording.frames) - len(built.clip.streams[FRONT_WIDE].timestamps_us),
        "observed_share": float(np.mean(shares)) if shares else None,
    }
