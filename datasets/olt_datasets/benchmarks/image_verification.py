"""`olt bench verify_images`: how many faults a look at the images finds, and what it says of good clips, and when."""

from typing import Annotated

import typer

app = typer.Typer(add_completion=False)


@app.command()
def verify_images(
    stores: Annotated[
        int, typer.Option(min=1, help="Stores of two rendered clips; each fault goes into each clip.")
    ] = 11,
    seed: Annotated[int, typer.Option(help="Seed of the clips; rules were chosen on seeds 0 to 3.")] = 4,
    faults: Annotated[str | None, typer.Option(help="Only faults whose name holds this text.")] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; one for each processor by default.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Plant faults that only images show into rendered clips; count what is found, and what is said of good clips."""
    from olt_datasets.benchmarks.fault_rates import count_faults
    from olt_datasets.benchmarks.image_faults import IMAGE_FAULTS
    from olt_datasets.benchmarks.rendered_rates import measure_rendered_store
    from olt_datasets.benchmarks.verification import print_result
    from olt_toolkit.runtime.console import print_json

    result = count_faults(
        "verify_images", measure_rendered_store, IMAGE_FAULTS, ("images",), stores, seed, faults, workers
    )
    print_json(result) if as_json else print_result(result)
