"""Remembers which steps of a job are done, so that an interrupted job goes on where it stopped."""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from olt_generator.errors import InputError
from olt_generator.files import make_folder, read_bounded, write_whole
from olt_generator.progress import Progress
from olt_toolkit.runtime.json_files import read_json
from olt_toolkit.runtime.version import code_version

_MOST_BYTES = 1 << 20


class JobLog:
    """The results of finished steps, one JSON file each, in a folder that belongs to one job.

    Args:
        folder: where the files lie.
        job: everything that decides the results (settings, seed, checksum of the input); the code joins it.
        show: told the name of the running step and its share that is done.

    Attributes:
        seconds: what each step took when it ran, by name.

    Raises:
        InputError: the folder cannot be written to, or holds the steps of another job or of other code.
    """

    def __init__(self, folder: Path, job: dict[str, Any], show: Callable[[str, float], None]) -> None:
        self.folder, self.show = make_folder(folder), show
        self.seconds: dict[str, float] = {}
        path, text = folder / "job.json", json.dumps({"code": code_version(), **job}, indent=2, sort_keys=True) + "\n"
        if not path.exists():
            with write_whole(path) as temporary:
                temporary.write_text(text)
        elif read_bounded(path, "description of a job", _MOST_BYTES) != text.encode():
            raise InputError(
                f"{folder.parent}: holds a run with other settings, input or version of the code (see {path}); "
                "choose another --out or remove the folder"
            )

    def run(self, step: str, work: Callable[[Progress], Any]) -> Any:
        """The result of a step: read where it is finished, else made by `work` and kept.

        JSON can hold what `work` returns, and its files are whole by then. A fresh result passes through JSON too, so
        that a resumed job sees the same.
        """
        self.show(step, 0.0)
        path = self.folder / f"{step}.json"
        if not path.exists():
            start = time.perf_counter()
            result = work(lambda share: self.show(step, share))
            finished = {"result": result, "seconds": round(time.perf_counter() - start, 3)}
            with write_whole(path) as temporary:
                temporary.write_text(json.dumps(finished, indent=2, allow_nan=False) + "\n")
        finished = read_json(path, "finished step")
        if not isinstance(finished, dict) or not {"result", "seconds"} <= finished.keys():
            raise InputError(f"{path}: holds no result of step {step}; remove the file, and the step is run again")
        self.seconds[step] = finished["seconds"]
        return finished["result"]
