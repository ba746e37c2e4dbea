"""Files of an export: written whole, in a folder that can be taken up again."""

import hashlib
import json
import os
import shutil
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from olt_datasets.export.contents import Contents
from olt_generator.errors import InputError
from olt_generator.files import make_folder, write_whole
from olt_toolkit.runtime.json_files import read_json

EXPORT_FILE = "export.json"
_STATE = ".export"


def link_or_copy(source: Path, target: Path) -> bool:
    """Give a file a second name, or copy it to a file system that cannot; whether it was linked."""
    make_folder(target.parent)
    target.unlink(missing_ok=True)
    try:
        os.link(source, target)
        return True
    except OSError:  # another file system, or one without links
        with write_whole(target) as temporary:
            shutil.copyfile(source, temporary)
        return False


def write_export(
    layout: str, contents: Contents, settings: object, out: Path, write: Callable[[Path], dict[str, Any]]
) -> dict[str, Any]:
    """Fill a hidden folder beside `out` that becomes `out` on success and is kept on failure, to be taken up again.

    What another export left there is removed; an export that is complete already is not made again. Besides the
    contents, `settings` decide what it holds; `write` fills a folder and gives the summary.

    The summary is also written to `out/export.json`. InputError: `out` holds something else, or cannot be made.
    """
    text = json.dumps([layout, asdict(contents), settings], default=str, sort_keys=True)
    fingerprint = hashlib.blake2b(text.encode(), digest_size=16).hexdigest()
    if (out / EXPORT_FILE).exists():
        finished = read_json(out / EXPORT_FILE, "summary of an export")
        if isinstance(finished, dict) and finished.get("fingerprint") == fingerprint:
            return finished
    if out.exists():
        raise InputError(f"{out}: exists already; choose another folder, or remove it first")
    folder = out.parent / f".{out.name}.partial"
    marker = folder / _STATE / "fingerprint"
    if folder.exists() and (not marker.exists() or marker.read_text() != fingerprint):
        shutil.rmtree(folder)
    make_folder(marker.parent)
    with write_whole(marker) as temporary:
        temporary.write_text(fingerprint)
    about = {"format": layout, "split": contents.split, "rig": contents.contract.name}
    left_out = [omission.to_dict() for omission in contents.left_out]
    summary = about | write(folder) | {"left_out": left_out, "out": str(out), "fingerprint": fingerprint}
    with write_whole(folder / EXPORT_FILE) as temporary:
        temporary.write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    shutil.rmtree(folder / _STATE)
    folder.rename(out)
    return summary


def finished_part(folder: Path, name: str) -> dict[str, Any] | None:
    """What an earlier run noted when it finished this part; None where it did not."""
    path = folder / _STATE / f"{name}.json"
    return read_json(path, "note of a finished part") if path.exists() else None


def note_finished(folder: Path, name: str, result: dict[str, Any]) -> None:
    """Note that a part is finished, and with what result."""
    with write_whole(folder / _STATE / f"{name}.json") as temporary:
        temporary.write_text(json.dumps(result))
