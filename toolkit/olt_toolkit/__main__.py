"""`python -m olt_toolkit` is `olt`."""

from olt_toolkit.cli import main

main()
