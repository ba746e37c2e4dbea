"""A PhysicalAI-AV folder as it is published, without a clip table: what is there is looked at, the rest is told.

Such folders are often fetched in part. A clip is looked at where the archive of its motion is there, with those of its
cameras whose archives are.
"""

import uuid
import zipfile
from collections.abc import Collection, Iterator
from functools import cached_property, lru_cache, partial
from pathlib import Path

from olt_generator.errors import InputError
from olt_generator.progress import Progress, silent
from olt_toolkit.clips.chunk_archive import UNREADABLE
from olt_toolkit.clips.clip import ClipInfo, ClipOrigin, ViewProvenance
from olt_toolkit.clips.pai_layout import CALIBRATIONS, CLIP_INDEX, EGOMOTION, FEATURE_TABLE, FEATURES, STORED
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.table import CLIP_TABLE
from olt_toolkit.clips.verification.findings import Finding, not_compared
from olt_toolkit.clips.verification.report import Report
from olt_toolkit.clips.verification.store_checks import check_feature, check_features
from olt_toolkit.clips.verification.verify import STORE_GROUP, verify_clip
from olt_toolkit.rigs.rig import CAMERA_INDEX
from olt_toolkit.runtime.threads import use_one_thread
from olt_toolkit.runtime.workers import Engine, map_parallel

# Checks that hold files against rows of the clip table, which such a folder has not.
_OF_THE_TABLE = frozenset({"duration", "sample times", "shares of pixels", "checksums"})
_TRUE_VIEW = ViewProvenance("observed", "not told", "not told", None, 1.0, 0.0)


class PublicFolder(ClipStore):
    """A store whose clips are told by its clip index and its archives alone."""

    def __init__(self, root: Path) -> None:
        super().__init__(root)
        self._names: dict[Path, frozenset[str] | None] = {}

    @cached_property
    def indexed(self) -> dict[str, ClipInfo]:
        """All clips of the clip index, with the cameras that are here."""
        return {
            clip_id: _describe(clip_id, [camera for camera in CAMERA_INDEX if self._holds(camera, chunk, clip_id)])
            for chunk, clip_ids in self.chunks().items()
            for clip_id in clip_ids
        }

    @cached_property
    def _clips(self) -> dict[str, ClipInfo]:
        return {
            clip_id: self.indexed[clip_id]
            for chunk, clip_ids in self.chunks().items()
            for clip_id in clip_ids
            if self._holds(EGOMOTION, chunk, clip_id)
        }

    def _holds(self, name: str, chunk: int, clip_id: str) -> bool:
        """Whether the archive of that feature and chunk is there and holds all members of the clip."""
        feature = STORED[name]
        members = self._archive_names(feature.chunk_file(self.root, chunk))
        return members is not None and {feature.member(alias, clip_id) for alias in feature.members} <= members

    def _archive_names(self, path: Path) -> frozenset[str] | None:
        """Names in an archive, read once; None where it is missing or damaged."""
        if path not in self._names:
            try:
                with zipfile.ZipFile(path) as archive:
                    self._names[path] = frozenset(archive.namelist())
            except UNREADABLE:
                self._names[path] = None
        return self._names[path]


def verify_public_folder(
    root: Path,
    groups: Collection[str],
    workers: int = 1,
    on_progress: Progress = silent,
    engine: Engine = Engine.LOCAL,
) -> Report:
    """Look at the archives and clips of a folder that has a clip index and no clip table.

    Raises:
        InputError: the clip index cannot be read.
    """
    folder = PublicFolder(root)
    clips = [info.clip_id for info in folder.clips()]
    report = Report().add([_tell_table(root), *_tell_absent(root, len(clips), len(folder.indexed))])
    if STORE_GROUP in groups:
        report.add(_check_archives(folder))
    look = partial(_look, root, tuple(groups), uuid.uuid4().hex)
    for each in map_parallel(look, clips, workers, on_progress, engine):
        report.merge(each)
    return report


def _tell_table(root: Path) -> Finding:
    why = (
        f"there is no {CLIP_TABLE}: checksums, durations, sample times and origins of pixels are not told, so files "
        "are held against each other alone"
    )
    return not_compared("clip table", str(root), why)


def _tell_absent(root: Path, present: int, indexed: int) -> list[Finding]:
    if present == indexed:
        return []
    why = f"{indexed - present} of {indexed} clips of the clip index have no motion here; fetch their chunks first"
    return [not_compared("clips of the index", str(root / CLIP_INDEX), why)]


def _check_archives(folder: PublicFolder) -> Iterator[Finding]:
    if (folder.root / FEATURE_TABLE).is_file():
        yield check_features(folder.root)
    for feature in FEATURES.values():
        here, absent = {}, 0
        for chunk, clip_ids in folder.chunks().items():
            if feature.chunk_file(folder.root, chunk).exists():
                here[chunk] = clip_ids
            else:
                absent += 1
        yield from check_feature(folder.root, feature, folder.indexed, here)
        if absent:
            why = f"{absent} of {absent + len(here)} chunks are not here"
            yield not_compared("chunk file", f"{folder.root / feature.directory / feature.name}", why)


def _look(root: Path, groups: tuple[str, ...], run: str, clip_id: str) -> Report:
    use_one_thread()
    folder = _open(root, run)
    report = Report(clips=1)
    missing = [name for name in CALIBRATIONS if not _has_rows(folder, clip_id, name)]
    if not folder.info(clip_id).views:
        missing.append("any camera")
    looked = [group for group in groups if not missing or group == "motion"]
    if missing and len(looked) < len(groups):
        why = f"{', '.join(missing)} is not here: only the motion can be looked at"
        report.add([not_compared("cameras and calibration", f"{root}: clip {clip_id}", why)])
    found = verify_clip(folder, clip_id, looked)
    return report.add(each for each in found if each.check not in _OF_THE_TABLE)


def _has_rows(folder: PublicFolder, clip_id: str, name: str) -> bool:
    try:
        return not folder.read_rows(clip_id, name).empty
    except InputError:
        return False


def _describe(clip_id: str, cameras: list[str]) -> ClipInfo:
    """A row of a clip table that tells nothing but what the folder tells."""
    return ClipInfo(
        clip_id=clip_id,
        name=clip_id,
        scene_id=clip_id,
        source="physicalai_av",
        origin=ClipOrigin(clip_id, 0, 0),
        kind="GT",
        category="nominal",
        factors=(),
        split=None,
        duration_us=0,
        sample_t0_us=(),
        no_sample_reason="not told",
        created_with="not told",
        checksum="",
        fingerprint=None,
        views=dict.fromkeys(cameras, _TRUE_VIEW),
    )


@lru_cache(maxsize=8)
def _open(root: Path, run: str) -> PublicFolder:
    """The folder as this process opened it in this run: tables are read once, and not for every clip."""
    return PublicFolder(root)
