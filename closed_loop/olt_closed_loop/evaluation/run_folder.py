"""The folder of a run: finished rollouts are in it as soon as they end, and are found again however the run ended.

| file | what |
| --- | --- |
| `run.json` | what is run: options, scenes, policy; a run with other ones is refused by name |
| `parts/000012.parquet` | rollout 12, until the run is complete (`rollouts.rollout_tables`) |
| `rollouts.parquet` | all rollouts, by scene and seed; equal runs give equal bytes |
| `scores.json` | the table and the score of each rollout; equal runs give equal bytes |
| `timings.json` | the machine, and seconds by kind of work for each rollout; those of an earlier run are null |

A file appears whole or not at all, so a run that is killed at any moment loses what was under way and nothing else.
"""

import dataclasses
import hashlib
import json
import pickle
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from olt_closed_loop.evaluation.score_table import summarize_scores
from olt_closed_loop.rollouts.rollout import Rollout
from olt_closed_loop.rollouts.rollout_tables import load_rollouts, save_rollouts
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.scoring.definitions import RolloutScore
from olt_closed_loop.simulation.policy_hosts import PolicySource
from olt_closed_loop.simulation.settings import SimulationSettings
from olt_generator.errors import InputError
from olt_generator.files import make_folder, walk_files, write_whole
from olt_generator.version import __version__
from olt_toolkit.runtime.environment import describe_machine
from olt_toolkit.runtime.folder_lock import alone_in
from olt_toolkit.runtime.json_files import read_json

RUN_VERSION = 1
ROLLOUTS, SCORES, TIMINGS, RUN = "rollouts.parquet", "scores.json", "timings.json", "run.json"

# What settings are called on the command line.
_OPTIONS = {
    "duration_us": "--duration",
    "planner_delay_us": "--planner-delay",
    "plan_interval_us": "--plan-interval",
    "traffic": "--traffic",
    "vehicle": "--vehicle",
    "integrator": "--integrator",
    "control.method": "--controller",
    "control.smoothing_window": "--smoothing-window",
    "control.smoothing_delay": "--smoothing-delay",
    "skip": "--skip",
    "conditions.light": "--light",
    "conditions.rain": "--weather rain",
    "conditions.fog": "--weather fog",
    "camera_faults": "--camera-fault",
    "limits.call_seconds": "--policy-timeout",
    "limits.memory_bytes": "--policy-memory",
}


class RunFolder:
    """An open folder of a run; nobody else writes into it meanwhile."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.parts = path / "parts"

    def kept(self) -> dict[int, Rollout]:
        """The finished rollouts by number. Scenes that were refused are not among them: they are tried again.

        Raises:
            InputError: a file of rollouts is damaged.
        """
        found = self.finished().items()
        return {index: rollout for index, rollout in found if rollout.failure_kind != "scene_refused"}

    def finished(self) -> dict[int, Rollout]:
        """All finished rollouts by number.

        Raises:
            InputError: a file of rollouts is damaged.
        """
        whole = self._path / ROLLOUTS
        found = dict(enumerate(load_rollouts(whole))) if whole.exists() else {}
        for part in sorted(self.parts.glob("*.parquet")):
            (found[int(part.stem)],) = load_rollouts(part)
        return found

    def complete(self, results: Sequence[tuple[Rollout, RolloutScore]]) -> None:
        """Write the results in place of the parts."""
        save_results(self._path, results)
        shutil.rmtree(self.parts)


def save_part(parts: Path, index: int, rollout: Rollout) -> None:
    """Keep a finished rollout."""
    save_rollouts(parts / f"{index:06d}.parquet", [rollout])


def save_results(folder: Path, results: Sequence[tuple[Rollout, RolloutScore]]) -> None:
    """Write rollouts.parquet, scores.json and timings.json into a folder, each whole or not at all."""
    rollouts, scores = [rollout for rollout, _ in results], [score for _, score in results]
    _write_json(folder / TIMINGS, {**describe_machine(), "seconds": [rollout.timings or None for rollout in rollouts]})
    _write_json(
        folder / SCORES,
        {"table": summarize_scores(scores).to_dict(), "scores": [score.to_dict() for score in scores]},
    )
    save_rollouts(folder / ROLLOUTS, rollouts, timings=False)


@contextmanager
def open_run(path: Path, options: dict[str, Any]) -> Iterator[RunFolder]:
    """Begin a run in a folder, or go on with the one that is there.

    Raises:
        InputError: the folder holds a run with other options, or results of something else, or another process is at
            work in it, or it cannot be written.
    """
    with alone_in(path, "another process runs in this folder; wait until it is done"):
        for abandoned in [*path.glob(".*.json"), *path.glob(".*.parquet"), *path.glob("parts/.*.parquet")]:
            abandoned.unlink()  # half-written when a run was killed
        finished = [path / ROLLOUTS, path / SCORES, path / "rollouts.json", *path.glob("parts/*.parquet")]
        if not any(file.exists() for file in finished):
            _write_json(path / RUN, {"version": RUN_VERSION, "options": options})
        elif (path / RUN).exists():
            _compare(path, options)
        else:
            raise InputError(f"{path}: holds results of something else (there is no {RUN}); give another --out")
        make_folder(path / "parts")
        yield RunFolder(path.resolve())


@dataclasses.dataclass(frozen=True)
class KeptRollout:
    """A finished rollout in the folder of a run.

    Attributes:
        index: its number.
        rollout: what was driven.
        score: as `RolloutScore.to_dict` has it; None while the run is not complete.
        scene: what was driven, as `describe_scene` has it.
        definition: how the run is scored.
    """

    index: int
    rollout: Rollout
    score: dict[str, Any] | None
    scene: dict[str, str | None]
    definition: str


def read_finished(path: Path) -> list[KeptRollout]:
    """The finished rollouts of a run, in order, whether or not it is complete or at work.

    Raises:
        InputError: there is no run in the folder, or a file is damaged.
    """
    options = read_run(path)
    scores = read_json(path / SCORES, "scores")["scores"] if (path / SCORES).exists() else None
    found = RunFolder(path).finished()
    return [
        KeptRollout(
            index,
            found[index],
            scores[index] if scores else None,
            options["scenes"][index // options["--rollouts"]],
            options["--definition"],
        )
        for index in sorted(found)
    ]


def read_run(path: Path) -> dict[str, Any]:
    """The options of the run in a folder.

    Raises:
        InputError: there is none, or it is one of another version.
    """
    values = read_json(path / RUN, "run")
    if not isinstance(values, dict) or not isinstance(values.get("options"), dict):
        raise InputError(f"{path / RUN}: not the description of a run; give a folder of `olt closed-loop run --out`")
    if values.get("version") != RUN_VERSION:
        raise InputError(
            f"{path / RUN}: a run of version {values.get('version')}, not {RUN_VERSION}; give another --out"
        )
    return values["options"]


def describe_run(
    sources: Sequence[str | Scene],
    policy: PolicySource,
    rollouts: int,
    seed: int,
    settings: SimulationSettings,
    definition: str,
) -> dict[str, Any]:
    """All that the results depend on, by the name of the option; scenes, and policies in files, with a hash."""
    flat = {_OPTIONS.get(name, name): value for name, value in _flatten(settings) if name != "limits.isolate"}
    return {
        "scenes": [describe_scene(source) for source in sources],
        "--policy": _describe_policy(policy),
        "--rollouts": rollouts,
        "--seed": seed,
        "--definition": definition,
        **flat,
        "version of the toolkit": __version__,
    }


def _compare(path: Path, options: dict[str, Any]) -> None:
    before = read_run(path)
    now = json.loads(json.dumps(options))
    other = [
        f"{name} was {_short(before.get(name))} and is {_short(now.get(name))}"
        for name in {**before, **now}
        if before.get(name) != now.get(name)
    ]
    if other:
        raise InputError(f"{path}: holds a run with other options ({'; '.join(other)}); give the same or another --out")


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 200 else f"{text[:200]}..."


def _flatten(record: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        if dataclasses.is_dataclass(value):
            yield from _flatten(value, f"{prefix}{field.name}.")
        else:
            faults = field.name == "camera_faults"
            yield f"{prefix}{field.name}", [fault.words for fault in value] if faults else value


def describe_scene(source: str | Scene) -> dict[str, str | None]:
    """A scene by its source and a hash of what is in it; one in memory by its name and a hash."""
    if isinstance(source, str):
        return {"source": source, "hash": _hash_path(Path(source))}
    hashed = hashlib.blake2b(digest_size=16)
    _hash_value(source, hashed)
    return {"source": None, "name": source.name, "hash": hashed.hexdigest()}


def _describe_policy(policy: PolicySource) -> dict[str, str | None]:
    if isinstance(policy, str):
        _, _, argument = policy.partition(":")
        return {"name": policy, "hash": _hash_path(Path(argument)) if argument else None}
    kind = policy if isinstance(policy, type) else type(policy)
    try:
        state = hashlib.blake2b(pickle.dumps(policy), digest_size=16).hexdigest()
    except Exception:  # objects say in many ways that they cannot be pickled
        state = None
    return {"name": f"{kind.__module__}.{getattr(policy, '__qualname__', kind.__qualname__)}", "hash": state}


def _hash_path(path: Path) -> str | None:
    """A hash of a file and those beside it that belong to it (`NAME.looks.usda`), or of a folder; None without one."""
    if not path.exists():
        return None
    files = walk_files(path) if path.is_dir() else sorted(path.parent.glob(f"{path.name.split('.')[0]}.*"))
    hashed = hashlib.blake2b(digest_size=16)
    for file in (file for file in files if file.is_file()):
        with file.open("rb") as content:
            hashed.update(f"{file.name}\n".encode() + hashlib.file_digest(content, "blake2b").digest())
    return hashed.hexdigest()


def _hash_value(value: Any, hashed: "hashlib.blake2b") -> None:
    """Take in a value of plain types, arrays and dataclasses, with what each is."""
    hashed.update(type(value).__name__.encode())
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        for field in dataclasses.fields(value):
            _hash_value(getattr(value, field.name), hashed)
    elif isinstance(value, np.ndarray):
        hashed.update(f"{value.shape}{value.dtype}".encode() + value.tobytes())
    elif isinstance(value, list | tuple):
        hashed.update(str(len(value)).encode())
        for item in value:
            _hash_value(item, hashed)
    elif isinstance(value, dict):
        _hash_value(list(value.items()), hashed)
    else:
        hashed.update(repr(value).encode())


def _write_json(path: Path, values: dict[str, Any]) -> None:
    with write_whole(path) as temporary:
        temporary.write_text(json.dumps(values, indent=2, allow_nan=False) + "\n")
