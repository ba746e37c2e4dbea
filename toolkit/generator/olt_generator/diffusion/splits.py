"""The paper's splits, enforced: windows of known scenes, scenes never seen, and sources that are never trained on.

Paper, appendix Train/Test Split Protocol: "seen" holds disjoint temporal windows of scenes that are trained on,
"unseen" whole scenes by their id; external recordings have no place in training at all.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from olt_generator.errors import InputError
from olt_generator.seeds import make_generator

Split = Literal["train", "seen", "unseen"]

# Sources of which only front videos exist, or that the paper keeps for evaluation alone: their views are no truth.
EXTERNAL = ("waymo_e2e", "nexar", "video")


@dataclass(frozen=True)
class Window:
    """A stretch of a drive.

    Attributes:
        source, scene: data set, and id of the scene in all data sets.
        first_us, last_us: times of its first and last image since the start of the drive.
    """

    source: str
    scene: str
    first_us: int
    last_us: int


def assign_splits(windows: Sequence[Window], seen: float, unseen: float, seed: int) -> list[Split]:
    """A split for each window.

    A share `unseen` of the scenes, at least one where it is not 0, is kept for evaluation; of the windows of each
    other scene the last ones, a share `seen`, at least one of every second scene that has several where it is not 0.

    Raises:
        InputError: a source is external, windows of a scene overlap, or nothing is left to train on.
    """
    _refuse_external(windows)
    scenes = sorted({window.scene for window in windows})
    order = make_generator("splits", seed).permutation(len(scenes))
    kept = {scenes[index] for index in order[: _count(unseen, len(scenes))]}
    splits: list[Split] = ["unseen" if window.scene in kept else "train" for window in windows]
    for number, scene in enumerate(name for name in scenes if name not in kept):
        own = sorted(
            (i for i, window in enumerate(windows) if window.scene == scene), key=lambda i: windows[i].first_us
        )
        wanted = round(seen * len(own)) or int(seen > 0.0 and number % 2 == 0)
        last = min(wanted, len(own) - 1)
        for index in own[len(own) - last :]:
            splits[index] = "seen"
    check_splits(windows, splits)
    return splits


def check_splits(windows: Sequence[Window], splits: Sequence[Split]) -> None:
    """Refuse a division that lets evaluation be trained on.

    Raises:
        InputError: names the window: of an external source, of a scene that is trained on and "unseen", or sharing
            images with another one of a different split; or nothing is left to train on.
    """
    _refuse_external([window for window, split in zip(windows, splits, strict=True) if split == "train"])
    if "train" not in splits:
        raise InputError("splits: no window is left to train on; give more drives or smaller shares")
    by_scene: dict[str, list[tuple[Window, Split]]] = {}
    for window, split in zip(windows, splits, strict=True):
        by_scene.setdefault(window.scene, []).append((window, split))
    for scene, members in by_scene.items():
        if len({split == "unseen" for _, split in members}) > 1:
            raise InputError(f"splits: scene {scene} is both unseen and trained on; keep all of its windows together")
        members.sort(key=lambda member: member[0].first_us)
        # The image up to which each split has come: a window of another split must begin after it.
        reached: dict[Split, int] = {}
        for window, split in members:
            for other, last_us in reached.items():
                if other != split and window.first_us <= last_us:
                    raise InputError(
                        f"splits: scene {scene}: the window at {window.first_us} us ({split}) shares images with one "
                        f"of {other}; leave a gap"
                    )
            reached[split] = max(reached.get(split, -1), window.last_us)
        if "seen" in reached and "train" not in reached:
            raise InputError(f"splits: scene {scene} is called seen, but nothing of it is trained on")


def _refuse_external(windows: Sequence[Window]) -> None:
    for window in windows:
        if window.source in EXTERNAL:
            raise InputError(f"{window.scene}: {window.source} is for evaluation only and must not be trained on")


def _count(share: float, total: int) -> int:
    return max(1, round(share * total)) if share > 0.0 and total > 1 else 0
