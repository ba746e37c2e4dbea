"""What the pages show: their fenced blocks in order, and the commands that they name."""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

import typer
from typer.core import TyperCommand, TyperGroup

from olt_toolkit.runtime.command_line import build_command

ROOT = Path(__file__).resolve().parents[2]
SOURCE_FOLDERS = ("toolkit", "closed_loop", "datasets", "sft_recipes")
READMES = [path for folder in (".", *SOURCE_FOLDERS) for path in sorted((ROOT / folder).glob("**/README.md"))]
PAGES = sorted(
    {path for path in READMES if not {".venv", "build"} & {*path.parts}}
    | {*ROOT.glob("*.md")}
    | {*(ROOT / "docs").rglob("*.md")}
)

_OPENING = re.compile(r"```(?P<language>\w*)(?: title=\"(?P<title>[^\"]+)\")?$")
_MARK = re.compile(r"<!-- (?P<mark>slow|not run: \S.*) -->$")
_INLINE = re.compile(r"`(olt [^`{}]+)`")


@dataclass(frozen=True)
class Fence:
    """A fenced block of a page.

    Attributes:
        language: the word after the backticks; "" where there is none.
        title: the file that the block is the content of, or None.
        body: its lines.
        mark: "slow", "not run: REASON", or None: the HTML comment in the line above.
    """

    language: str
    title: str | None
    body: str
    mark: str | None


def read_fences(page: Path) -> list[Fence]:
    """The fenced blocks of a page in order."""
    fences: list[Fence] = []
    opened: re.Match[str] | None = None
    body: list[str] = []
    before = ""
    for line in page.read_text(encoding="utf-8").splitlines():
        if opened is not None and line == "```":
            mark = _MARK.match(before)
            fences.append(
                Fence(opened["language"], opened["title"], "\n".join(body) + "\n", mark["mark"] if mark else None)
            )
            opened, before = None, ""
        elif opened is not None:
            body.append(line)
        elif line.startswith("```"):
            opened, body = _OPENING.match(line), []
            assert opened, f"{page.name}: {line}: give the block a language, and no more than a title"
        elif line:
            before = line
    assert opened is None, f"{page.name}: a block is not closed"
    return fences


def split_commands(body: str) -> list[list[str]]:
    """The commands of a shell block as words, comments left out."""
    lines = body.replace("\\\n", " ").splitlines()
    return [words for words in (shlex.split(line, comments=True) for line in lines) if words]


def commands_shown(page: Path) -> list[str]:
    """Every `olt ...` of a page: in blocks and in inline code."""
    text = page.read_text(encoding="utf-8")
    in_blocks = [
        line.partition("#")[0].strip()
        for fence in read_fences(page)
        for line in fence.body.replace("\\\n", " ").splitlines()
        if line.startswith("olt ")
    ]
    return [*in_blocks, *commands_named(text)]


def commands_named(text: str) -> list[str]:
    """Every `olt ...` in backticks, whatever stands around it; line breaks within are spaces."""
    outside = re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE)
    return [re.sub(r"\s+", " ", found) for found in _INLINE.findall(outside)]


def find_fault(shown: str) -> str | None:
    """What is wrong with a command as it is shown: `olt mix compose|show RECIPE [--seed N]`; None if nothing is.

    Words in capitals stand for something; pipes and commas part alternatives; brackets are left out.
    """
    words = re.sub(r"\s*\\?\|\s*", "|", shown).translate(str.maketrans("", "", "[]")).split()[1:]
    commands: list[TyperCommand | TyperGroup] = [build_command()]
    place = "olt"
    for word in words:
        if word.startswith("-"):
            known = {option for command in commands for part in command.params for option in part.opts}
            known |= {option for command in commands for part in command.params for option in part.secondary_opts}
            if word.partition("=")[0] not in {*known, "--help"}:
                return f"{place} has no option {word}"
        elif all(isinstance(command, TyperGroup) for command in commands) and not word.isupper():
            names = [name for name in word.split("|") if not name.isupper()]
            groups = [command for command in commands if isinstance(command, TyperGroup)]
            context = typer.Context(groups[0])
            if not all(name in group.list_commands(context) for group in groups for name in names):
                return f"{place} has no command {word}"
            commands = [group.get_command(context, name) for group in groups for name in names]
            place = f"{place} {word}"
    return None
