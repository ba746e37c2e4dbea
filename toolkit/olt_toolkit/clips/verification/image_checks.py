"""Checks that look at what the images of a clip show."""

from collections.abc import Callable, Iterable

from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.verification.findings import Finding

IMAGE_CHECKS: tuple[Callable[[ClipStore, str], Iterable[Finding]], ...] = ()
