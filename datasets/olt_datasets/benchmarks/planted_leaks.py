"""Leaks planted in tables and stores that the commands themselves make, and whether `olt data check` finds them.

Every drive is a video. All of them are in training; a second folder, which is all test, holds copies of some drives,
changed in one way, and videos of other drives, which leak nothing.
"""

import contextlib
import io
import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.evaluation.score_table import wilson_interval
from olt_closed_loop.scenes.procedural import CATEGORIES, generate_scene
from olt_closed_loop.sensors.compression import compress
from olt_closed_loop.sensors.recorder import record_drive
from olt_generator.errors import InputError
from olt_generator.video import read_video, shrink, write_video
from olt_toolkit.runtime.command_line import run

FRAME_RATE = 10.0
SECONDS = 9.0
_WIDTH, _HEIGHT = 320, 180
_BUILT = 1
# Starting another process takes longer than what it would do.
_ONE = ("--workers", 1)

Frames = NDArray[np.uint8]
Plant = Callable[[Path, Path], None]
"""Puts a copy of a video, the first path, at the second."""


@dataclass(frozen=True)
class Planted:
    """A kind of leak: how often it was planted and found, by which rules, and false alarms among other drives.

    `pairs` is the number of pairs of clips of different drives that were compared.
    """

    kind: str
    planted: int
    found: int
    rules: dict[str, int]
    false_alarms: int
    pairs: int

    def to_dict(self) -> dict[str, Any]:
        """The row of the table."""
        return vars(self) | {"found_interval": list(wilson_interval(self.found, self.planted))}


def write_drives(folder: Path, count: int, recordings: Sequence[Path]) -> list[Path]:
    """Videos of so many drives in invented worlds, and of the beginnings of recordings; for each its place."""
    folder.mkdir(parents=True)
    videos = []
    for number in range(count):
        category = CATEGORIES[number % len(CATEGORIES)]
        scene = generate_scene(category, 1000 + number)
        window = (0, round(SECONDS * 1e6))
        videos.append(folder / f"{number:03d}.mp4")
        write_video(videos[-1], record_drive(scene, _WIDTH, _HEIGHT, FRAME_RATE, window_us=window).frames, FRAME_RATE)
    for number, recording in enumerate(recordings, start=count):
        video = read_video(recording, 2 * _WIDTH, SECONDS)
        even = video.frames[:, : video.frames.shape[1] // 2 * 2, : video.frames.shape[2] // 2 * 2]
        videos.append(folder / f"{number:03d}.mp4")
        write_video(videos[-1], even, video.frame_rate)
    return videos


def _changed(change: Callable[[Frames], Frames]) -> Plant:
    """A copy of which the images are changed and coded again."""

    def plant(video: Path, copy: Path) -> None:
        read = read_video(video, 4096, np.inf)
        frames = change(read.frames)
        height, width = (side // 2 * 2 for side in frames.shape[1:3])
        write_video(copy, np.ascontiguousarray(frames[:, :height, :width]), read.frame_rate)

    return plant


def _copy(video: Path, copy: Path) -> None:
    shutil.copy(video, copy)


def _link(video: Path, copy: Path) -> None:
    copy.symlink_to(video)


def _rename(video: Path, copy: Path) -> None:
    (copy.parent / "elsewhere").mkdir(exist_ok=True)
    shutil.copy(video, copy.parent / "elsewhere" / f"renamed {copy.name}")


def _code_again(frames: Frames) -> Frames:
    small = np.stack([shrink(frame, 3 * frames.shape[2] // 4) for frame in frames])
    return compress(small, FRAME_RATE, 300.0)


def _crop(frames: Frames) -> Frames:
    rows, columns = frames.shape[1] // 12, frames.shape[2] // 12
    return frames[:, rows:-rows, columns : -columns // 2]


PLANTS: dict[str, Plant] = {
    "copy": _copy,
    "symlink": _link,
    "renamed": _rename,
    "re-encoded": _changed(_code_again),
    "mirrored": _changed(lambda frames: frames[:, :, ::-1]),
    "shifted by 1.5 s": _changed(lambda frames: frames[round(len(frames) / SECONDS * 1.5) :]),
    "cropped": _changed(_crop),
    "darker": _changed(lambda frames: (frames // 2).astype(np.uint8)),
    "grey": _changed(lambda frames: np.repeat(frames.mean(axis=-1, keepdims=True).astype(np.uint8), 3, axis=-1)),
}
"""Copies of a video that lie in a folder of their own and are indexed there."""


def measure_planted(
    videos: Sequence[Path], others: Sequence[Path], folder: Path, kinds: Sequence[str]
) -> list[Planted]:
    """Plant each kind of leak in its turn and look for it; the others are drives that leak nothing."""
    train = _index(videos[0].parent, folder / "train.parquet", "unseen", "--test", "0")
    found = []
    for kind in kinds:
        place = folder / kind.replace(" ", "_").replace(".", "_")
        place.mkdir()
        if kind in PLANTS:
            copies = [place / f"copy of {video.name}" for video in videos]
            for video, copy in zip(videos, copies, strict=True):
                PLANTS[kind](video, copy)
            for other in others:
                shutil.copy(other, place / f"other {other.name}")
            test = _index(place, place / "test.parquet", "external", "--source", "video")
            found.append(_check(kind, videos, others, [train, test]))
        else:
            found.append(_MADE[kind](videos, others, place, train))
    return found


def _overlap(videos: Sequence[Path], others: Sequence[Path], place: Path, train: Path) -> Planted:
    """The same videos, cut into other windows."""
    test = _index(videos[0].parent, place / "test.parquet", "external", "--source", "video", cut=("--frames", "50"))
    return _check("overlap", videos, (), [train, test])


def _built(kind: str, videos: Sequence[Path], others: Sequence[Path], place: Path, train: Path) -> Planted:
    """A store of synthesized views of the first drive, in training; an index of all drives under test."""
    few = place / "videos"
    few.mkdir()
    chosen = [Path(shutil.copy(video, few / f"day one {video.name}")) for video in videos[:_BUILT]]
    table = _index(few, place / "train.parquet", "unseen", "--test", "0", cut=("--frames", "41", "--stride", "60"))
    store = place / "store"
    _olt("data", "build", table, "--root", few, "--kind", "Syn", "--out", store, *_ONE, "--width", 128, "--height", 72)
    test = _index(videos[0].parent, place / "test.parquet", "external", "--source", "video")
    return _check(kind, chosen, (), [store, test])


def _held_out(videos: Sequence[Path], others: Sequence[Path], place: Path, train: Path) -> Planted:
    """Mirrored copies of held-out scenes in training; the scenes themselves are in no split."""
    for video in videos:
        PLANTS["mirrored"](video, place / f"copy of {video.name}")
    copies = _index(place, place / "train.parquet", "unseen", "--test", "0")
    _olt("data", "index", videos[0].parent, "--out", place / "held_out.parquet", *_ONE, "--seconds", SECONDS / 2)
    scenes = sorted(set(_scenes(place / "held_out.parquet")))
    named = [word for scene in scenes for word in ("--held-out", scene)]
    return _check("held-out scene, mirrored", videos, (), [copies, place / "held_out.parquet"], named)


def _external(videos: Sequence[Path], others: Sequence[Path], place: Path, train: Path) -> Planted:
    return _check("external source", videos, (), [train], ["--external", "video"])


_MADE: dict[str, Callable[[Sequence[Path], Sequence[Path], Path, Path], Planted]] = {
    "overlap": _overlap,
    "twin by another command": lambda *arguments: _built("twin by another command", *arguments),
    "held-out scene, mirrored": _held_out,
    "external source": _external,
}
KINDS = (*PLANTS, *_MADE)


def _index(root: Path, table: Path, rule: str, *options: object, cut: Sequence[object] = ()) -> Path:
    cut = cut or ("--seconds", SECONDS / 2)
    _olt("data", "index", root, "--out", table, *_ONE, *cut)
    _olt("data", "split", table, "--rule", rule, *options, "--out", table)
    return table


def _check(
    kind: str, videos: Sequence[Path], others: Sequence[Path], tables: Sequence[Path], options: Sequence[object] = ()
) -> Planted:
    """Count the planted videos that a leak names, and leaks that name two different drives."""
    report = _olt("data", "check", *tables, "--allow-uncompared", *options, status=None)
    drives = {scene: drive for table in tables for scene, drive in _drives(table).items()}
    found: dict[str, set[str]] = {}
    false_alarms = 0
    for leak in report["leaks"]:
        names = {drives[clip["scene_id"]] for clip in leak["clips"]}
        if len(names) > 1:
            false_alarms += 1
        else:
            found.setdefault(names.pop(), set()).add(leak["rule"])
    planted = {video.stem[-3:] for video in videos}
    rules = {
        rule: sum(rule in found[name] for name in planted & found.keys())
        for rule in sorted(set().union(*found.values()))
    }
    compared = max(each["compared"] for each in report["comparisons"])
    # Of each drive as many clips as of any other.
    different = 1.0 - 1.0 / len(videos) if compared else 0.0
    return Planted(kind, len(planted), len(planted & found.keys()), rules, false_alarms, round(compared * different))


def _drives(table: Path) -> dict[str, str]:
    """The number of the drive of each scene: the last three characters of its video's name."""
    from olt_datasets.tables.clip_frame import scan_clip_tables

    rows = scan_clip_tables([table]).select("scene_id", "name", "recording").unique().collect().rows()
    return {scene: Path(recording).stem[-3:] if recording != "." else name[:3] for scene, name, recording in rows}


def _scenes(table: Path) -> list[str]:
    return list(_drives(table))


def _olt(*arguments: object, status: int | None = 0) -> dict[str, Any]:
    """Run a command with --json and give what it prints; `status` is the exit status it must have, None for any."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        found = run([*map(str, arguments), "--json"])
    if status is not None and found != status:
        raise InputError(f"olt {' '.join(map(str, arguments))}: {out.getvalue().strip()}")
    text = out.getvalue()
    return json.loads(text[text.index("{") :])
