"""`olt generate`: the learned engine, which generates the views of a clip."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from olt_toolkit.clips.backends import Precision
from olt_toolkit.commands.clip_options import JsonOption
from olt_toolkit.commands.generate_clips import clips
from olt_toolkit.commands.generate_embed import embed
from olt_toolkit.commands.generate_evaluate import evaluate
from olt_toolkit.commands.generate_train import train

if TYPE_CHECKING:
    from olt_generator.diffusion.accounting import ClipCost, PartSize

app = typer.Typer(add_completion=False, no_args_is_help=True)


@app.callback()
def generate() -> None:
    """Generate views with the learned engine, and tell what it takes."""


@app.command(help="Tell the parameters, operations and memory of an engine without building it.")
def describe(
    config: Annotated[str, typer.Option(help="Engine: 1.3B or tiny.")] = "1.3B",
    view: Annotated[
        list[str] | None, typer.Option(help="A view that is wanted; repeat for more. All by default.")
    ] = None,
    frames: Annotated[int, typer.Option(help="Frames of a clip, 4 k + 1.")] = 41,
    width: Annotated[int, typer.Option(help="Width of the images, a multiple of 16.")] = 832,
    height: Annotated[int, typer.Option(help="Height of the images, a multiple of 16.")] = 480,
    steps: Annotated[int, typer.Option(min=1, help="Euler steps of a view.")] = 50,
    guidance: Annotated[bool, typer.Option(help="Two passes a step, with and without the prompt, or one.")] = True,
    precision: Annotated[Precision, typer.Option(help="Of weights and activations.")] = Precision.BFLOAT16,
    as_json: JsonOption = False,
) -> None:
    """Count parameters against the paper's table, and operations and memory of each view and of the clip."""
    import torch

    from olt_generator.diffusion.accounting import compare_with_paper, cost_of_clip, describe_parts, weight_bytes
    from olt_generator.diffusion.config import find_config
    from olt_generator.diffusion.view_graph import VIEWS, order_views
    from olt_toolkit.runtime.console import print_json

    engine, order = find_config(config), order_views(view or VIEWS[1:])
    dtype = getattr(torch, precision.value)
    parts = describe_parts(engine)
    cost = cost_of_clip(engine, (frames, height, width), order.views, steps * (1 + guidance), dtype)
    result: dict[str, Any] = {
        "config": config,
        "parameters": [{"part": part.name, "parameters": part.parameters, "trained": part.trainable} for part in parts],
        "paper": [{"item": item, "paper": paper, "here": here} for item, paper, here in compare_with_paper(engine)],
        "settings": {
            "frames": frames,
            "width": width,
            "height": height,
            "steps": steps,
            "passes": steps * (1 + guidance),
            "precision": precision.value,
        },
        "weights_bytes": weight_bytes(engine, dtype),
        "views": [
            {
                "view": VIEWS[index],
                "wanted": index not in order.helpers,
                "conditions": of_view.conditions,
                "pass_flops": of_view.step.flops,
                "pass_peak_bytes": of_view.step.peak_bytes,
                "memory_flops": of_view.remember.flops,
                "flops": of_view.flops,
            }
            for index, of_view in cost.views.items()
        ],
        "left_out": [omission.to_dict() for omission in order.left_out],
        "encode_flops": cost.encode.flops,
        "decode_flops": cost.decode.flops,
        "clip_flops": cost.flops,
        "seconds": None,
    }
    if as_json:
        print_json(result)
    else:
        _print_tables(result, parts, cost)


app.command(help="Make the missing views of recordings, of those of a folder, or of a data set, as clips.")(clips)
app.command(help="Train an engine on drives, its own synthetic ones by default; goes on where it stopped.")(train)
app.command(help="Write the embeddings of a prompt that the 1.3B engine is trained with.")(embed)
app.command(help="Score an engine on clips kept from its training: the tables of the paper.")(evaluate)


def _print_tables(result: dict[str, Any], parts: "tuple[PartSize, ...]", cost: "ClipCost") -> None:
    from olt_generator.omissions import Omission, word_omission
    from olt_toolkit.runtime.console import print_line, print_table

    rows = [(part.name, f"{part.parameters:,}", "trained" if part.trainable else "frozen") for part in parts]
    for trainable, word in ((True, "trained"), (False, "frozen")):
        rows.append(("all", f"{sum(part.parameters for part in parts if part.trainable == trainable):,}", word))
    print_table(f"Parameters of {result['config']}", ("part", "parameters", "training"), rows)
    columns = ("item", "paper", "here")
    print_table("Against the paper", columns, [tuple(row[column] for column in columns) for row in result["paper"]])
    print_table(
        f"A view, {result['settings']['passes']} passes in {result['settings']['precision']}",
        ("view", "conditions", "a pass, TFLOP", "peak beside weights, GB", "memory, TFLOP", "view, PFLOP"),
        [
            (
                row["view"] + ("" if row["wanted"] else " (for others)"),
                row["conditions"],
                row["pass_flops"] / 1e12,
                row["pass_peak_bytes"] / 1e9,
                row["memory_flops"] / 1e12,
                row["flops"] / 1e15,
            )
            for row in result["views"]
        ],
    )
    rows = [
        ("weights, without the autoencoder", f"{result['weights_bytes'] / 1e9:.4g} GB"),
        ("a video encoded, decoded", f"{cost.encode.flops / 1e12:.4g}, {cost.decode.flops / 1e12:.4g} TFLOP"),
        ("the clip", f"{cost.flops / 1e15:.4g} PFLOP"),
        ("run time", None),
    ]
    print_table("The clip", ("what", "how much"), rows)
    for left_out in result["left_out"]:
        print_line(f"left out: {word_omission(Omission(**left_out))}")
