"""How an export works, and what tells one export from another."""

import hashlib
import json
from dataclasses import asdict, dataclass

from olt_datasets.export.contents import Contents
from olt_toolkit.runtime.workers import Engine


@dataclass(frozen=True)
class WorkOptions:
    """How an export works.

    Attributes:
        keep_going: leave out damaged clips and list them, instead of stopping at the first.
        workers: processes.
        engine: where they run.
    """

    keep_going: bool = False
    workers: int = 1
    engine: Engine = Engine.LOCAL


def fingerprint_export(layout: str, contents: Contents, settings: object = None) -> str:
    """BLAKE2b (16 bytes, hexadecimal) of what decides an export."""
    text = json.dumps([layout, asdict(contents), settings], default=str, sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()
