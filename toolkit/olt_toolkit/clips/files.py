"""How one clip's files are written to a folder, and how such folders become chunks of the PhysicalAI-AV tree."""

import zipfile
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np
import pandas as pd

from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_generator.video import write_video
from olt_generator.views.pixel_origin import PixelOrigin
from olt_toolkit.clips import pai_layout as layout
from olt_toolkit.clips import pai_tables as tables
from olt_toolkit.clips.action_errors import measure_action_errors
from olt_toolkit.clips.checksums import checksum_bytes, checksum_clip, checksum_rows, member_key
from olt_toolkit.clips.clip import CameraStream, Clip, ClipDescription, ClipInfo, ViewProvenance, check_clip_id
from olt_toolkit.clips.fingerprint import fingerprint_images, fingerprint_times
from olt_toolkit.clips.images import largest_rectangle
from olt_toolkit.clips.origin_files import encode_origin
from olt_toolkit.clips.pai_layout import CALIBRATIONS, FEATURES, PIXEL_ORIGIN, PIXEL_ORIGINS, STORED, TRUTHS, Feature
from olt_toolkit.clips.table import CLIP_TABLE, read_clip_table, write_clip_table
from olt_toolkit.clips.truth_tables import truth_tables
from olt_toolkit.policy.window import Coverage, frames_per_step, sample_times
from olt_toolkit.rigs.contracts import widest_contract
from olt_toolkit.rigs.rig import FRONT_WIDE
from olt_toolkit.runtime.version import code_version

# Members of a zip carry one fixed date, so that the same clips give the same bytes.
_ZIP_DATE = (1980, 1, 1, 0, 0, 0)


def write_clip_files(folder: Path, clip: Clip) -> ClipInfo:
    """Write what a chunk takes from one clip: zip members, calibration rows, its row of the clip table, returned."""
    check_clip(clip)
    clip_id = clip.clip_id
    calibration = {
        layout.CAMERA_INTRINSICS: tables.intrinsics_table(clip_id, clip.streams),
        layout.SENSOR_EXTRINSICS: tables.extrinsics_table(clip_id, clip.streams),
        layout.VEHICLE_DIMENSIONS: tables.vehicle_table(clip_id, clip.vehicle),
    }
    for name, table in calibration.items():
        table.to_parquet(folder / f"{name}.parquet")
    tables.egomotion_table(clip.ego_motion).to_parquet(
        folder / FEATURES[layout.EGOMOTION].member(layout.EGOMOTION, clip_id)
    )
    for camera, stream in clip.streams.items():
        feature = FEATURES[camera]
        timestamps = pd.DataFrame({"timestamp": stream.timestamps_us})
        timestamps.to_parquet(folder / feature.member(layout.FRAME_TIMESTAMPS, clip_id))
        path = folder / feature.member(layout.VIDEO, clip_id)
        write_video(path, stream.frames, stream.frame_rate, frames_per_step(stream.frame_rate))
        if stream.origin is not None and not clip.provenance[camera].is_seen_whole:
            masks = folder / PIXEL_ORIGINS[camera].member(PIXEL_ORIGIN, clip_id)
            masks.write_bytes(encode_origin(stream.timestamps_us, stream.origin))
    for name, table in truth_tables(clip).items():
        table.to_parquet(folder / TRUTHS[name].member(name, clip_id))
    checksums = {name: checksum_rows(table) for name, table in calibration.items()}
    for feature in STORED.values():
        for alias in feature.members:
            path = folder / feature.member(alias, clip_id)
            if path.exists():
                checksums[member_key(feature.name, alias)] = checksum_bytes(path.read_bytes())
    info = describe_clip(clip, checksums)
    write_clip_table(folder / CLIP_TABLE, [info])
    return info


def check_clip(clip: Clip) -> None:
    """Check that a clip's parts agree, with an `InputError` that names the clip and the part."""
    where = f"clip {clip.name}"
    check_clip_id(clip.clip_id, where)
    if clip.streams.keys() != clip.provenance.keys():
        raise InputError(f"{where}: provenance must be given for each camera stream and for nothing else")
    for camera, stream in clip.streams.items():
        if camera not in FEATURES:
            raise InputError(f"{where}: no PhysicalAI-AV camera is called {camera!r}")
        if len(stream.frames) != len(stream.timestamps_us):
            raise InputError(
                f"{where}: {camera} has {len(stream.frames)} frames and {len(stream.timestamps_us)} timestamps"
            )
        if len(stream.frames) < 2 or (stream.timestamps_us[1:] <= stream.timestamps_us[:-1]).any():
            raise InputError(f"{where}: {camera} needs at least two frames with strictly increasing timestamps")
        size = (stream.camera.width, stream.camera.height)
        if stream.frames.shape[1:] != (size[1], size[0], 3):
            raise InputError(f"{where}: {camera} has frames of shape {stream.frames.shape[1:]} for a lens of {size}")
        _check_origin(stream, clip.provenance[camera], f"{where}: {camera}")


def _check_origin(stream: CameraStream, provenance: ViewProvenance, where: str) -> None:
    if stream.origin is None:
        if not provenance.is_seen_whole:
            raise InputError(f"{where} was not seen whole, but which pixels were is not told; give its origin")
        return
    if stream.origin.shape != stream.frames.shape[:3] or stream.origin.dtype != np.uint8:
        raise InputError(f"{where}: origin is {stream.origin.shape} {stream.origin.dtype} for {stream.frames.shape}")
    if stream.origin.max() >= len(PixelOrigin):
        raise InputError(f"{where}: origin holds {stream.origin.max()}, which is no PixelOrigin")
    if provenance.with_shares(stream.origin) != provenance:
        raise InputError(f"{where}: the shares of its provenance are not those of its origin")


def describe_clip(clip: Clip, checksums: dict[str, str]) -> ClipInfo:
    """The clip's row in the clip table, given the checksums of its files (`clips.checksums`)."""
    spans = {name: (int(s.timestamps_us[0]), int(s.timestamps_us[-1])) for name, s in clip.streams.items()}
    times, reason = sample_times(Coverage(clip.ego_motion.span_us, spans), widest_contract(clip.streams))
    if times and clip.sample_t0_us is not None:
        times = tuple(time for time in times if time in clip.sample_t0_us)
        reason = None if times else "it covers none of the times at which it may be sampled"
    return ClipInfo(
        **{field.name: getattr(clip, field.name) for field in fields(ClipDescription)},
        duration_us=clip.ego_motion.span_us[1],
        sample_t0_us=times,
        no_sample_reason=reason,
        created_with=code_version(),
        checksum=checksum_clip(checksums),
        file_checksums=checksums,
        fingerprint=_fingerprint(clip.streams[FRONT_WIDE]) if FRONT_WIDE in clip.streams else None,
        views=clip.provenance,
        action_errors=measure_action_errors(clip.ego_motion, times, clip.streams),
        build_options=clip.build_options,
    )


def _fingerprint(stream: CameraStream) -> bytes:
    """Of what was seen alone: black borders make images look alike."""
    wanted = fingerprint_times(int(stream.timestamps_us[0]), int(stream.timestamps_us[-1]))
    frames = np.unique(np.abs(stream.timestamps_us[:, None] - wanted).argmin(axis=0))
    images, times_us = stream.frames[frames], stream.timestamps_us[frames]
    if stream.origin is not None:
        rows, columns = largest_rectangle((stream.origin != PixelOrigin.UNSEEN).all(axis=0))
        images = images[:, rows, columns]
    return fingerprint_images(images, times_us)


def pack_chunk(root: Path, chunk: int, folders: Sequence[Path]) -> list[ClipInfo]:
    """Pack clips, each in a folder of `write_clip_files`, into one chunk of the tree under `root`."""
    clips = [read_clip_table(folder / CLIP_TABLE)[0] for folder in folders]
    for feature in STORED.values():
        if feature.members:
            _pack_zip(feature, feature.chunk_file(root, chunk), clips, folders)
    for name in CALIBRATIONS:
        table = pd.concat([pd.read_parquet(folder / f"{name}.parquet") for folder in folders])
        with write_whole(FEATURES[name].chunk_file(root, chunk)) as temporary:
            table.to_parquet(temporary)
    return clips


def _pack_zip(feature: Feature, path: Path, clips: Sequence[ClipInfo], folders: Sequence[Path]) -> None:
    members = [
        folder / feature.member(alias, info.clip_id)
        for info, folder in zip(clips, folders, strict=True)
        if has_feature(info, feature)
        for alias in feature.members
    ]
    if not members:
        return
    with write_whole(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as archive:
        for member in members:
            add_member(archive, member.name, member.read_bytes())


def add_member(archive: zipfile.ZipFile, name: str, data: bytes) -> None:
    """Add a member to a chunk's zip; the same data give the same bytes whenever it is done."""
    entry = zipfile.ZipInfo(name, _ZIP_DATE)
    entry.external_attr = 0o644 << 16
    archive.writestr(entry, data)


def write_metadata(root: Path, clips: Sequence[ClipInfo], chunks: Sequence[int]) -> None:
    """Rewrite the tables through which the public readers find clips."""
    index = pd.Index([info.clip_id for info in clips], name="clip_id")
    clip_index = pd.DataFrame(
        {"chunk": pd.Series(chunks, index, "int64"), "split": [info.split for info in clips], "clip_is_valid": True},
        index=index,
    )
    presence = pd.DataFrame(
        {name: [has_feature(info, feature) for info in clips] for name, feature in FEATURES.items()},
        index=index,
        dtype=bool,
    )
    # Columns of the real table; when a clip was recorded, and by which platform, is not known.
    collection = pd.DataFrame(
        {
            "country": pd.Series([info.origin.country for info in clips], index, "string"),
            "month": pd.Series(None, index, "Int64"),
            "hour_of_day": pd.Series(None, index, "Int64"),
            "platform_class": pd.Series(None, index, "string"),
        }
    )
    with write_whole(root / layout.FEATURE_TABLE) as temporary:
        pd.DataFrame(layout.feature_rows()).to_csv(temporary, index=False)
    for name, table in {
        layout.CLIP_INDEX: clip_index,
        # Where it is there, the devkit takes splits from it and not from the index.
        layout.DEFAULT_SPLITS: clip_index[["split"]],
        layout.FEATURE_PRESENCE: presence,
        layout.DATA_COLLECTION: collection,
    }.items():
        with write_whole(root / name) as temporary:
            temporary.write_bytes(tables.to_bytes(table))


def has_feature(info: ClipInfo, feature: Feature) -> bool:
    """Whether a clip has this feature: all but some cameras, masks of views that were seen whole, and what few know."""
    if feature.directory == PIXEL_ORIGIN:
        return any(PIXEL_ORIGINS[camera] == feature and not view.is_seen_whole for camera, view in info.views.items())
    if feature.name in TRUTHS:
        return member_key(feature.name, feature.name) in (info.file_checksums or ())
    return feature.directory != "camera" or feature.name in info.views
