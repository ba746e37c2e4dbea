"""How long work reports how far it is."""

from collections.abc import Callable

Progress = Callable[[float], None]
"""Called now and then with the share of the work that is done, from 0 to 1."""


def silent(share: float) -> None:
    """Report nothing."""
