"""`olt bench flow`: solvers of the toy's flow, its precision, and what it does where it sees nothing or moves oddly."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from olt_toolkit import PolicySample

app = typer.Typer(add_completion=False)


@app.command()
def flow(
    policy: Annotated[
        Path | None, typer.Option(help="Folder of a trained toy; a small one is trained on made-up curves by default.")
    ] = None,
    stores: Annotated[list[Path], typer.Option(help="Clip store of the samples; may be given several times.")] = [],  # noqa: B006
    split: Annotated[str, typer.Option(help="Split whose clips are used.")] = "val",
    samples: Annotated[int, typer.Option(min=2, help="Samples at most.")] = 6,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Hold every solver against a fine one, and its plans against what was driven."""
    import tempfile

    from olt_generator.errors import InputError
    from olt_sft_recipes.benchmarks.flow_measures import measure
    from olt_sft_recipes.benchmarks.quick_toy import made_up_samples, train_quick_toy
    from olt_sft_recipes.toy.policy import load_toy
    from olt_toolkit.runtime.console import print_json
    from olt_toolkit.runtime.threads import use_one_thread

    use_one_thread()
    if policy is None and stores:
        raise InputError(
            "olt bench flow: --stores without --policy; the policy trained here knows made-up curves alone"
        )
    if policy is None:
        with tempfile.TemporaryDirectory() as folder:
            chosen, seen = train_quick_toy(Path(folder))
    else:
        chosen = load_toy(str(policy))
        seen = _load(stores, split, samples, chosen.model.config.contract) if stores else made_up_samples(samples, 1)
    result = {"policy": str(policy or "trained here"), **measure(chosen, seen[:samples])}
    print_json(result) if as_json else print_result(result)


def _load(stores: list[Path], split: str, count: int, contract: Any) -> "list[PolicySample]":
    from olt_generator.errors import InputError
    from olt_sft_recipes.open_loop import spread_keys
    from olt_toolkit import ClipStore

    opened = [ClipStore(store) for store in stores]
    keys = [(store, key) for store in opened for key in spread_keys(store, split, 6)]
    if len(keys) < 2:
        raise InputError(
            f"{', '.join(map(str, stores))}: fewer than two samples of split {split!r}; choose another split"
        )
    chosen = keys[:: max(1, len(keys) // count)][:count]
    return [sample for store, key in chosen for sample in store.load_samples([key], contract=contract)]


def print_result(result: dict[str, Any]) -> None:
    """Print what `flow_measures.measure` gives as tables."""
    from olt_toolkit.runtime.console import print_line, print_table

    print_line(
        f"{result['samples']} samples, {result['plans_per_sample']} plans each; own solver {result['own_solver']}"
    )
    print_line(f"{result['reference']} is {result['reference_doubt_m']:.3g} m from half its steps")
    columns = ("setting", "minADE (m)", f"from {result['reference']} (m)", "processor ms a plan")
    keys = ("setting", "min_ade_m", "distance_from_reference_m", "processor_ms_per_plan")
    for title, rows in (("Solvers of the flow", result["solvers"]), ("Precision", result["precision"])):
        print_table(title, columns, [tuple(row[key] for key in keys) for row in rows])
    print_table("What is seen", ("images", "minADE (m)"), [tuple(row.values()) for row in result["inputs"]])
    columns = ("history", "all finite", "minADE (m)", "furthest coordinate (m)")
    print_table("Histories that strain it", columns, [tuple(row.values()) for row in result["extremes"]])
    print_line(f"machine: {result['machine']['processor']}, {result['machine']['cores']} cores")
