"""`olt bench recognition`: whether a small classifier tells by its looks what stands before the front camera."""

from pathlib import Path
from typing import Annotated, Any

import typer

app = typer.Typer(add_completion=False)


@app.command()
def recognition(
    examples: Annotated[
        int, typer.Option(min=20, help="Pictures of each kind to learn from; a third for the test.")
    ] = 240,
    seed: Annotated[int, typer.Option(help="Seed of places, light and weights.")] = 0,
    out: Annotated[Path | None, typer.Option(help="Contact sheet of the kinds, .png.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Film road users, arms, signs and lights at 5 to 30 m, train a small network on the crops, and tell its accuracy.

    It learns and is asked on scenes of different seeds. Pictures have 320 x 576 pixels, and 64 x 112 as the toy's.
    """
    from olt_closed_loop.benchmarks.crop_classifier import classify
    from olt_closed_loop.benchmarks.crops import KINDS, draw_sheet, film_crops
    from olt_toolkit.runtime.console import print_json, print_line, print_table
    from olt_toolkit.runtime.environment import describe_machine

    rows: list[dict[str, Any]] = []
    sheets = []
    for size in ((320, 576), (64, 112)):
        crops, kinds, distances = film_crops(size, examples, seed)
        sheets.append(draw_sheet(crops, kinds, distances))
        rows.append({"size": list(size), **classify(crops, kinds, distances, seed)})
    if out:
        import cv2
        import numpy as np

        from olt_generator.files import write_whole

        with write_whole(out) as temporary:
            temporary.write_bytes(cv2.imencode(".png", np.concatenate(sheets)[..., ::-1])[1].tobytes())
    if as_json:
        print_json({"benchmark": "recognition", "kinds": list(KINDS), "sizes": rows, "machine": describe_machine()})
        return
    for row in rows:
        height, width = row["size"]
        table = [(kind, *(row["by_kind"][kind][name] for name in ("n", "right", "taken_for"))) for kind in KINDS]
        print_table(f"{height} x {width} pixels", ["kind", "crops", "right", "most often taken for"], table)
        print_line(
            f"right: {row['accuracy']:.3f} of {row['tested']} crops, {row['accuracy_near']:.3f} within 15 m; "
            f"learned from {row['trained']} in {row['seconds']:.0f} s; by chance {1 / len(KINDS):.3f}"
        )
