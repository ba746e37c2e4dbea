"""`olt closed-loop`: drive scenes and score the drives."""

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from olt_closed_loop.suite_commands import app as suite_app
from olt_toolkit.commands.parallel_options import EngineOption, WorkersOption
from olt_toolkit.runtime.workers import Engine

if TYPE_CHECKING:
    from olt_closed_loop.evaluation.comparison import Comparison
    from olt_closed_loop.evaluation.gate import GateResult
    from olt_closed_loop.evaluation.score_table import ScoreRow, ScoreTable
    from olt_closed_loop.evaluation.suite_table import SuiteTable
    from olt_closed_loop.scoring.collisions import Collision
    from olt_closed_loop.scoring.definitions import RolloutScore
    from olt_closed_loop.simulation.policy_hosts import PolicyLimits
    from olt_closed_loop.suite.files import Suite
    from olt_generator.omissions import Omission

INCIDENT_WORDS = {
    "plans_refused": "a plan was refused and the last one held",
    "policy_errors": "the policy raised an error",
    "policy_exits": "the policy called for an exit",
    "policy_deaths": "the policy's process died",
    "policy_timeouts": "the policy gave no answer in time",
    "wrong_answers": "the policy answered with something else than a plan",
    "inputs_changed": "the policy changed what it was shown",
    "globals_changed": "the policy changed global states",
    "steps_failed": "the vehicle could not follow a plan",
    "saturations": "a command reached a limit of the vehicle",
    "solves_failed": "the controller found no command and held the last ones",
    "solves_late": "the controller was late and held the last commands",
    "solves_given_up": "fatrop gave up and Gauss-Newton was asked",
}
"""What those counts of `rollouts.rollout.Incidents` that are no good news are called in print."""

LISTED = {
    "rollout": "rollout",
    "scene": "scene",
    "seed": "seed",
    "score": "score",
    "reason": "reason",
    "plans_asked": "plans",
    "plans_refused": "refused",
    "solves": "solves",
    "solves_failed": "failed",
    "solves_late": "late",
    "saturations": "saturated",
    "plan_deviation_max": "off the plan (m)",
}
"""Columns of the list of rollouts."""

app = typer.Typer(no_args_is_help=True, help="Drive policies through scenes and score them.")
app.add_typer(suite_app, name="suite")


# What the options take, as the modules named beside them have it; those are loaded only when a command runs.
Definition = Literal["strict", "alpasim", "alpasim@3032e0c", "alpasim@challenge-2026-09"]  # scoring.definitions
Traffic = Literal["recorded", "idm"]  # rollouts.rollout
Vehicle = Literal["kinematic", "tyres"]  # simulation.settings
Controller = Literal["lqr", "linear", "nonlinear"]  # control.tracking
Integrator = Literal["auto", "midpoint", "rk4", "radau", "cvodes"]  # vehicle.integrators
Light = Literal["day", "low_sun", "night"]  # scenes.conditions
Isolation = Literal["auto", "none", "process"]  # simulation.policy_hosts
HostOption = Annotated[str, typer.Option(help="Address to listen at; 0.0.0.0 for other machines.")]
SessionsOption = Annotated[int, typer.Option(min=1, help="Most sessions at once.")]
IdleOption = Annotated[float, typer.Option(min=0.1, help="Seconds without a call after which a session is dropped.")]
IsolationOption = Annotated[
    Isolation, typer.Option(help="Where the policy runs; auto: a process of its own for all but the toolkit's own.")
]
PolicyTimeoutOption = Annotated[
    float | None, typer.Option(help="Seconds for one answer in a process of its own; 30 by default.")
]
PolicyMemoryOption = Annotated[
    float | None, typer.Option(help="GiB that it may allocate there; 8 by default, 0 for any.")
]


@app.command()
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
    from olt_toolkit.runtime.workers import default_workers

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
        limits=_limits(isolate, policy_timeout, policy_memory),
    )
    driven_suite = _suite_of(suite, [*(scenes or []), *(scene or [])])
    sources = find_scenes(driven_suite.sources if driven_suite else [*(scenes or []), *(scene or [])])
    if not sources:
        raise typer.BadParameter("give a scene: a scene file, a recorded drive, CATEGORY:SEED, or --suite")
    with make_progress() as progress:
        total = len(sources) * rollouts
        task = progress.add_task("closed loop", total=total)
        results = run_closed_loop(
            sources,
            policy,
            rollouts,
            seed,
            settings,
            workers=workers or default_workers(),
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
                workers=workers or default_workers(),
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
        _print_scores(f"{policy}, {traffic} traffic", table)
        if by_suite:
            _print_suite(by_suite)
        _print_comparison("All scenes, beside policies that know nothing" if beside else "All scenes", comparison)
        for line in warnings:
            print_line(f"WARNING: {line}")
        _print_notes(scores, table.overall, vehicle_steps, left_out)
    if table.overall.valid < table.overall.rollouts:
        raise typer.Exit(1)


@app.command()
def serve(
    policy: Annotated[str, typer.Option(help="NAME or NAME:PATH, as `run` takes it.")],
    host: HostOption = "127.0.0.1",
    port: Annotated[int, typer.Option(help="0 for any free one.", envvar="ALPASIM_DRIVER_PORT")] = 6789,
    sessions: SessionsOption = 64,
    idle_timeout: IdleOption = 600.0,
    isolate: IsolationOption = "auto",
    policy_timeout: PolicyTimeoutOption = None,
    policy_memory: PolicyMemoryOption = None,
) -> None:
    """Serve a policy as a driver of AlpaSim (gRPC service egodriver), until told to end.

    Whoever reaches the port can drive with the policy: there are no passwords.
    """
    from olt_closed_loop.drivers.driver_service import DriverService
    from olt_closed_loop.drivers.server import serving, wait_for_end
    from olt_toolkit.runtime.console import print_line

    service = DriverService(policy, sessions, _limits(isolate, policy_timeout, policy_memory), idle_timeout)
    with closing(service), serving(service, host, port, sessions) as bound:
        print_line(f"{policy} serves egodriver.EgodriverService at {host}:{bound}")
        wait_for_end()


@app.command()
def serve_vehicle(
    vehicle: Annotated[Vehicle, typer.Option(help="How it moves.")] = "tyres",
    controller: Annotated[
        Controller, typer.Option(help="What follows the plan: LQR, linear or nonlinear MPC.")
    ] = "linear",
    integrator: Annotated[Integrator, typer.Option(help="How the vehicle is integrated.")] = "auto",
    host: HostOption = "127.0.0.1",
    port: Annotated[int, typer.Option(help="0 for any free one.")] = 6790,
    sessions: SessionsOption = 64,
    idle_timeout: IdleOption = 600.0,
) -> None:
    """Serve the vehicle and its controller to AlpaSim (gRPC service VDCService), until told to end."""
    from olt_closed_loop import ControlSettings
    from olt_closed_loop.drivers.driven_vehicle import DrivenVehicle
    from olt_closed_loop.drivers.server import serving, wait_for_end
    from olt_closed_loop.drivers.vehicle_service import VehicleService
    from olt_closed_loop.vehicle.parameters import VehicleParameters, vehicle_with_tyres
    from olt_toolkit.rigs.rig import DEFAULT_VEHICLE
    from olt_toolkit.runtime.console import print_line

    make = vehicle_with_tyres if vehicle == "tyres" else VehicleParameters.from_dimensions
    parameters, settings = make(DEFAULT_VEHICLE), ControlSettings(method=controller)
    name = f"{vehicle}-{controller}"
    service = VehicleService(lambda: DrivenVehicle(parameters, settings, integrator), name, sessions, idle_timeout)
    with closing(service), serving(service, host, port, sessions) as bound:
        print_line(f"{name} serves controller.VDCService at {host}:{bound}")
        wait_for_end()


@app.command()
def show(
    run: Annotated[Path, typer.Argument(help="Folder of `olt closed-loop run --out`.")],
    rollout: Annotated[str | None, typer.Argument(help="Its number or SCENE:SEED; without, all are listed.")] = None,
    draw_all: Annotated[bool, typer.Option("--all", help="Draw every rollout.")] = False,
    video: Annotated[bool, typer.Option(help="Make an mp4 too.")] = True,
    scene: Annotated[str | None, typer.Option(help="The scene, if the run's own is not where it was.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for pictures and videos; by default RUN/shown.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """List the finished rollouts of a run, or draw one: from above, over time, and as a video."""
    from olt_closed_loop.evaluation.show import find_rollouts, show_rollouts, summarize_rollout
    from olt_toolkit.runtime.console import make_progress, print_json, print_line, print_table

    if rollout is not None and draw_all:
        raise typer.BadParameter("give either a rollout or --all")
    found = find_rollouts(run, rollout)
    shown = []
    if rollout is not None or draw_all:
        with make_progress() as progress:
            task = progress.add_task("show", total=len(found))
            for one in found:
                shown += show_rollouts([one], out or run / "shown", scene, video)
                progress.advance(task)
    rows = [summarize_rollout(one) for one in found]
    files = [str(path) for one in shown for path in (one.picture, one.video) if path]
    if as_json:
        print_json({"rollouts": rows, "files": files})
        return
    if rollout is not None:
        print_table(f"rollout {rows[0]['rollout']}", ["figure", "value"], list(rows[0].items()))
    else:
        print_table(str(run), list(LISTED.values()), [[row[name] for name in LISTED] for row in rows])
    for file in files:
        print_line(file)


@app.command()
def compare(
    runs: Annotated[list[Path], typer.Argument(help="Folders that `olt closed-loop run --out` wrote, two or more.")],
    out: Annotated[Path | None, typer.Option(help="Folder for comparison.json and comparison.png.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Compare policies on the scenes that all of them drove: differences paired by scene, with intervals."""
    from olt_closed_loop.evaluation.comparison import compare_scores, name_runs, read_scores
    from olt_closed_loop.evaluation.comparison_report import save_comparison
    from olt_toolkit.runtime.console import print_json, print_line

    if len(set(runs)) < 2:
        raise typer.BadParameter("give two or more folders of runs")
    scores = [read_scores(folder) for folder in runs]
    comparison = compare_scores(dict(zip(name_runs(runs, scores), scores, strict=True)))
    if out:
        save_comparison(out, comparison)
    if as_json:
        print_json(comparison.to_dict())
        return
    _print_comparison("Scenes that all of them drove", comparison)
    if comparison.not_compared:
        print_line(f"not compared: {len(comparison.not_compared)} scenes that only some of them drove")


@app.command()
def gate(
    scenes: Annotated[list[str], typer.Argument(help="Scene files, recorded drives (file or folder), CATEGORY:SEED.")],
    definition: Annotated[Definition, typer.Option(help="How the score is defined.")] = "strict",
    vehicle: Annotated[Vehicle, typer.Option(help="How the ego moves.")] = "kinematic",
    controller: Annotated[Controller, typer.Option(help="What follows the recording.")] = "linear",
    picture: Annotated[Path | None, typer.Option(help="Picture of the scenes from above, .png, .svg or .pdf.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Check on scenes that drives of known worth get what they are worth, and that a good driver can drive them.

    Exit status 1 if a check fails on a scene, or a scene is refused.
    """
    from olt_closed_loop import ControlSettings, SimulationSettings
    from olt_closed_loop.evaluation.evaluation import find_scenes, gate_scene
    from olt_toolkit.runtime.console import make_progress, print_json, print_table

    if picture and picture.suffix not in (".png", ".svg", ".pdf"):
        raise typer.BadParameter(f"{picture}: give a file ending in .png, .svg or .pdf")
    settings = SimulationSettings(vehicle=vehicle, control=ControlSettings(method=controller))
    sources = find_scenes(scenes)
    with make_progress() as progress:
        opened = [gate_scene(s, settings, definition) for s in progress.track(sources, description="gate")]
    results = [result for _, result in opened]
    read = [(scene, result) for scene, result in opened if scene and not result.refusal]
    if picture and read:
        from olt_closed_loop.evaluation.gate_picture import draw_gate

        draw_gate(picture, read)
    if as_json:
        print_json({"passed": all(result.passed for result in results), "gate": [r.to_dict() for r in results]})
    else:
        columns = ["scene", "check", "holds", "found"]
        print_table(f"Gate, definition {definition}", columns, [row for r in results for row in _gate_rows(r)])
    if not all(result.passed for result in results):
        raise typer.Exit(1)


def _gate_rows(result: "GateResult") -> list[tuple[str, str, str, str]]:
    """The checks of a scene, where it is narrow, or why it is refused."""
    if result.refusal:
        return [(result.scene, "can be driven", "NO", result.refusal)]
    answers = {True: "yes", False: "NO", None: "cannot be asked"}
    rows = [(result.scene, check.name, answers[check.passed], check.finding) for check in result.checks]
    places = [f"{place.metres:.2f} m to {place.what} at {place.time_us * 1e-6:.1f} s" for place in result.narrow]
    return [*rows, (result.scene, "narrowest", "", ", ".join(places) or "no border and no agents")]


@app.command(name="scene")
def convert_scene(
    recording: Annotated[str, typer.Argument(help="A recorded drive (file or folder), or CATEGORY:SEED.")],
    out: Annotated[Path, typer.Option(help="Scene file to write, .usda or .usdc; its looks are written beside it.")],
    room: Annotated[
        float | None, typer.Option(help="Metres about the recorded ego that are drivable wherever it drove.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Write a recorded drive as a scene, and say what was assumed and whether the gate holds on it."""
    from olt_closed_loop import check_gate, load_scene, write_scene
    from olt_closed_loop.scenes.sources.swath import add_room
    from olt_toolkit.runtime.console import make_progress, print_json, print_table

    if out.suffix not in (".usda", ".usdc"):
        raise typer.BadParameter(f"{out}: give a file ending in .usda or .usdc")
    with make_progress() as progress:
        task = progress.add_task("scene", total=3)
        loaded = load_scene(recording) if room is None else add_room(load_scene(recording), room)
        progress.advance(task)
        result = check_gate(loaded)
        progress.advance(task)
        write_scene(loaded, out)
        progress.advance(task)
    figures = {
        "name": loaded.name,
        "seconds": float(loaded.ego.times[-1]),
        "metres": loaded.ego.path_length,
        "agents": len(loaded.agents),
        "lanes": len(loaded.lanes),
        "lights": len(loaded.lights),
        "lights_not_drawn": sum(light.position is None for light in loaded.lights),
    }
    if as_json:
        print_json(
            {**figures, "assumptions": list(loaded.assumptions), "gate": result.to_dict(), "scene_file": str(out)}
        )
    else:
        rows = [*figures.items(), *(("assumed", text) for text in loaded.assumptions)]
        rows += [(f"gate: {check.name}", check.finding) for check in result.checks]
        print_table(str(out), ["figure", "value"], rows)
    if not result.passed:
        raise typer.Exit(1)


@app.command()
def score_rollout(
    file: Annotated[Path, typer.Argument(help="One rollout as JSON (olt_closed_loop.rollouts.rollout_files).")],
    definition: Annotated[Definition, typer.Option(help="How the score is defined.")] = "strict",
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Score one recorded rollout."""
    from olt_closed_loop import read_rollout_file, score_record
    from olt_closed_loop.scoring.alpasim.scores import score_as_alpasim
    from olt_closed_loop.scoring.definitions import alpasim_rows, alpasim_version, full_definition
    from olt_toolkit.runtime.console import print_json, print_table

    record, definition = read_rollout_file(file), full_definition(definition)
    version = alpasim_version(definition)
    if version:
        score = score_record(record, definition)
        (row,) = alpasim_rows([score])
        result = {"definition": definition, **score_as_alpasim(record, version).to_dict(), "summary_row": row}
        if score.failed:  # whose metrics AlpaSim never looks at
            result |= {"final": {}, "scene": {name: row[name] for name in ("score", "failure_reason", "passed")}}
        figures = {"status": row["status"], **result["scene"], **result["final"]}
    else:
        strict = score_record(record)
        result = strict.to_dict()
        figures = {name: value for name, value in result.items() if name not in ("metrics", "collisions", "left_out")}
        figures |= strict.metrics | {f"hits {c.agent_id}": word_collision(c) for c in strict.collisions}
    if as_json:
        print_json(result)
    else:
        print_table(f"{file.name}, definition {definition}", ["figure", "value"], list(figures.items()))


def _limits(isolate: Isolation, timeout: float | None, memory: float | None) -> "PolicyLimits":
    """What the policy may take. Limits that are given ask for a process of its own."""
    from olt_closed_loop import PolicyLimits

    given = timeout is not None or memory is not None
    if given and isolate == "none":
        raise typer.BadParameter("--policy-timeout and --policy-memory hold in a process; leave out --isolate none")
    defaults = PolicyLimits()
    return PolicyLimits(
        isolate="process" if given else isolate,
        call_seconds=defaults.call_seconds if timeout is None else timeout,
        memory_bytes=defaults.memory_bytes if memory is None else round(memory * 2**30) or None,
    )


@app.command()
def faults(
    picture: Annotated[
        Path | None, typer.Option(help="Picture of all situations from above: .png, .svg, .pdf.")
    ] = None,
    sweeps: Annotated[
        Path | None, typer.Option(help="Picture of where verdicts change over speed, angle, gap and time.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Say of named situations whose fault they are, why, and what AlpaSim and nuPlan say."""
    from olt_closed_loop.situations.drawing import VERDICTS, draw_situations, draw_sweeps
    from olt_closed_loop.situations.sweeps import sweep_all
    from olt_closed_loop.situations.table import judge_all
    from olt_toolkit.runtime.console import print_json, print_line, print_table

    for path in (picture, sweeps):
        if path and path.suffix not in (".png", ".svg", ".pdf"):
            raise typer.BadParameter(f"{path}: give a file ending in .png, .svg or .pdf")
    rows = judge_all()
    swept = sweep_all() if sweeps else ()
    if picture:
        draw_situations(rows, picture)
    if sweeps:
        draw_sweeps(swept, sweeps)
    right = sum(row.right for row in rows)
    if as_json:
        situations = [{**vars(row), "right": row.right} for row in rows]
        print_json({"right": right, "situations": situations, "sweeps": [vars(sweep).copy() for sweep in swept]})
    else:
        cells = [
            (
                row.situation,
                VERDICTS[row.at_fault] + ("" if row.right else ", WRONG"),
                f"{row.rule}: {row.reason}",
                VERDICTS[row.alpasim],
                VERDICTS[row.nuplan_at_fault] + (f" ({row.nuplan})" if row.nuplan else ""),
                row.why,
            )
            for row in rows
        ]
        columns = ["the ego ...", "verdict", "why", "AlpaSim", "nuPlan", "why ours holds"]
        print_table("Whose fault", columns, cells)
        print_line(f"{right} of {len(rows)} situations right")
    if right < len(rows):
        raise typer.Exit(1)


def word_collision(collision: "Collision") -> str:
    """When, where, whose fault, and why."""
    whose = "at fault" if collision.at_fault else "not at fault"
    return f"{collision.side} at {collision.time_us} us, {whose}: {collision.rule} ({collision.reason})"


def _print_scores(title: str, table: "ScoreTable") -> None:
    from olt_toolkit.runtime.console import print_table, word_interval

    rows = [
        [
            row.category,
            f"{row.valid} / {row.rollouts}",
            row.alpasim_score,
            word_interval(row.alpasim_score_interval),
            row.collision_rate,
            word_interval(row.collision_rate_interval),
            f"{counts['solves_failed']} / {counts['solves_late']}" if (counts := row.rollout_incidents) else None,
        ]
        for row in table.rows
    ]
    columns = ["category", "valid / rollouts", "AS", "95 %", "CR", "95 %", "solves failed / late"]
    print_table(f"{title}, definition {table.definition}", columns, rows)


def _suite_of(suite: str | None, scenes: list[str]) -> "Suite | None":
    """The suite to drive; None for scenes."""
    from olt_closed_loop.suite.files import find_suite

    if suite is not None and scenes:
        raise typer.BadParameter("give either scenes or --suite; a suite's file may name further scenes")
    return find_suite(suite) if suite is not None else None


def _print_suite(table: "SuiteTable") -> None:
    from olt_closed_loop.evaluation.score_table import ScoreTable
    from olt_toolkit.runtime.console import print_line

    if table.factors:
        _print_scores(f"{table.suite} by factor", ScoreTable(table.categories.definition, table.factors))
    score, rate = (
        "not measured" if value is None else f"{value:.3f}"
        for value in (table.weighted_score, table.weighted_collision_rate)
    )
    print_line(f"suite {table.suite}, by the weights of its scenes: AS {score}, CR {rate}")


def _print_comparison(title: str, comparison: "Comparison") -> None:
    from olt_closed_loop.evaluation import comparison_report as report
    from olt_toolkit.runtime.console import print_table

    print_table(f"{title}: {comparison.scenes}", report.POLICY_COLUMNS, report.policy_rows(comparison))
    if comparison.differences:
        rows = report.difference_rows(comparison.differences)
        print_table("Paired by scene", report.DIFFERENCE_COLUMNS, rows)


def _print_notes(
    scores: "list[RolloutScore]",
    overall: "ScoreRow",
    vehicle_steps: dict[str, int],
    left_out: "dict[Omission, int]",
) -> None:
    """What was not valid, went wrong, was taken and was left out, a line each."""
    from olt_generator.omissions import word_omission
    from olt_toolkit.runtime.console import print_line

    for line in sorted({f"{score.scene}: not valid: {score.reason}" for score in scores if not score.valid}):
        print_line(line)
    for name, count in overall.rollout_incidents.items():
        if count and name in INCIDENT_WORDS:
            print_line(f"{INCIDENT_WORDS[name]}: {count} times")
    if overall.plan_deviation_max is not None:
        print_line(f"the vehicle was at most {overall.plan_deviation_max:.2f} m from the plan within the second ahead")
    for way, count in vehicle_steps.items():
        print_line(f"vehicle moved by {way} in {count} steps")
    for omission, count in left_out.items():
        print_line(f"left out in {count} of {len(scores)} rollouts: {word_omission(omission)}")
