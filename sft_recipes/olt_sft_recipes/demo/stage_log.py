"""Remembers which stages of a job are done, so that an interrupted job goes on where it stopped."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from olt_generator.errors import InputError
from olt_generator.files import make_folder, write_whole
from olt_toolkit import __version__


class StageLog:
    """The results of finished stages, one JSON file each, under a folder that belongs to one job.

    Args:
        folder: where the files lie.
        job: everything that decides the results (settings, seed, checksum of the input).

    Raises:
        InputError: the folder holds the stages of another job.
    """

    def __init__(self, folder: Path, job: dict[str, Any]) -> None:
        self.folder = make_folder(folder)
        self._identify({"version": __version__, **job})

    def run(self, name: str, work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """The result of the named stage: read where it is finished, else made by `work` and kept.

        A fresh result passes through JSON too, so that a resumed job sees exactly what the first one saw.
        """
        path = self.folder / f"{name}.json"
        if not path.exists():
            result = work()
            with write_whole(path) as temporary:
                temporary.write_text(json.dumps(result, indent=2, allow_nan=False) + "\n")
        return json.loads(path.read_text())

    def _identify(self, job: dict[str, Any]) -> None:
        text = json.dumps(job, indent=2, sort_keys=True) + "\n"
        path = self.folder / "job.json"
        if not path.exists():
            with write_whole(path) as temporary:
                temporary.write_text(text)
        elif path.read_text() != text:
            raise InputError(
                f"{self.folder.parent}: holds a run with other settings, input or version (see {path}); "
                "choose another --out or remove the folder"
            )


def checksum(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
