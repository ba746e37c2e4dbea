"""Which files of a folder are front videos: judged by the first bytes and by the names that dash cameras give.

Dash cameras with several lenses write a file for each, and tell them by a mark in the name. `docs/formats/video.md`
lists the rules with examples.
"""

import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from olt_generator.files import walk_files
from olt_generator.omissions import Omission

SUFFIXES = frozenset({".mp4", ".mov", ".m4v", ".mkv", ".avi", ".webm", ".ts", ".mpg", ".mpeg"})
DEPTH = 4
"""Folders below one, within which a video must lie for it to be taken for a folder of videos."""

# First bytes of what lies beside videos under their names.
_NO_VIDEO = {
    b"\x00\x05\x16\x07": "AppleDouble files (metadata of macOS)",
    b"\x00\x05\x16\x00": "AppleSingle files (metadata of macOS)",
    b"\xff\xd8\xff": "pictures",
    b"\x89PNG": "pictures",
    b"GIF8": "pictures",
}
_FOLDERS_OF_SYSTEMS = frozenset({"__macosx", "@eadir", "$recycle.bin", "system volume information"})
_TEXT = frozenset(b"\t\n\r\f") | frozenset(range(0x20, 0x7F))


@dataclass(frozen=True)
class NameRule:
    """How a kind of dash camera marks its lenses in file names.

    Attributes:
        cameras: whose rule it is.
        pattern: matches the name without suffix; its group `mark` tells the lens, and what is before and after it the
            moment.
        front: marks of lenses that look ahead.
        elsewhere: where the other marked lenses look.
    """

    cameras: str
    pattern: re.Pattern[str]
    front: frozenset[str]
    elsewhere: dict[str, str]


_BACK, _INSIDE = "back", "into the cabin"
_FRI = {"r": _BACK, "i": _INSIDE}


def _rule(cameras: str, pattern: str, front: str, elsewhere: dict[str, str]) -> NameRule:
    marks = "|".join(sorted([*front.split(), *elsewhere], key=len, reverse=True))
    compiled = re.compile(pattern.replace("MARK", f"(?P<mark>{marks})"), re.IGNORECASE)
    return NameRule(cameras, compiled, frozenset(front.split()), elsewhere)


NAME_RULES = (
    _rule(
        "Tesla",
        r"\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d-MARK",
        "front",
        {
            "back": _BACK,
            "left_repeater": "back on the left",
            "right_repeater": "back on the right",
            "left_pillar": "to the left",
            "right_pillar": "to the right",
        },
    ),
    _rule("BlackVue", r"\d{8}_\d{6}_[A-Z]MARK[LS]?", "f", _FRI | {"o": "elsewhere"}),
    _rule("Nextbase", r"\d{6}_\d{6}_\d{3}_MARK[HL]", "f", {"r": _BACK, "c": _INSIDE, "i": _INSIDE}),
    _rule("Vantrue", r"\d{8}_\d{6}_\d{3,5}_[A-Z]_MARK", "a", {"b": "back or into the cabin", "c": _BACK, "d": "aside"}),
    _rule("70mai", r"[A-Z]{2}\d{8}-\d{6}-\d{6}MARK", "f", {"b": _BACK, "r": _BACK, "i": _INSIDE}),
    _rule("Thinkware", r"[A-Z]{3,}_\d{4}_\d\d_\d\d_\d\d_\d\d_\d\d_MARK", "f", _FRI),
    _rule("Viofo", r"(\d{4}_?\d{4}_?\d{6}|\d{14})_\d{3,6}[A-Z]?MARK", "f t", _FRI),
    _rule(
        "words",
        r"(?:.*[-_. ])?MARK(?:[-_. ]?(?:cam|camera|view))?(?:[-_. ]?\d+)?",
        "front forward",
        {"rear": _BACK, "backward": _BACK, "rearward": _BACK, "cabin": _INSIDE, "interior": _INSIDE, "inside": _INSIDE},
    ),
    # The way back is driven forwards, so the word alone says nothing at the end of a longer name.
    _rule("words", r"MARK(?:[-_. ]?(?:cam|camera|view))?(?:[-_. ]?\d+)?", "", {"back": _BACK}),
    _rule("words", r"(?:.*[-_. ])?MARK(?:cam|camera|view)", "", {"back": _BACK}),
)
# Marks that say something only beside a file that differs in the mark alone and is marked as the front one.
_BESIDE_FRONT = _rule(
    "marks beside a front video",
    r"(?:.*[-_. ])?MARK",
    "f front fwd forward",
    {
        "r": _BACK,
        "b": _BACK,
        "back": _BACK,
        "left": "to the left",
        "right": "to the right",
        "side": "aside",
        "l": "to the left",
        "i": _INSIDE,
        "in": _INSIDE,
    },
)


@dataclass(frozen=True)
class Elsewhere:
    """By a name rule, a video is not of a front camera."""

    looks: str
    rule: NameRule

    @property
    def why(self) -> str:
        """A clause for people."""
        return f"the camera looks {self.looks}, by its file name ({self.rule.cameras})"


def has_video_suffix(path: Path) -> bool:
    """Whether a path is a file that is called a video."""
    return path.suffix.lower() in SUFFIXES and path.is_file()


def why_no_video(path: Path) -> str | None:
    """What a file that is called a video is instead, plural, judged by its name and first bytes; None for a video."""
    if path.name.startswith("."):
        return "hidden files"
    try:
        with path.open("rb") as file:
            start = file.read(512)
    except OSError:
        return "files that may not be read"
    if not start:
        return "empty files"
    if all(byte in _TEXT for byte in start):
        return "texts"
    return next((what for magic, what in _NO_VIDEO.items() if start.startswith(magic)), None)


def holds_video(folder: Path) -> bool:
    """Whether a video lies in a folder or up to `DEPTH` folders below it; links to folders are not followed."""
    for parent, below, names in os.walk(folder):
        here = Path(parent)
        if any(has_video_suffix(here / name) and why_no_video(here / name) is None for name in names):
            return True
        is_deep = len(here.relative_to(folder).parts) == DEPTH
        below[:] = [] if is_deep else sorted(name for name in below if not _is_of_system(name))
    return False


def leave_out_links(folder: Path) -> tuple[Omission, ...]:
    """The links to folders in a folder and below, which are not followed: they may lead round, or to a video again."""
    folders = [Path(parent) / name for parent, below, _ in os.walk(folder) for name in below]
    links = sum(each.is_symlink() for each in folders)
    why = "they are links, which are not followed; give what they lead to"
    return (Omission("folders", why, links, len(folders)),) if links else ()


def _is_of_system(name: str) -> bool:
    return name.startswith(".") or name.lower() in _FOLDERS_OF_SYSTEMS


def find_video_files(folder: Path) -> tuple[list[Path], dict[Path, str]]:
    """The videos in a folder and below, sorted, and what else is called a video and why it is none."""
    videos, others = [], {}
    for path in filter(has_video_suffix, walk_files(folder)):
        parents = path.relative_to(folder).parts[:-1]
        if any(map(_is_of_system, parents)):
            others[path] = "files in folders of the system"
        elif (what := why_no_video(path)) is not None:
            others[path] = what
        else:
            videos.append(path)
    return videos, others


def looks_elsewhere(path: Path, beside: Iterable[Path] = ()) -> Elsewhere | None:
    """Where a video's camera looks if its name says that this is not ahead; None if it does not say so.

    Some marks, such as `_R`, say so only where `beside` has the front video of the same moment.
    """
    for rule in NAME_RULES:
        match = rule.pattern.fullmatch(path.stem)
        if match is not None:
            mark = match["mark"].lower()
            return None if mark in rule.front else Elsewhere(rule.elsewhere[mark], rule)
    match = _BESIDE_FRONT.pattern.fullmatch(path.stem)
    if match is None or match["mark"].lower() in _BESIDE_FRONT.front:
        return None
    moment = _moment(_BESIDE_FRONT, path)
    if not any(_is_front(_BESIDE_FRONT, other) and _moment(_BESIDE_FRONT, other) == moment for other in beside):
        return None
    return Elsewhere(_BESIDE_FRONT.elsewhere[match["mark"].lower()], _BESIDE_FRONT)


def leave_out_elsewhere(videos: list[Path]) -> tuple[list[Path], dict[Path, str]]:
    """Front videos, and those to pass over: of cameras that look elsewhere, where the same kind has a front camera.

    Videos of which only such cameras are there stay, so that whoever opens one is told.
    """
    fronts, others = [], {}
    for path in videos:
        elsewhere = looks_elsewhere(path, (other for other in videos if other.parent == path.parent))
        if elsewhere is not None and any(_is_front(elsewhere.rule, other) for other in videos):
            others[path] = elsewhere.why
        else:
            fronts.append(path)
    return fronts, others


def _is_front(rule: NameRule, path: Path) -> bool:
    match = rule.pattern.fullmatch(path.stem)
    return match is not None and match["mark"].lower() in rule.front


def _moment(rule: NameRule, path: Path) -> tuple[str, str] | None:
    """The name but for its mark."""
    match = rule.pattern.fullmatch(path.stem)
    return None if match is None else (path.stem[: match.start("mark")], path.stem[match.end("mark") :])
