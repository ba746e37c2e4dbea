"""Whether the files of a clip are those that were built, and all of them, and no more."""

from collections.abc import Iterator

from olt_generator.errors import InputError
from olt_toolkit.clips.checksums import checksum_bytes, checksum_clip, checksum_rows, member_key
from olt_toolkit.clips.clip import ClipInfo
from olt_toolkit.clips.files import has_feature
from olt_toolkit.clips.pai_layout import CALIBRATIONS, CAMERA_INTRINSICS, SENSOR_EXTRINSICS, STORED
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.verification.findings import Finding, Verdict, judge, not_compared, state

SHARE_ERROR = 1e-9
"""Of the shares of pixels, which are sums of fractions."""


def check_files(store: ClipStore, clip_id: str) -> Iterator[Finding]:
    """Read every file of a clip, by the checksums of zip and of the clip table; hold masks and tables against it."""
    info, where = store.info(clip_id), f"{store.root}: clip {clip_id}"
    yield from check_checksums(store, info, where)
    for camera, view in info.views.items():
        place = f"{where}: {camera}"
        yield _check_shares(info, camera, place)
        if view.is_seen_whole:
            continue
        try:
            store.read_origin_runs(clip_id, camera)
            yield state("mask", place, True, "has the times, size and shares of its view")
        except InputError as error:
            yield state("mask", place, False, str(error))
    for table in (CAMERA_INTRINSICS, SENSOR_EXTRINSICS):
        named = {str(key[1]) for key in store.read_rows(clip_id, table).index}
        missing = ", ".join(sorted(info.views.keys() - named))
        detail = f"no row for {missing}; build the clip again" if missing else "a row for each camera"
        yield state("calibration rows", f"{where}: {table}", not missing, detail)


def check_checksums(store: ClipStore, info: ClipInfo, where: str) -> Iterator[Finding]:
    """Compare the checksum of each file with that in the clip table; a file of another clip is told as such."""
    known = info.file_checksums
    found = {}
    for feature in STORED.values():
        if not has_feature(info, feature):
            continue
        for alias in feature.members:
            name = member_key(feature.name, alias)
            try:
                found[name] = checksum_bytes(store.read_member(info.clip_id, feature.name, alias))
            except InputError as error:
                yield state("readable files", where, False, str(error))
    for name in CALIBRATIONS:
        try:
            found[name] = checksum_rows(store.read_rows(info.clip_id, name))
        except (InputError, ValueError) as error:
            yield state("readable files", where, False, str(error))
    yield state("readable files", where, len(found) > 0, f"{len(found)} files, by the checksums of their archives")
    if known is None:
        yield not_compared("checksums", where, "the table of this folder tells none")
        return
    detail = "of the checksums of its files is the clip's own; the row of the clip table was changed"
    yield state("checksum of the clip", where, checksum_clip(known) == info.checksum, detail)
    for name in sorted(known.keys() | found.keys()):
        yield _compare(store, info, name, found.get(name), f"{where}: {name}")


def _compare(store: ClipStore, info: ClipInfo, name: str, found: str | None, where: str) -> Finding:
    known = (info.file_checksums or {}).get(name)
    if found == known:
        return Finding("checksums", where, Verdict.PASSED, "as it was built")
    if known is None or found is None:
        what = "is not in the clip table" if known is None else "is missing or cannot be read"
        return Finding("checksums", where, Verdict.FAILED, f"the file {what}; build the clip again")
    owner = next((each for each in store.clips() if found in (each.file_checksums or {}).values()), None)
    if owner is None:
        return Finding("checksums", where, Verdict.FAILED, "the file was changed after it was built; build it again")
    its = next(key for key, checksum in (owner.file_checksums or {}).items() if checksum == found)
    whose = "of this clip" if owner.clip_id == info.clip_id else f"of clip {owner.clip_id}"
    return Finding("checksums", where, Verdict.FAILED, f"this is the file {its} {whose}; files were swapped")


def _check_shares(info: ClipInfo, camera: str, where: str) -> Finding:
    view = info.views[camera]
    shares = (view.observed_share, view.invented_share, view.other_times_share)
    beyond = max(
        *(-share for share in shares),
        view.observed_share + view.invented_share - 1.0,
        view.other_times_share - view.observed_share,
        view.invented_share if info.kind == "GT" else 0.0,
        0.0,
    )
    detail = "beyond what shares of pixels can be, or invented in a clip of true views"
    return judge("shares of pixels", where, beyond, SHARE_ERROR, detail)
