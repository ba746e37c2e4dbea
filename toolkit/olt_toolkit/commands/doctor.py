"""`olt doctor`: is everything here that the work needs?"""

from typing import Annotated

import typer

app = typer.Typer(add_completion=False)


@app.command(help="Check versions, threads and optional parts.")
def doctor(as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False) -> None:
    """Print versions, threads, and which optional parts are present and what each would enable."""
    from olt_toolkit.runtime.console import print_json, print_table
    from olt_toolkit.runtime.environment import describe_machine, describe_optional_parts

    machine, parts = describe_machine(), describe_optional_parts()
    missing = [package for package, version in machine["packages"].items() if version is None]
    if as_json:
        print_json({"machine": machine, "optional_parts": parts, "missing_packages": missing, "ready": not missing})
    else:
        rows = [(key, machine[key]) for key in ("processor", "cores", "memory_gib", "system", "python", "openlongtail")]
        rows += [
            (package, version or "absent: install the project again")
            for package, version in machine["packages"].items()
        ]
        rows += [(variable, value or "not set") for variable, value in machine["threads"].items()]
        print_table("This machine", ("what", "value"), rows)
        print_table(
            "Optional parts",
            ("part", "state", "enables"),
            [(part["name"], _state(part["name"], part["missing"]), part["enables"]) for part in parts],
        )
    if missing:
        raise typer.Exit(1)


def _state(name: str, missing: list[str]) -> str:
    return f'absent ({", ".join(missing)}): pip install "openlongtail[{name}]"' if missing else "present"
