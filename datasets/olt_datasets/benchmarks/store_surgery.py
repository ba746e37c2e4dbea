"""Changes single files of a store, to plant faults in it: what a mistaken writer or a damaged disk would have left."""

import io
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pandas as pd

from olt_toolkit.clips.checksums import checksum_bytes, checksum_clip, checksum_rows, member_key
from olt_toolkit.clips.files import add_member
from olt_toolkit.clips.pai_layout import CALIBRATIONS, EGOMOTION, FRAME_TIMESTAMPS, STORED
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.table import CLIP_TABLE, read_clip_table, write_clip_table

Members = dict[str, bytes]


def chunk_path(root: Path, feature: str) -> Path:
    """File of the first chunk of a feature."""
    return STORED[feature].chunk_file(root, 0)


def change_members(root: Path, feature: str, change: Callable[[Members], Members]) -> None:
    """Write the archive of a feature again with other members."""
    path = chunk_path(root, feature)
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    path.unlink()
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for name, data in change(members).items():
            add_member(archive, name, data)


def change_member(root: Path, feature: str, alias: str, clip_id: str, change: Callable[[bytes], bytes]) -> None:
    """Change one member of a clip; its checksum is made to fit, as if it had been built so."""
    name = STORED[feature].member(alias, clip_id)
    change_members(root, feature, lambda members: members | {name: change(members[name])})
    trust(root, clip_id)


def change_motion(root: Path, clip_id: str, change: Callable[[pd.DataFrame], pd.DataFrame]) -> None:
    """Change the ego motion of a clip; its checksum is made to fit."""
    change_member(root, EGOMOTION, EGOMOTION, clip_id, _on_table(change))


def change_times(root: Path, clip_id: str, camera: str, change: Callable[[pd.DataFrame], pd.DataFrame]) -> None:
    """Change the timestamps of one camera of a clip; their checksum is made to fit."""
    change_member(root, camera, FRAME_TIMESTAMPS, clip_id, _on_table(change))


def change_calibration(root: Path, clip_id: str, name: str, change: Callable[[pd.DataFrame], pd.DataFrame]) -> None:
    """Change the rows of a clip in a calibration table; their checksum is made to fit."""
    path = chunk_path(root, name)
    table = pd.read_parquet(path)
    mine = table.index.get_level_values(0) == clip_id
    pd.concat([change(table.loc[mine].copy()), table.loc[~mine]]).to_parquet(path)
    trust(root, clip_id)


def trust(root: Path, clip_id: str) -> None:
    """Note the checksums of a clip's files as they are now, where they can be read."""
    store = ClipStore(root)
    infos = read_clip_table(root / CLIP_TABLE)
    known = dict(store.info(clip_id).file_checksums or {})
    for feature in STORED.values():
        for alias in feature.members:
            if member_key(feature.name, alias) in known:
                data = store.read_member(clip_id, feature.name, alias)
                known[member_key(feature.name, alias)] = checksum_bytes(data)
    known |= {name: checksum_rows(store.read_rows(clip_id, name)) for name in CALIBRATIONS}
    infos = [
        replace(info, file_checksums=known, checksum=checksum_clip(known)) if info.clip_id == clip_id else info
        for info in infos
    ]
    write_clip_table(root / CLIP_TABLE, infos)


def _on_table(change: Callable[[pd.DataFrame], pd.DataFrame]) -> Callable[[bytes], bytes]:
    def on_bytes(data: bytes) -> bytes:
        buffer = io.BytesIO()
        change(pd.read_parquet(io.BytesIO(data))).to_parquet(buffer)
        return buffer.getvalue()

    return on_bytes
