"""The main job, told in order: one front-camera video to four views, two mixtures, two policies, closed-loop scores."""

import hashlib
import json
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import chain
from operator import call
from pathlib import Path
from typing import Any

import numpy as np

from olt_closed_loop import (
    generate_scene,
    read_scene,
    run_closed_loop,
    save_results,
    summarize_scores,
    write_scene,
)
from olt_closed_loop.evaluation.baselines import BASELINES
from olt_closed_loop.evaluation.comparison import compare_scores
from olt_closed_loop.evaluation.evaluation import Result, count_left_out, pass_gate
from olt_closed_loop.scenes.procedural import CATEGORIES
from olt_closed_loop.sensors.recorder import record_drive
from olt_closed_loop.simulation.policy_hosts import PolicyLimits
from olt_closed_loop.simulation.settings import SimulationSettings
from olt_datasets import Mixture, compose_mixture, find_recipe, read_clip_tables
from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_generator.omissions import Omission
from olt_generator.progress import Progress
from olt_sft_recipes.demo.job_log import JobLog
from olt_sft_recipes.demo.report import CONTACT_SHEET, RECIPES, TRAJECTORY, TRUE_SHEET, draw_report
from olt_sft_recipes.open_loop import evaluate_open_loop, spread_keys
from olt_sft_recipes.toy.policy import load_toy
from olt_sft_recipes.training.stage_config import builtin_stage_config
from olt_sft_recipes.training.two_stages import train_on_mixture
from olt_toolkit import (
    BuildOptions,
    BuiltClip,
    ClipStore,
    OpenOptions,
    Recording,
    __version__,
    build_clip,
    open_dataset,
    open_recording,
)
from olt_toolkit.clips.clip import Clip, Split
from olt_toolkit.clips.pictures import contact_sheet, write_picture
from olt_toolkit.clips.summary import summarize_build
from olt_toolkit.clips.trajectory_errors import draw_motions
from olt_toolkit.recordings.drives import WHOLE
from olt_toolkit.rigs.contracts import DEFAULT_CONTRACT
from olt_toolkit.rigs.rig import CROSS_LEFT, CROSS_RIGHT, FRONT_WIDE
from olt_toolkit.runtime.console import make_progress
from olt_toolkit.runtime.environment import describe_machine
from olt_toolkit.runtime.threads import use_one_thread
from olt_toolkit.runtime.workers import default_workers, kept_workers, map_parallel

NOMINAL = "nominal"
LONG_TAIL: tuple[str, ...] = tuple(category for category in CATEGORIES if category != NOMINAL)
STEPS = {
    "scenes": "driving scenes",
    "clips": "front video and training clips",
    "mixtures": "mixtures",
    "training": "two-stage training",
    "closed_loop": "closed loop",
    "report": "report",
}


@dataclass(frozen=True)
class DemoSettings:
    """Sizes of the main job, chosen for five minutes on two cores.

    Attributes:
        seed: the one seed from which every other follows.
        nominal_clips: ordinary drives with all cameras real (GT), for training.
        long_tail_clips: long-tail drives per category whose side views are synthesized (Syn), for training.
        validation_clips: ordinary drives held out of training, for open-loop errors.
        evaluation_scenes: held-out long-tail scenes per category that the policies drive in closed loop. Two give ten,
            and fewer than six cannot tell two policies apart.
        rollouts: closed-loop rollouts per scene and policy.
        frame_rate: frames per second of the synthetic drives.
        video_seconds: how much of a given video is used, from its start.
        video_fov: its horizontal field of view in radians, where it is not calibrated; None for its reader's default.
        video_camera_height: height in metres of its camera, where it is not known; None for its reader's default.
        video_rotate, video_mirror: see `OpenOptions`.
        input_size: height and width of the synthetic input video and of the views made from the input.
        training_front_size: height and width of the front videos behind the training clips.
        training_size: height and width of the training clips.
        training_epochs: epochs of each stage of training; None for those of the stage configs.
    """

    seed: int = 0
    nominal_clips: int = 8
    long_tail_clips: int = 1
    validation_clips: int = 1
    evaluation_scenes: int = 2
    rollouts: int = 1
    frame_rate: float = 10.0
    video_seconds: float = 14.0
    video_fov: float | None = None
    video_camera_height: float | None = None
    video_rotate: int = 0
    video_mirror: bool = False
    input_size: tuple[int, int] = (270, 480)
    training_front_size: tuple[int, int] = (144, 256)
    training_size: tuple[int, int] = (64, 112)
    training_epochs: int | None = None

    def quick(self) -> "DemoSettings":
        """The smallest job that takes every step; its policies have learned nothing, so its scores tell nothing."""
        sizes = {"input_size": (144, 256), "nominal_clips": 1, "evaluation_scenes": 1}
        return replace(self, **sizes, training_epochs=1)


def run_demo(out: Path, settings: DemoSettings, video: Path | None = None, workers: int = 0) -> dict[str, Any]:
    """Run every step that is not finished in `out`, write `summary.json` and `report.html`, return the summary.

    Args:
        out: folder of the run.
        settings: sizes and seed.
        video: front video; None for a drive of the synthetic world.
        workers: processes; 0 for one per core. The results do not depend on it.

    Raises:
        InputError: the video cannot be used, or the folder is not writable or holds another run.
    """
    use_one_thread()
    workers = workers or default_workers()
    if video is not None:
        open_video(video, settings)  # unusable: nothing is written
    checksum = None if video is None else hashlib.sha256(video.read_bytes()).hexdigest()
    with make_progress() as bar, kept_workers(workers):
        task = bar.add_task("", total=100)

        def show(step: str, share: float) -> None:
            title = f"{[*STEPS].index(step) + 1}/{len(STEPS)} {STEPS[step]}"
            bar.update(task, description=f"{title:<34}", completed=int(100 * share))

        log = JobLog(out / "steps", {"settings": asdict(settings), "video": checksum}, show)

        # Scenes of the synthetic world, by role; a user's video takes the place of the input.
        plan = plan_scenes(settings) | ({} if video is None else {"input": []})
        scenes = log.run("scenes", lambda share: {role: write_scenes(out, drives) for role, drives in plan.items()})

        # One front video becomes four views and a clip; so do the long-tail drives (Syn). Of the nominal drives all
        # cameras film (GT). The input takes longest, so it starts first.
        film = partial(build_training_clip, out, settings)
        builds = [
            partial(build_input_clip, out, settings, video, scenes["input"]),
            *(partial(film, name, real_views=False, split="train") for name in scenes["long_tail"]),
            *(partial(film, name, real_views=True, split="train") for name in scenes["nominal"]),
            *(partial(film, name, real_views=True, split="val") for name in scenes["validation"]),
        ]
        clips = log.run("clips", lambda share: store_clips(out, map_parallel(call, builds, workers, share)))

        # Two mixtures of as many samples: nominal drives alone, and with the long tail; neither from a scene on which
        # the policies are judged.
        def compose(name: str) -> Mixture:
            held_out = [f"synthetic/{scene}" for scene in (*scenes["validation"], *scenes["evaluation"])]
            clips = read_clip_tables([out / "clips"])
            # Every scene is invented by a seed of its own, also where its small images show too little to compare.
            return compose_mixture(find_recipe(name), clips, settings.seed, held_out, allow_uncompared=True)

        mixtures = log.run("mixtures", lambda share: {name: compose(name).describe() for name in RECIPES})

        # A policy for each mixture, trained in two stages and judged in open loop.
        def train(on_progress: Progress) -> dict[str, Any]:
            trainings = [partial(train_policy, out, settings, name, compose(name)) for name in RECIPES]
            return dict(zip(RECIPES, map_parallel(call, trainings, workers, on_progress), strict=True))

        training = log.run("training", train)

        # Both drive held-out long-tail scenes, once the gate has shown that scores mean something there.
        suite = [str(scene_path(out, name)) for name in scenes["evaluation"]]
        closed_loop = log.run("closed_loop", lambda share: drive_suite(out, settings, suite, workers, share))

        # Everything as one JSON object and on one page; equal runs differ in `timings` and `machine` alone.
        show("report", 0.0)
        summary = {
            "openlongtail": __version__,
            "settings": asdict(settings),
            "input": {
                "kind": "video" if video else "synthetic",
                "name": video.name if video else None,
                **without_seconds(clips["input"]),
            },
            "scenes": scenes,
            "training_clips": clips["training"],
            "mixtures": mixtures,
            "training": {name: without_seconds(trained) for name, trained in training.items()},
            "closed_loop": closed_loop,
            "left_out": list_left_out(clips, closed_loop),
            "timings": {
                "steps_s": log.seconds,
                "input_clip_s": clips["input"]["seconds"],
                "training_s": {name: trained["seconds"] for name, trained in training.items()},
            },
            "machine": describe_machine(),
        }
        with write_whole(out / "summary.json") as path:
            path.write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n")
        draw_report(out, summary)
        show("report", 1.0)
    return summary


def plan_scenes(settings: DemoSettings) -> dict[str, list[tuple[str, int]]]:
    """Category and scene seed of every drive by role; each role has seeds of its own, so no two share a scene."""

    def draw(categories: tuple[str, ...], first_seed: int, count: int) -> list[tuple[str, int]]:
        start = 10_000 * settings.seed + first_seed
        return [(category, seed) for category in categories for seed in range(start, start + count)]

    return {
        "input": draw(LONG_TAIL[:1], 3000, 1),
        "nominal": draw((NOMINAL,), 0, settings.nominal_clips),
        "long_tail": draw(LONG_TAIL, 0, settings.long_tail_clips),
        "validation": draw((NOMINAL,), 1000, settings.validation_clips),
        "evaluation": draw(LONG_TAIL, 2000, settings.evaluation_scenes),
    }


def scene_path(out: Path, name: str) -> Path:
    """The file of a scene of the job."""
    return out / "scenes" / f"{name}.usda"


def write_scenes(out: Path, drives: list[tuple[str, int]]) -> list[str]:
    """Invent the scenes of these categories and seeds and write them as OpenUSD; returns their names."""
    scenes = [generate_scene(category, seed) for category, seed in drives]
    for scene in scenes:
        write_scene(scene, scene_path(out, scene.name))
    return [scene.name for scene in scenes]


def open_video(video: Path, settings: DemoSettings) -> Recording:
    """Decode as much of the user's video as the job uses.

    Raises:
        InputError: the video cannot be used.
    """
    options = OpenOptions(
        duration=settings.video_seconds,
        horizontal_fov=settings.video_fov,
        camera_height=settings.video_camera_height,
        rotate=settings.video_rotate,
        mirror=settings.video_mirror,
    )
    return open_recording(video, options)


def build_input_clip(out: Path, settings: DemoSettings, video: Path | None, scene_names: list[str]) -> dict[str, Any]:
    """Build, draw and store the clip of the user's video, or else of a drive whose truth is known."""
    height, width = settings.input_size
    options = BuildOptions(width, height, seed=settings.seed, name="input")
    if video is not None:
        recording, dataset = open_video(video, settings), open_dataset(video)
        options = replace(options, scene_id=dataset.drive(WHOLE).scene_id)
    else:
        scene, cameras = read_scene(scene_path(out, scene_names[0])), (CROSS_LEFT, FRONT_WIDE, CROSS_RIGHT)
        recording = record_drive(scene, width, height, settings.frame_rate, cameras, with_distance=True)
        options = replace(options, category=scene.category, factors=scene.factors, image_kind="rendered")
    built = build_clip(recording, options)
    draw_clip(out / "pictures", recording, built)
    store = ClipStore(out / "clips")
    info = store.prepare(built.clip)
    store.commit([info.clip_id])
    check_reads_back(store, built.clip)
    return summarize_build(built, info)


def check_reads_back(store: ClipStore, clip: Clip) -> None:
    """Check that the clip on disk is the clip that was built.

    Raises:
        InputError: its motion or its times are others.
    """
    read, motion = store.read_ego_motion(clip.clip_id).trajectory, clip.ego_motion.trajectory
    times_us = store.read_timestamps(clip.clip_id, FRONT_WIDE)
    same_motion = np.allclose(read.T_world_rig, motion.T_world_rig, atol=1e-6)
    if not same_motion or not np.array_equal(times_us, clip.streams[FRONT_WIDE].timestamps_us):
        raise InputError(f"{store.root}: clip {clip.clip_id} reads back as something else; check the disk")


def build_training_clip(
    out: Path, settings: DemoSettings, scene_name: str, real_views: bool, split: Split
) -> dict[str, Any]:
    """Film a drive and prepare its clip, with those frames alone that its samples use; returns its numbers."""
    scene = read_scene(scene_path(out, scene_name))
    size = settings.training_size if real_views else settings.training_front_size
    cameras = DEFAULT_CONTRACT.cameras if real_views else (FRONT_WIDE,)
    recording = record_drive(scene, size[1], size[0], settings.frame_rate, cameras)
    options = BuildOptions(
        width=settings.training_size[1],
        height=settings.training_size[0],
        frames="sampled",
        use_reference_views=real_views,
        image_kind="rendered",
        category=scene.category,
        factors=scene.factors,
        split=split,
        seed=settings.seed,
    )
    built = build_clip(recording, options)
    info = ClipStore(out / "clips").prepare(built.clip)
    frames_left_out = len(recording.frames) - len(built.clip.streams[FRONT_WIDE].timestamps_us)
    return summarize_build(built, info) | {"frames_left_out": frames_left_out}


def store_clips(out: Path, made: list[dict[str, Any]]) -> dict[str, Any]:
    """Commit the training clips; returns the numbers of the input, and those of the training clips together."""
    given, *training = made
    ClipStore(out / "clips").commit([clip["clip"]["clip_id"] for clip in training])
    kinds = [clip["clip"]["kind"] for clip in training]
    errors = [clip["pose_errors"]["metric"]["ate_m"] for clip in training if clip["pose_errors"]]
    views = [
        view for clip in training for view in clip["clip"]["views"].values() if view["kind"] in ("warped", "generated")
    ]
    observed = [view["observed_share"] for view in views]
    summary = {
        "clips": len(training),
        "gt": kinds.count("GT"),
        "syn": kinds.count("Syn"),
        "syn_ate_m_median": float(np.median(errors)) if errors else None,
        "syn_ate_m_max": max(errors, default=None),
        "frames_left_out_of_each_view": sum(clip["frames_left_out"] for clip in training),
        "syn_observed_share_of_cross_views": float(np.mean(observed)) if observed else None,
    }
    return {"input": given, "training": summary}


def draw_clip(pictures: Path, recording: Recording, built: BuiltClip) -> None:
    """Draw what the report shows of the input: its views, the true ones and its trajectory, where they are known."""
    # Fewer times than the recording's: frames that no sample uses are not made.
    times_us = built.clip.streams[FRONT_WIDE].timestamps_us
    write_picture(pictures / CONTACT_SHEET, contact_sheet(built.clip.images, built.clip.origins, times_us))
    if recording.views:
        write_picture(pictures / TRUE_SHEET, contact_sheet(recording.views, {}, recording.timestamps_us))
    if built.motion is not None:
        draw_motions(pictures / TRAJECTORY, {"after smoothing": built.motion})


def train_policy(out: Path, settings: DemoSettings, name: str, mixture: Mixture) -> dict[str, Any]:
    """Train a policy on one mixture; returns losses, open-loop errors on the held-out drives, and the run time."""
    folder, store = out / "training" / name, ClipStore(out / "clips")
    stages = builtin_stage_config(1), builtin_stage_config(2)
    if epochs := settings.training_epochs:
        shorter = {"num_train_epochs": epochs, "regression_warmup_epochs": 0}
        stages = stages[0].model_copy(update=shorter), stages[1].model_copy(update=shorter)
    results = train_on_mixture(mixture, stages, settings.seed, folder)
    samples = store.load_samples(spread_keys(store, "val", samples=6))
    return {
        "stages": [without_seconds(vars(result)) for result in results],
        "open_loop_samples": len(samples),
        "open_loop": evaluate_open_loop(load_toy(str(folder / "policy")), samples),
        "seconds": sum(result.seconds for result in results),
    }


def drive_suite(
    out: Path, settings: DemoSettings, suite: list[str], workers: int, on_progress: Progress
) -> dict[str, Any]:
    """Check the gate, then drive every scene of the suite with each policy and baseline; returns their scores.

    Raises:
        InputError: a scene fails the gate, so that its scores would mean nothing.
    """
    gates = map_parallel(pass_gate, [[scene] for scene in suite], workers)
    drivers = {name: (f"toy:{out / 'training' / name / 'policy'}", settings.rollouts) for name in RECIPES}
    drivers |= {label: (policy, 1) for label, policy in BASELINES.items()}
    drives = [
        partial(drive_scene, scene, policy, rollouts, settings.seed)
        for policy, rollouts in drivers.values()
        for scene in suite
    ]
    driven = map_parallel(call, drives, workers, on_progress)
    results = {
        name: list(chain.from_iterable(driven[index * len(suite) : (index + 1) * len(suite)]))
        for index, name in enumerate(drivers)
    }
    scores = {name: [score for _, score in of_driver] for name, of_driver in results.items()}
    policies = {}
    for name in RECIPES:
        save_results(out / "closed_loop" / name, results[name])
        policies[name] = {
            "table": summarize_scores(scores[name]).to_dict(),
            "scores": [score.to_dict() for score in scores[name]],
            "incidents": [{"scene": rollout.scene, **vars(rollout.incidents)} for rollout, _ in results[name]],
            "left_out": [omission.to_dict() for omission in count_left_out(results[name])],
        }
    return {
        "gate": [result.to_dict() for gate in gates for result in gate],
        "policies": policies,
        "comparison": compare_scores(scores).to_dict(),
    }


def drive_scene(scene: str, policy: str, rollouts: int, seed: int) -> list[Result]:
    """Drive one scene with one policy, in this process: it was trained here, so it needs none of its own."""
    trusted = SimulationSettings(limits=PolicyLimits(isolate="none"))
    return run_closed_loop([scene], policy, rollouts, seed, trusted, gated=True)


def list_left_out(clips: dict[str, Any], closed_loop: dict[str, Any]) -> list[dict[str, Any]]:
    """Everything that the clips and the closed loop did not compute, as records of `Omission`."""
    clip, frames = clips["input"], clips["training"]["frames_left_out_of_each_view"]
    left_out = list(clip["left_out"])
    if why := clip["clip"]["no_sample_reason"]:
        left_out.append(Omission("policy samples of the input clip", why).to_dict())
    if frames:
        what = "frames of each view of the training clips"
        left_out.append(Omission(what, "no sample of these clips shows them", frames).to_dict())
    for policy in closed_loop["policies"].values():
        left_out += [record for record in policy["left_out"] if record not in left_out]
    return left_out


def without_seconds(result: dict[str, Any]) -> dict[str, Any]:
    """A result without its run times."""
    return {name: value for name, value in result.items() if not name.startswith("seconds")}
