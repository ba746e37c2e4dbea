"""The report page of the main job."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.rollouts.rollout import Rollout, load_rollouts
from olt_closed_loop.scenes.scene import Agent, Scene
from olt_closed_loop.scenes.scene_file import read_scene
from olt_closed_loop.scoring.moving_boxes import agent_box
from olt_generator.poses import yaw_of
from olt_sft_recipes.demo.input_clip import CONTACT_SHEET, TRAJECTORY, TRUE_SHEET
from olt_sft_recipes.demo.job import Job
from olt_sft_recipes.demo.mixtures import RECIPES
from olt_toolkit.report.blocks import Block, Bullets, DrivenPath, Picture, Rollouts, Section, Table, Text
from olt_toolkit.report.drawings import draw_losses
from olt_toolkit.report.page import write_report

COLORS = {"toy_nominal": "#d1742f", "toy_nominal_long_tail": "#1f6feb", "recording": "#4b5563"}
AGENT_COLOR = "#9a3412"
REPORT = "report.html"


def draw_report(job: Job, summary: dict[str, Any]) -> None:
    """Write `report.html`, which needs no other file."""
    sections = [
        _scores_section(summary),
        _views_section(job, summary["input"]),
        _trajectory_section(job, summary["input"]),
        _training_section(summary),
        _rollouts_section(job),
        Section("What was left out, and why", [Bullets(summary["left_out"])]),
        _machine_section(summary),
    ]
    given = summary["input"]["name"] or "a drive of the synthetic world"
    lead = f"From one front video ({given}) to closed-loop scores; seed {job.settings.seed}."
    write_report(job.out / REPORT, "OpenLongTail: the main job", lead, sections)


def score_rows(summary: dict[str, Any]) -> list[tuple[object, ...]]:
    """Rows of the score table: policy, category, AS and CR with their intervals, rollouts."""
    return [
        (
            name,
            row["category"],
            row["alpasim_score"],
            format_interval(row["alpasim_score_interval"]),
            row["collision_rate"],
            format_interval(row["collision_rate_interval"]),
            f"{row['valid']} of {row['rollouts']}",
        )
        for name in RECIPES
        for row in summary["closed_loop"]["policies"][name]["table"]["rows"]
    ]


SCORE_COLUMNS = ("trained on", "scenes", "AS", "AS 95 %", "CR", "CR 95 %", "valid rollouts")


def format_interval(interval: list[float] | None) -> str | None:
    """An interval as text; None where it was not measured."""
    return None if interval is None else f"{interval[0]:.2f} to {interval[1]:.2f}"


def _scores_section(summary: dict[str, Any]) -> Section:
    table = summary["closed_loop"]["policies"][RECIPES[0]]["table"]
    note = (
        f"Definition {table['definition']!r}. AS: mean score of the valid rollouts, Student-t interval. CR: share of "
        "valid rollouts that touched anything, Wilson interval. The scenes are held out of every mixture. These are "
        "toy policies on a handful of scenes: the intervals say how little the difference between two rows means."
    )
    return Section("Closed-loop scores", [Table(SCORE_COLUMNS, score_rows(summary), note)])


def _views_section(job: Job, clip: dict[str, Any]) -> Section:
    blocks: list[Block] = [_picture(job, CONTACT_SHEET, "The four views over time; invented pixels are tinted.")]
    if (job.pictures / TRUE_SHEET).exists():
        blocks.append(_picture(job, TRUE_SHEET, "The true cross views, for comparison."))
    return Section(
        "Four views from one", [*blocks, Text("What was assumed, not measured:"), Bullets(clip["assumptions"])]
    )


def _trajectory_section(job: Job, clip: dict[str, Any]) -> Section:
    blocks: list[Block] = [
        Table(("quantity", "before smoothing", "after"), _trajectory_rows(clip)),
        Table(("view", "kind", "observed", "invented", "PSNR (dB)", "PSNR observed (dB)"), _view_rows(clip)),
    ]
    drawing = job.pictures / TRAJECTORY
    if drawing.exists():
        blocks.insert(0, Picture.from_svg(drawing.read_text(), "The trajectory before and after smoothing."))
    return Section("Trajectory and clip", blocks)


def _trajectory_rows(clip: dict[str, Any]) -> list[tuple[object, ...]]:
    motion = clip["trajectory"]
    rows: list[tuple[object, ...]] = [
        ("path length (m)", "", motion["length"]),
        ("duration (s)", "", motion["duration"]),
        ("mean speed (m/s)", "", motion["mean_speed"]),
        ("relative 1-sigma of the metric scale", clip["scale_sigma"], ""),
    ]
    for measured in ("pose_errors", "smoothness"):
        before, after = _flatten(clip[f"{measured}_before_smoothing"]), _flatten(clip[measured])
        rows += [(name, before[name], value) for name, value in after.items()]
    rows.append(("distance, median relative error", "", clip["distance_median_relative_error"]))
    return rows


def _flatten(errors: dict[str, Any] | None, prefix: str = "") -> dict[str, Any]:
    """Nested numbers under joined names; empty where nothing was measured."""
    flat: dict[str, Any] = {}
    for name, value in (errors or {}).items():
        flat |= _flatten(value, f"{prefix}{name}: ") if isinstance(value, dict) else {prefix + name: value}
    return flat


def _view_rows(clip: dict[str, Any]) -> list[tuple[object, ...]]:
    errors = clip["view_errors"]
    return [
        (
            camera,
            view["kind"],
            view["observed_share"],
            view["invented_share"],
            *(errors.get(camera, {}).get(measure) for measure in ("psnr", "psnr_observed")),
        )
        for camera, view in clip["clip"]["views"].items()
    ]


def _training_section(summary: dict[str, Any]) -> Section:
    parts = [
        (name, part["name"], part["asked"], part["got"], part["distinct"])
        for name in RECIPES
        for part in summary["mixtures"][name]["components"]
    ]
    stages = [
        (name, stage["stage"], stage["steps"], stage["losses"][0], stage["final_loss"])
        for name in RECIPES
        for stage in summary["training"][name]["stages"]
    ]
    open_loop = [
        (measure, *(summary["training"][name]["open_loop"][measure] for name in RECIPES))
        for measure in summary["training"][RECIPES[0]]["open_loop"]
    ]
    curves = [
        Picture.from_svg(
            draw_losses([(name, summary["training"][name]["stages"][index]["losses"]) for name in RECIPES], title),
            title,
        )
        for index, title in enumerate(("Stage 1: trajectory tokens", "Stage 2: flow matching"))
    ]
    return Section(
        "Mixtures and two-stage training",
        [
            Table(("mixture", "component", "samples asked", "got", "distinct"), parts),
            Table(("mixture", "stage", "steps", "first loss", "last loss"), stages),
            Table(("error (m)", *RECIPES), open_loop, "Open-loop errors on held-out nominal drives, one plan each."),
            *curves,
        ],
    )


def _rollouts_section(job: Job) -> Section:
    drives = {name: load_rollouts(job.rollouts(name) / "rollouts.json") for name in RECIPES}
    scores = {name: job.results["closed_loop"]["policies"][name]["scores"] for name in RECIPES}
    blocks = []
    for scene_name in job.results["scenes"]["evaluation"]:
        scene = read_scene(job.scenes / f"{scene_name}.usda")
        first = {name: _first_of(scene_name, drives[name], scores[name]) for name in RECIPES}
        blocks.append(_animate(scene, first))
    return Section("Rollouts from above", blocks)


def _first_of(scene: str, rollouts: list[Rollout], scores: list[dict[str, Any]]) -> tuple[Rollout, dict[str, Any]]:
    index = next(index for index, rollout in enumerate(rollouts) if rollout.scene == scene)
    return rollouts[index], scores[index]


def _animate(scene: Scene, drives: dict[str, tuple[Rollout, dict[str, Any]]]) -> Rollouts:
    times = max((rollout.timestamps_us for rollout, _ in drives.values()), key=len)
    paths = [_ego_path(name, scene, rollout, score) for name, (rollout, score) in drives.items()]
    recorded = scene.ego.interpolate(times[times <= scene.ego.timestamps_us[-1]])
    poses = [(pose[0, 3], pose[1, 3], yaw) for pose, yaw in zip(recorded, yaw_of(recorded), strict=True)]
    paths.append(_box("recording", COLORS["recording"], scene, poses, {}))
    caption = "; ".join(f"{name}: {_describe(score)}" for name, (_, score) in drives.items())
    return Rollouts(
        title=f"{scene.name} ({', '.join(scene.factors) or scene.category})",
        caption=caption,
        step_seconds=float(times[1] - times[0]) * 1e-6,
        areas=[outline[:, :2].tolist() for outline in scene.drivable],
        lines=[border[:, :2].tolist() for lane in scene.lanes for border in (lane.left, lane.right)],
        route=scene.route[:, :2].tolist(),
        paths=paths,
        agents=[_agent_path(agent, times) for agent in scene.agents],
    )


def _ego_path(name: str, scene: Scene, rollout: Rollout, score: dict[str, Any]) -> DrivenPath:
    poses = [(float(x), float(y), float(yaw)) for x, y, yaw in rollout.states[:, :3]]
    events = {_frame(rollout, collision["time_us"]): "collision" for collision in score["collisions"]}
    if score["offroad_us"] is not None:
        events[_frame(rollout, score["offroad_us"])] = "off-road"
    return _box(name, COLORS[name], scene, poses, events)


def _box(
    label: str, color: str, scene: Scene, poses: list[tuple[float, float, float]], events: dict[int, str]
) -> DrivenPath:
    ego = scene.vehicle
    return DrivenPath(label, color, ego.length, ego.width, ego.rear_axle_to_bbox_center, poses, events)


def _frame(rollout: Rollout, time_us: int) -> int:
    return int(min(rollout.timestamps_us.searchsorted(time_us), len(rollout.timestamps_us) - 1))


def _agent_path(agent: Agent, times: NDArray[np.int64]) -> DrivenPath:
    box = agent_box(agent)
    there = box.covers(times)
    poses: list[tuple[float, float, float] | None] = [None] * len(times)
    for index, (x, y, _, yaw) in zip(there.nonzero()[0], box.at(times[there]), strict=True):
        poses[index] = (float(x), float(y), float(yaw))
    return DrivenPath(agent.label, AGENT_COLOR, agent.length, agent.width, 0.0, poses)


def _describe(score: dict[str, Any]) -> str:
    if not score["valid"]:
        return f"not valid ({score['reason']})"
    return f"score {score['score']:.2f}, progress {score['progress']:.2f}" + (
        f", {score['reason'].replace('_', ' ')}" if score["reason"] else ""
    )


def _machine_section(summary: dict[str, Any]) -> Section:
    machine = summary["machine"]
    rows = [(stage, f"{seconds:.1f} s") for stage, seconds in summary["timings"]["stages_s"].items()]
    versions = ", ".join(f"{package} {version}" for package, version in machine["packages"].items())
    about = f"{machine['processor']}, {machine['cores']} cores, Python {machine['python']}; {versions}."
    return Section("Machine and run times", [Table(("stage", "time"), rows), Text(about)])


def _picture(job: Job, name: str, caption: str) -> Picture:
    return Picture.from_file(job.pictures / name, caption)
