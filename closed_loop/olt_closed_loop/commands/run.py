"""Drive scenes, or a suite, with a policy."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from olt_closed_loop.commands.options import (
    Controller,
    Definition,
    Integrator,
    IsolationOption,
    Light,
    PolicyMemoryOption,
    PolicyTimeoutOption,
    Traffic,
    Vehicle,
    policy_limits,
)
from olt_closed_loop.commands.score_output import print_comparison, print_notes, print_scores, print_suite
from olt_toolkit.commands.parallel_options import EngineOption, WorkersOption
from olt_toolkit.runtime.workers import Engine

if TYPE_CHECKING:
    from olt_closed_loop.suite.files import Suite


def run(
    policy: Annotated[
        str, typer.Option(help="NAME, NAME:PATH or grpc://HOST:PORT, such as route or toy:CHECKPOINT.")
    ] = "route",
    scenes: Annotated[
        list[str] | None, typer.Argument(help="Scene files, recorded drives (file or folder), or CATEGORY:SEED.")
    ] = None,
    scene: Annotated[list[str] | None, typer.Option(help="The same as an argument.")] = None,
    suite: Annotated[
        str | None, typer.Option(help="Drive a suite instead of scenes: longtail, all, a category, or a YAML file.")
    ] = None,
    rollouts: Annotated[int, typer.Option(help="Drives of each scene.")] = 2,
    seed: Annotated[int, typer.Option(help="Seed of the first drive; the next has the next number.")] = 0,
    duration: Annotated[float, typer.Option(help="Seconds of a drive, 1.7 s of warm-up included.")] = 20.0,
    planner_delay: Annotated[float, typer.Option(help="Seconds from asking for a plan until it is in force.")] = 0.0,
    plan_interval: Annotated[float, typer.Option(help="Seconds from asking for a plan until the next.")] = 0.1,
    traffic: Annotated[Traffic, typer.Option(help="How agents move.")] = "recorded",
    vehicle: Annotated[Vehicle, typer.Option(help="How the ego moves.")] = "kinematic",
    controller: Annotated[
        Controller, typer.Option(help="What follows the plan: LQR, linear or nonlinear MPC.")
    ] = "linear",
    smoothing_window: Annotated[
        float, typer.Option(help="Smoothing of each plan sideways, seconds; 0 for none. It delays nothing.")
    ] = 0.2,
    smoothing_delay: Annotated[
        float, typer.Option(help="Mean over successive plans sideways, time constant in seconds; 0 for none.")
    ] = 0.4,
    integrator: Annotated[
        Integrator, typer.Option(help="How the vehicle is integrated; auto: the cheapest within 3e-7 m a step.")
    ] = "auto",
    light: Annotated[Light, typer.Option(help="Light in which cameras see the scene.")] = "day",
    weather: Annotated[
        str, typer.Option(help="Weather in which they see it: clear, rain, fog, or an amount as in rain:0.3.")
    ] = "clear",
    camera_fault: Annotated[
        list[str] | None,
        typer.Option(
            help="KIND=AMOUNT or KIND:CAMERA=AMOUNT: noise (grey levels), exposure (stops), dropped (share), "
            "late (seconds), frozen (from second), swapped:CAMERA=CAMERA. Several add up in order."
        ),
    ] = None,
    definition: Annotated[Definition, typer.Option(help="How the score is defined.")] = "strict",
    baselines: Annotated[
        bool, typer.Option(help="Drive constant speed, go straight, stop and route beside the policy.")
    ] = True,
    skip: Annotated[bool, typer.Option(help="Leave out what cannot change the result.")] = True,
    isolate: IsolationOption = "auto",
    policy_timeout: PolicyTimeoutOption = None,
    policy_memory: PolicyMemoryOption = None,
    workers: WorkersOption = None,
    engine: EngineOption = Engine.LOCAL,
    out: Annotated[
        Path | None, typer.Option(help="Folder that keeps finished rollouts, to go on from, and the results.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Drive scenes with a policy and print AS and CR by category, and beside those of policies that know nothing.

    A scene on which the gate fails, and a rollout that failed, lose themselves only; the exit status is then 1.
    """
    from olt_closed_loop import ControlSettings, SimulationSettings, run_closed_loop, summarize_scores
    from olt_closed_loop.evaluation.alpasim_summary import save_alpasim_summary
    from olt_closed_loop.evaluation.baselines import BASELINES, run_baselines, word_warnings
    from olt_closed_loop.evaluation.comparison import compare_scores
    from olt_closed_loop.evaluation.comparison_report import save_comparison
    from olt_closed_loop.evaluation.evaluation import count_left_out, count_vehicle_steps, find_scenes
    from olt_closed_loop.evaluation.suite_table import save_suite_table, summarize_suite
    from olt_closed_loop.scenes.conditions import parse_conditions
    from olt_closed_loop.simulation.camera_faults import parse_camera_fault
    from olt_toolkit.rigs.rig import CAMERA_INDEX
    from olt_toolkit.runtime.console import make_progress, print_json, print_line
    from olt_toolkit.runtime.workers import default_workers, kept_workers

    settings = SimulationSettings(
        duration_us=round(duration * 1e6),
        planner_delay_us=round(planner_delay * 1e6),
        plan_interval_us=round(plan_interval * 1e6),
        traffic=traffic,
        vehicle=vehicle,
        integrator=integrator,
        control=ControlSettings(method=controller, smoothing_window=smoothing_window, smoothing_delay=smoothing_delay),
        skip=skip,
        conditions=parse_conditions(light, weather),
        camera_faults=tuple(parse_camera_fault(text, list(CAMERA_INDEX)) for text in camera_fault or ()),
        limits=policy_limits(isolate, policy_timeout, policy_memory),
    )
    driven_suite = _suite_of(suite, [*(scenes or []), *(scene or [])])
    sources = find_scenes(driven_suite.sources if driven_suite else [*(scenes or []), *(scene or [])])
    if not sources:
        raise typer.BadParameter("give a scene: a scene file, a recorded drive, CATEGORY:SEED, or --suite")
    workers = workers or default_workers()
    with kept_workers(workers if engine is Engine.LOCAL else 1), make_progress() as progress:
        total = len(sources) * rollouts
        task = progress.add_task("closed loop", total=total)
        results = run_closed_loop(
            sources,
            policy,
            rollouts,
            seed,
            settings,
            workers=workers,
            on_progress=lambda share: progress.update(task, completed=round(share * total)),
            definition=definition,
            out=out,
            engine=engine,
        )
        beside = {}
        if baselines:
            task = progress.add_task("baselines", total=len(sources) * len(BASELINES))
            beside = run_baselines(
                sources,
                policy,
                seed,
                settings,
                workers=workers,
                on_progress=lambda share: progress.update(task, completed=round(share * len(sources) * len(BASELINES))),
                definition=definition,
                out=out / "baselines" if out else None,
                engine=engine,
                beside=results,
            )
    scores = [score for _, score in results]
    by_suite = summarize_suite(driven_suite, scores) if driven_suite else None
    table = by_suite.categories if by_suite else summarize_scores(scores)
    comparison = compare_scores(
        {policy: scores, **{name: [score for _, score in driven] for name, driven in beside.items()}}, policy
    )
    warnings = word_warnings(comparison)
    left_out, vehicle_steps = count_left_out(results), count_vehicle_steps(results)
    if out:
        save_comparison(out, comparison, warnings)
        if by_suite:
            save_suite_table(out / "suite.json", by_suite)
        if definition != "strict":
            save_alpasim_summary(out / "results-summary.json", scores)
    if as_json:
        print_json(
            {
                "policy": policy,
                "traffic": traffic,
                "vehicle": vehicle,
                "controller": controller,
                "smoothing": {"window": smoothing_window, "delay": smoothing_delay},
                "integrator": integrator,
                "conditions": settings.conditions.words,
                "camera_faults": [fault.words for fault in settings.camera_faults],
                "table": table.to_dict(),
                "suite": by_suite.to_dict() if by_suite else None,
                "scores": [score.to_dict() for score in scores],
                "comparison": comparison.to_dict(),
                "warnings": warnings,
                "left_out": [{**omission.to_dict(), "rollouts": count} for omission, count in left_out.items()],
                "vehicle_steps": vehicle_steps,
            }
        )
    else:
        print_scores(f"{policy}, {traffic} traffic", table)
        if by_suite:
            print_suite(by_suite)
        print_comparison("All scenes, beside policies that know nothing" if beside else "All scenes", comparison)
        for line in warnings:
            print_line(f"WARNING: {line}")
        print_notes(scores, table.overall, vehicle_steps, left_out)
    if table.overall.valid < table.overall.rollouts:
        raise typer.Exit(1)


def _suite_of(suite: str | None, scenes: list[str]) -> "Suite | None":
    """The suite to drive; None for scenes."""
    from olt_closed_loop.suite.files import find_suite

    if suite is not None and scenes:
        raise typer.BadParameter("give either scenes or --suite; a suite's file may name further scenes")
    return find_suite(suite) if suite is not None else None
