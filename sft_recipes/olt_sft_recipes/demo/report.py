"""The report page of the main job, drawn from its summary and what lies in its folder."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop import Rollout, Scene, load_rollouts, read_scene
from olt_closed_loop.evaluation.comparison import FEWEST_SCENES
from olt_closed_loop.scenes.scene import Agent
from olt_closed_loop.scoring.moving_boxes import agent_box
from olt_generator.omissions import Omission, word_omission
from olt_generator.poses import yaw_of
from olt_toolkit.report.blocks import Bullets, DrivenPath, Picture, Rollouts, Section, Table, Text
from olt_toolkit.report.drawings import draw_losses
from olt_toolkit.report.page import write_report
from olt_toolkit.runtime.console import word_interval

REPORT = "report.html"
CONTACT_SHEET, TRUE_SHEET, TRAJECTORY = "four_views.png", "true_cross_views.png", "trajectory.png"
# What each policy is trained on: as many samples, from nominal drives alone or with long-tail Syn.
RECIPES: tuple[str, ...] = ("toy_nominal", "toy_nominal_long_tail")
WHERE_ONE_IS_SHOWN = "docs/tutorials/launch_sft.md has the commands for more drives and the suite, which take hours."
COLORS = {"toy_nominal": "#d1742f", "toy_nominal_long_tail": "#1f6feb", "recording": "#4b5563"}
AGENT_COLOR = "#9a3412"
Drive = tuple[Rollout, dict[str, Any]]
"""A rollout and its score."""

DIFFERENCE_COLUMNS = ("policy", "less", "scenes", "AS", "AS 95 %", "clearly separated")
SCORE_COLUMNS = ("trained on", "scenes", "AS", "AS 95 %", "CR", "CR 95 %", "valid rollouts")


def draw_report(out: Path, summary: dict[str, Any]) -> None:
    """Write `report.html`, which needs no other file."""
    policies = summary["closed_loop"]["policies"]
    drives = {
        name: list(zip(load_rollouts(out / "closed_loop" / name / "rollouts.parquet"), policy["scores"], strict=True))
        for name, policy in policies.items()
    }
    scenes = [read_scene(out / "scenes" / f"{name}.usda") for name in summary["scenes"]["evaluation"]]
    definition = policies[RECIPES[0]]["table"]["definition"]
    note = (
        f"Definition {definition!r}. AS: mean score of the valid rollouts, 0 to 1, Student-t interval over scenes, "
        "which one scene, or scenes that all score the same, do not give. CR: collision rate, the share of valid "
        "rollouts that touched anything, 0 to 1, Wilson interval. The last rows are policies that know nothing. The "
        "scenes are held out of every mixture. These are toy policies on a handful of scenes: the intervals say how "
        "little the difference between two rows means."
    )
    left_out = [word_omission(Omission(**record)) for record in summary["left_out"]]
    machine = summary["machine"]
    times = [(step, f"{seconds:.1f} s") for step, seconds in summary["timings"]["steps_s"].items()]
    versions = ", ".join(f"{package} {version}" for package, version in machine["packages"].items())
    about = f"{machine['processor']}, {machine['cores']} cores, Python {machine['python']}; {versions}."
    sections = [
        Section(
            "Closed-loop scores",
            [
                Text(word_verdict(summary)),
                Table(SCORE_COLUMNS, score_rows(summary), note),
                Table(
                    DIFFERENCE_COLUMNS,
                    difference_rows(summary),
                    "Differences of AS, paired by scene; bootstrap intervals over scenes. Clearly separated: 0 lies "
                    f"outside the interval, on at least {FEWEST_SCENES} scenes.",
                ),
            ],
        ),
        *_input_sections(out / "pictures", summary["input"]),
        _training_section(summary),
        Section("Rollouts from above", [_draw_scene(scene, drives) for scene in scenes]),
        Section("What was left out, and why", [Bullets(left_out)]),
        Section("Machine and run times", [Table(("step", "time"), times), Text(about)]),
    ]
    given = summary["input"]["name"] or "a drive of the synthetic world"
    lead = f"From one front video ({given}) to closed-loop scores; seed {summary['settings']['seed']}."
    write_report(out / REPORT, "OpenLongTail: the main job", lead, sections)


def word_verdict(summary: dict[str, Any]) -> str:
    """Whether the scores of the two policies differ by more than chance explains, and where to look if not."""
    (pair,) = (
        pair
        for pair in summary["closed_loop"]["comparison"]["differences"]
        if {pair["first"], pair["second"]} == set(RECIPES)
    )
    if pair["score"] is None:
        found = f"AS of {RECIPES[0]} and {RECIPES[1]} could not be compared: no scene has a score of both."
    else:
        interval = word_interval(pair["score_interval"]) or "not measured"
        found = (
            f"AS of {pair['first']} less that of {pair['second']}: {pair['score']:+.3f} (95 %: {interval}) on "
            f"{pair['scenes']} scenes."
        )
    if pair["separated"]:
        return f"The mixtures differ. {found}"
    few = f"Fewer than {FEWEST_SCENES} scenes cannot tell. " if pair["scenes"] < FEWEST_SCENES else ""
    return f"No difference between the mixtures is supported. {found} {few}{WHERE_ONE_IS_SHOWN}"


def score_rows(summary: dict[str, Any]) -> list[tuple[object, ...]]:
    """Rows of the score table: policy, category, AS and CR with their intervals, rollouts; baselines last."""
    closed_loop = summary["closed_loop"]
    rows = [(name, row) for name in RECIPES for row in closed_loop["policies"][name]["table"]["rows"]]
    rows += [(name, row) for name, row in closed_loop["comparison"]["policies"].items() if name not in RECIPES]
    return [
        (
            name,
            row["category"],
            row["alpasim_score"],
            word_interval(row["alpasim_score_interval"]),
            row["collision_rate"],
            word_interval(row["collision_rate_interval"]),
            f"{row['valid']} of {row['rollouts']}",
        )
        for name, row in rows
    ]


def difference_rows(summary: dict[str, Any]) -> list[tuple[object, ...]]:
    """Rows of differences of the trained policies from each other and from the baselines."""
    return [
        (
            pair["first"],
            pair["second"],
            pair["scenes"],
            pair["score"],
            word_interval(pair["score_interval"]),
            "yes" if pair["separated"] else "no",
        )
        for pair in summary["closed_loop"]["comparison"]["differences"]
        if pair["first"] in RECIPES
    ]


def _input_sections(pictures: Path, clip: dict[str, Any]) -> list[Section]:
    """The views of the input clip, and how good they and its trajectory are."""
    shown = {
        name: Picture.from_file(pictures / name, caption)
        for name, caption in (
            (CONTACT_SHEET, "The four views over time; invented pixels are tinted."),
            (TRUE_SHEET, "The true cross views, for comparison."),
            (TRAJECTORY, "The trajectory before and after smoothing."),
        )
        if (pictures / name).exists()
    }
    drawings = [shown.pop(TRAJECTORY)] if TRAJECTORY in shown else []
    motion = clip["trajectory"]
    quantities: list[tuple[object, ...]] = [
        ("path length (m)", "", motion["length"]),
        ("duration (s)", "", motion["duration"]),
        ("mean speed (m/s)", "", motion["mean_speed"]),
        ("relative 1-sigma of the metric scale", clip["scale_sigma"], ""),
    ]
    for measured in ("pose_errors", "smoothness"):
        before, after = _flatten(clip[f"{measured}_before_smoothing"]), _flatten(clip[measured])
        quantities += [(_word_quantity(name), before[name], value) for name, value in after.items()]
    quantities.append(("distance, median relative error", "", clip["distance_median_relative_error"]))
    views = [
        (
            camera,
            view["kind"],
            view["observed_share"],
            view["invented_share"],
            view["unseen_share"],
            *(clip["view_errors"].get(camera, {}).get(measure) for measure in ("psnr", "psnr_observed")),
        )
        for camera, view in clip["clip"]["views"].items()
    ]
    tables = [
        Table(
            ("quantity", "before smoothing", "after"),
            quantities,
            "metric: against the true motion as it is; sim3: after the best fit of place, heading and scale. ate: "
            "absolute trajectory error.",
        ),
        Table(
            ("view", "kind", "observed", "invented", "not seen", "PSNR (dB)", "PSNR observed (dB)"),
            views,
            "Shares of the pixels; PSNR of synthesized views against the true ones, over all pixels and over those "
            "observed.",
        ),
    ]
    doubts = [f"{doubt['what']}: {doubt['why']}" for doubt in clip["doubts"]]
    lists = {"What was assumed, not measured:": clip["assumptions"], "What is in doubt:": doubts}
    told = [block for title, lines in lists.items() for block in (Text(title), Bullets(lines or ["nothing"]))]
    return [
        Section("Four views from one", [*shown.values(), *told]),
        Section("Trajectory and clip", [*drawings, *tables]),
    ]


def _flatten(errors: dict[str, Any] | None, prefix: str = "") -> dict[str, Any]:
    """Nested numbers under joined names; empty where nothing was measured."""
    flat: dict[str, Any] = {}
    for name, value in (errors or {}).items():
        if name != "smoothness":  # of the same motion as that which stands by itself
            flat |= _flatten(value, f"{prefix}{name}: ") if isinstance(value, dict) else {prefix + name: value}
    return flat


_UNITS = {"_m2_s4": "m²/s⁴", "_m_s3": "m/s³", "_m": "m", "_deg": "degrees", "_percent": "%"}


def _word_quantity(name: str) -> str:
    """The name of a field in words, with its unit behind it."""
    for ending, unit in _UNITS.items():
        if name.endswith(ending):
            return f"{name.removesuffix(ending).replace('_', ' ')} ({unit})"
    return name.replace("_", " ")


def _training_section(summary: dict[str, Any]) -> Section:
    mixtures, training, clips = summary["mixtures"], summary["training"], summary["training_clips"]
    components = [
        (name, part["name"], part["asked"], part["got"], part["distinct"])
        for name in RECIPES
        for part in mixtures[name]["components"]
    ]
    stages = [
        (
            name,
            stage["stage"],
            len(stage["regression_warmup_losses"]),
            stage["steps"],
            stage["losses"][0],
            stage["final_loss"],
        )
        for name in RECIPES
        for stage in training[name]["stages"]
    ]
    errors = [
        (measure, *(training[name]["open_loop"][measure] for name in RECIPES))
        for measure in training[RECIPES[0]]["open_loop"]
    ]
    curves = [
        Picture.from_svg(
            draw_losses([(name, training[name]["stages"][index]["losses"]) for name in RECIPES], title), title
        )
        for index, title in enumerate(("Stage 1: trajectory tokens", "Stage 2: flow matching"))
    ]
    height, width = summary["settings"]["training_size"]
    about = f"{clips['clips']} clips of {height} x {width} pixels: {clips['gt']} GT and {clips['syn']} Syn"
    about += ", with those held out for open-loop errors."
    if clips["syn_ate_m_median"] is not None:
        about += (
            f" Trajectories of Syn clips are off by {clips['syn_ate_m_median']:.2f} m (median, absolute trajectory "
            f"error; at most {clips['syn_ate_m_max']:.2f} m), and {clips['syn_observed_share_of_cross_views']:.0%} of "
            "their cross views were observed."
        )
    tables = [
        Table(("mixture", "component", "samples asked", "got", "distinct"), components),
        Table(
            ("mixture", "stage", "regression warm-up steps", "steps after them", "first loss", "last loss"),
            stages,
            "Losses of the steps after the regression warm-up, as in the curves; the last one is a mean over their "
            "last tenth. Stage 1: cross-entropy of tokens (guessing is 8.0) and the toy's own losses; Stage 2: squared "
            "error of the flow of normalised actions.",
        ),
        Table(
            ("error (m)", *RECIPES),
            errors,
            f"Open-loop errors on {training[RECIPES[0]]['open_loop_samples']} samples of held-out nominal drives, "
            "means, one plan each; t in seconds.",
        ),
    ]
    return Section("Mixtures and two-stage training", [Text(about), *tables, *curves])


def _draw_scene(scene: Scene, drives: dict[str, list[Drive]]) -> Rollouts:
    """The first rollout of each policy in the scene, and the recording, seen from above."""
    first = {name: next(drive for drive in driven if drive[0].scene == scene.name) for name, driven in drives.items()}
    times = max((rollout.timestamps_us for rollout, _ in first.values()), key=len)
    recorded = scene.ego.interpolate(times[times <= scene.ego.timestamps_us[-1]])
    paths = {name: (rollout.states[:, :3], _find_incidents(rollout, score)) for name, (rollout, score) in first.items()}
    paths["recording"] = np.column_stack([recorded[:, :2, 3], yaw_of(recorded)]), {}
    box = scene.vehicle.length, scene.vehicle.width, scene.vehicle.rear_axle_to_bbox_center
    return Rollouts(
        title=f"{scene.name} ({', '.join(scene.factors) or scene.category})",
        caption="; ".join(f"{name}: {_describe(score)}" for name, (_, score) in first.items()),
        step_seconds=float(times[1] - times[0]) * 1e-6,
        areas=[outline[:, :2].tolist() for outline in scene.drivable],
        lines=[border[:, :2].tolist() for lane in scene.lanes for border in (lane.left, lane.right)],
        route=scene.route[:, :2].tolist(),
        paths=[DrivenPath(name, COLORS[name], *box, poses.tolist(), found) for name, (poses, found) in paths.items()],
        agents=[_draw_agent(agent, times) for agent in scene.agents],
    )


def _find_incidents(rollout: Rollout, score: dict[str, Any]) -> dict[int, str]:
    """Collisions and where the road was left, by frame of the animation."""
    found = [(collision["time_us"], "collision") for collision in score["collisions"]]
    if score["offroad_us"] is not None:
        found.append((score["offroad_us"], "off-road"))
    times = rollout.timestamps_us
    return {int(min(times.searchsorted(time_us), len(times) - 1)): what for time_us, what in found}


def _draw_agent(agent: Agent, times: NDArray[np.int64]) -> DrivenPath:
    box = agent_box(agent)
    there = box.covers(times)
    poses: list[list[float] | None] = [None] * len(times)
    for index, (x, y, _, yaw) in zip(there.nonzero()[0], box.at(times[there]), strict=True):
        poses[index] = [float(x), float(y), float(yaw)]
    return DrivenPath(agent.label, AGENT_COLOR, agent.length, agent.width, 0.0, poses)


def _describe(score: dict[str, Any]) -> str:
    if not score["valid"]:
        return f"not valid ({score['reason']})"
    reason = f", {score['reason'].replace('_', ' ')}" if score["reason"] else ""
    return f"score {score['score']:.2f}, progress {score['progress']:.2f}{reason}"
