"""`olt bench verify_images`: how many faults a look at the images finds, and what it says of good clips, and when."""

from typing import Annotated

import typer

app = typer.Typer(add_completion=False)


@app.command()
def verify_images(
    stores: Annotated[
        int, typer.Option(min=1, help="Stores of two rendered clips; each fault goes into each clip.")
    ] = 11,
    seed: Annotated[int, typer.Option(help="Seed of the clips; limits were chosen on seed 0.")] = 1,
    faults: Annotated[str | None, typer.Option(help="Only faults whose name holds this text.")] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; one for each processor by default.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Plant faults that only images show into rendered clips; count what is found, and what is said of good clips."""
    from functools import partial

    from olt_datasets.benchmarks.fault_rates import summarize
    from olt_datasets.benchmarks.image_faults import IMAGE_FAULTS
    from olt_datasets.benchmarks.rendered_rates import measure_rendered_store
    from olt_datasets.benchmarks.verification import print_result
    from olt_generator.errors import InputError
    from olt_toolkit.runtime.console import print_json, show_progress
    from olt_toolkit.runtime.environment import describe_machine
    from olt_toolkit.runtime.workers import default_workers, map_parallel

    names = tuple(fault.name for fault in IMAGE_FAULTS if faults is None or faults in fault.name)
    if not names:
        raise InputError(f"--faults {faults!r}: no fault is called so")
    with show_progress("bench verify_images", stores) as (on_progress, _):
        measured = map_parallel(
            partial(measure_rendered_store, seed=seed, faults=names),
            list(range(stores)),
            workers or default_workers(),
            on_progress,
        )
    result = {
        "benchmark": "verify_images",
        "stores": stores,
        "seed": seed,
        **summarize([each for of_store in measured for each in of_store], IMAGE_FAULTS, ("images",)),
        "machine": describe_machine(),
    }
    print_json(result) if as_json else print_result(result)
