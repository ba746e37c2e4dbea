"""`python -m olt_toolkit` is `olt`."""

from olt_toolkit.runtime.command_line import main

main()
