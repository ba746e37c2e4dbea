"""Writes the report page."""

from collections.abc import Sequence
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from olt_generator.files import write_whole
from olt_toolkit.report.blocks import Section


def write_report(path: Path, title: str, summary: str, sections: Sequence[Section]) -> None:
    """Write one HTML file that needs no other file and no network."""
    environment = Environment(
        loader=PackageLoader("olt_toolkit.report", "."), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    page = environment.get_template("page.html.j2").render(title=title, summary=summary, sections=sections)
    with write_whole(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
