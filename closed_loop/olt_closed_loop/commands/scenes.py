"""What scenes are worth: recorded drives as scenes, the gate, and situations whose fault is known."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from olt_closed_loop.commands.options import Controller, Definition, Vehicle, check_picture

if TYPE_CHECKING:
    from olt_closed_loop.evaluation.gate import GateResult


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

    check_picture(picture)
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
        check_picture(path)
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
