"""The frame of the command line `olt`: it finds the commands of every package and imports none of them itself.

Exit status: 0 done, 1 the input cannot be used, 2 the command line is wrong, 130 interrupted, 143 terminated.
"""

import errno
import os
import signal
import sys
from importlib.metadata import entry_points
from types import FrameType
from typing import Annotated

import typer
from typer.core import TyperGroup

from olt_generator.errors import InputError
from olt_generator.version import __version__
from olt_toolkit.runtime.threads import THREAD_VARIABLES


def build_command() -> TyperGroup:
    """The whole command line, with one subcommand per entry point of the group `olt.commands`.

    An app with one command and no callback becomes that command itself (`olt doctor`), any other a group of commands
    (`olt clip build`).
    """
    app = typer.Typer(
        name="olt",
        help="OpenLongTail: from one front-camera video to policy inputs, SFT mixtures and closed-loop scores.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,  # plain help: drawing its frames would take as long as all the rest
    )
    app.callback()(_root)
    group = typer.main.get_group(app)
    for entry in sorted(entry_points(group="olt.commands"), key=lambda entry: entry.name):
        command = typer.main.get_command(entry.load())
        command.name = entry.name  # the name that the help shows
        group.add_command(command)
    return group


def _show_version(wanted: bool) -> None:
    if wanted:
        sys.stdout.write(f"olt {__version__}\n")
        raise typer.Exit


def _root(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_show_version, is_eager=True)
    ] = False,
) -> None:
    """Options that hold for every command."""


def main(arguments: list[str] | None = None) -> None:
    """Run one command and exit with its status."""
    for variable in THREAD_VARIABLES:  # before any numerical library starts its threads
        os.environ.setdefault(variable, "1")
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _stop)
    sys.exit(run(sys.argv[1:] if arguments is None else arguments))


def run(arguments: list[str]) -> int:
    """Run one command and return its exit status; what users can mend is one line on standard error."""
    try:
        build_command()(arguments, prog_name="olt")
    except InputError as error:
        return _fail(str(error))
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EROFS):
            raise
        return _fail(f"{error.filename or 'output'}: {error.strerror}; free some space or choose another folder")
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else 0
    return 0


def _fail(message: str) -> int:
    sys.stderr.write(f"olt: {message}\n")
    return 1


def _stop(number: int, _frame: FrameType | None) -> None:
    # Raised as an exception, so that half-written files are removed on the way out.
    sys.stderr.write("olt: interrupted; run the same command again to go on\n")
    sys.exit(128 + number)
