"""Checksums of a clip's files, which do not depend on the clip's id nor on the chunk that holds them.

So they hold in an export that lists the clip under another id. Members of zips are taken byte by byte. Rows of
calibration tables are taken by value, because a chunk has one file for the rows of all its clips.
"""

import hashlib
import json
from collections.abc import Mapping

import pandas as pd

DIGEST_BYTES = 16


def checksum_bytes(data: bytes) -> str:
    """BLAKE2b of some bytes, hexadecimal."""
    return hashlib.blake2b(data, digest_size=DIGEST_BYTES).hexdigest()


def checksum_rows(rows: pd.DataFrame) -> str:
    """BLAKE2b of the rows of one clip in a calibration table, by name of the sensor and of the column."""
    sensors = [key[1] if isinstance(key, tuple) else "" for key in rows.index]
    values = {
        sensor: {name: float(value) for name, value in zip(rows.columns, row, strict=True)}
        for sensor, row in zip(sensors, rows.to_numpy(), strict=True)
    }
    return checksum_bytes(json.dumps(values, sort_keys=True).encode())


def checksum_clip(files: Mapping[str, str]) -> str:
    """The checksum of a clip, from those of its files by name (`member_key`, or name of a calibration table)."""
    return checksum_bytes("".join(f"{name}={files[name]}\n" for name in sorted(files)).encode())


def member_key(feature: str, alias: str) -> str:
    """What a member of a chunk's zip is called among a clip's checksums."""
    return f"{feature}/{alias}"
