"""How a clip was built, as the clip table keeps it: what changes the clip and is no part of its id.

The text is JSON with sorted keys, so that equal options are equal texts. Keys are the names of options of the command
line where there is one.
"""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from olt_toolkit.clips.backends import Backends
from olt_toolkit.clips.builder import clip_kind
from olt_toolkit.clips.clip import ClipInfo
from olt_toolkit.clips.estimators import Estimators, PoseEstimator
from olt_toolkit.clips.views import BuildOptions
from olt_toolkit.recordings.labels import DEFAULT_SPLIT
from olt_toolkit.recordings.recording import OpenOptions
from olt_toolkit.rigs.names import MotionLabels
from olt_toolkit.runtime.json_files import parse_json

_OPTIONS = {
    "cameras": "--rig (cameras)",
    "frames": "--all-frames (frames)",
    "samples": "--t0 (sample times)",
    "working_width": "the working width",
}

# Frozen, so that it can be a default.
_GEOMETRIC = Backends()


def describe_build(
    options: BuildOptions,
    estimators: Estimators,
    opening: OpenOptions,
    takes_reference: bool,
    backends: Backends = _GEOMETRIC,
) -> str:
    """The JSON text of how a clip is built; what its kind does not use is left out.

    `takes_reference` says whether the motion is the one that the data set measured, whichever option asks for it.
    """
    told: dict[str, Any] = {
        "width": options.width,
        "height": options.height,
        "cameras": list(options.cameras),
        "frames": options.frames,
        "samples": None if options.sample_t0_us is None else _digest(*options.sample_t0_us),
    }
    kind = clip_kind(options)
    if options.labels is MotionLabels.SMOOTHED and (kind == "GT" or takes_reference):
        told["labels"] = options.labels.value
    if kind != "GT":
        poses = PoseEstimator.REFERENCE if takes_reference else estimators.poses
        fov = opening.horizontal_fov
        told |= {
            "working_width": opening.width,
            "fov": None if fov is None else round(float(np.degrees(fov)), 9),
            "camera_height": opening.camera_height,
            "rotate": opening.rotate,
            "mirror": opening.mirror,
            "poses": poses.value,
        }
        if poses is PoseEstimator.MAPANYTHING:
            told["mapanything_weights"] = _list_weights(estimators.mapanything_weights)
    if kind == "Syn":
        told["depth"] = estimators.depth.value
        if estimators.depth_weights is not None:
            told["depth_weights"] = _list_weights(estimators.depth_weights)
        told |= backends.describe()
    return json.dumps(told, sort_keys=True)


def find_differences(found: ClipInfo, options: BuildOptions, wanted: str) -> list[str]:
    """What a clip has that is not as these options and the text of `describe_build` want it: a phrase for each."""
    different = _compare_texts(found.build_options, wanted)
    labels = (
        ("--category", found.category, options.category),
        ("factors", list(found.factors), list(options.factors)),
        ("split", found.split, options.split or DEFAULT_SPLIT),
    )
    different += [_word(name, old, new) for name, old, new in labels if old != new]
    unwanted = set(found.sample_t0_us).difference(options.sample_t0_us or found.sample_t0_us)
    if unwanted:
        different.append(f"{len(unwanted)} sample times that are not asked for now")
    return different


def _compare_texts(stored: str | None, wanted: str) -> list[str]:
    if stored is None:
        return ["options that it does not tell"]
    before, now = parse_json(stored, "build_options of the clip table"), json.loads(wanted)
    if not isinstance(before, dict) or "samples" not in before:
        return ["options of another form"]
    if before["samples"] is None or now["samples"] is None:  # all that there are: `find_differences` sees the times
        before["samples"] = now["samples"] = None
    names = [name for name in sorted(before.keys() | now.keys()) if before.get(name) != now.get(name)]
    return [_word(_OPTIONS.get(name, f"--{name.replace('_', '-')}"), before.get(name), now.get(name)) for name in names]


def _word(name: str, old: object, new: object) -> str:
    return f"{name} {_show(old)} (now {_show(new)})"


def _show(value: object) -> str:
    if value is None:
        return "not given"
    return ", ".join(map(str, value)) or "none" if isinstance(value, list) else str(value)


def _list_weights(folder: Path | None) -> str | None:
    """Names and sizes of the files of a network, which are too large to be read for this."""
    if folder is None:
        return None
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return _digest(*((path.relative_to(folder).as_posix(), path.stat().st_size) for path in files))


def _digest(*values: object) -> str:
    return hashlib.blake2b(repr(values).encode(), digest_size=8).hexdigest()
