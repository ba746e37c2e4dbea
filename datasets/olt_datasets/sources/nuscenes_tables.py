"""The tables of a nuScenes release as one: a row for every camera image, with its pose and its calibration.

Of the thirteen JSON tables seven are needed. Those of the full release are gigabytes of text, so they are read row by
row, and the result is kept as Parquet in the cache for as long as the tables stay what they are.
"""

from collections.abc import Iterator
from hashlib import blake2b
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from olt_datasets.sources.json_rows import read_rows
from olt_generator.errors import InputError
from olt_generator.files import write_whole

TABLES = ("sensor", "calibrated_sensor", "log", "scene", "sample", "sample_data", "ego_pose")
POSITION = ["x", "y", "z"]
QUATERNION = ["qw", "qx", "qy", "qz"]
MOUNTING = [f"camera_{name}" for name in (*POSITION, *QUATERNION)]
LENS = ["fx", "fy", "cx", "cy"]
SCENE = ["scene", "scene_token", "description", "location"]
IMAGE = [*SCENE, "channel", "filename", "timestamp", "width", "height", "calibrated_sensor"]
# Changes with the columns, so that files of another version of this module are not taken.
_FORMAT = "2"
_BATCH = 50_000
_ROW_GROUP = 20_000


def camera_images(release: Path, cache: Path) -> Path:
    """The Parquet file of all camera images of a release, made where it is not in the cache yet.

    Columns: `IMAGE`; `POSITION` and `QUATERNION` of the vehicle in the map; `MOUNTING` of the camera in the
    vehicle; `LENS` in pixels. Rows are sorted by scene, channel and time. The release is a folder, such as `v1.0-mini`.
    InputError names file, row and field where a table is missing or damaged.
    """
    digest = blake2b(_FORMAT.encode(), digest_size=8)  # changes when a table is replaced
    for name in TABLES:
        table = release / f"{name}.json"
        if not table.is_file():
            raise InputError(f"{table}: no such table; copy the release's tables again")
        status = table.stat()
        digest.update(f"{name} {status.st_size} {status.st_mtime_ns}".encode())
    path = cache / f"nuscenes-{release.name}-{digest.hexdigest()}.parquet"
    if not path.is_file():
        calibrations = _read_calibrations(release)
        images = _read_sample_data(release, set(calibrations["calibrated_sensor"]))
        images = _joined(images, _read_scenes(release), "sample_token", release / "sample.json")
        images = _joined(images, calibrations, "calibrated_sensor", release / "calibrated_sensor.json")
        images = _joined(
            images, _read_poses(release, set(images["ego_pose_token"])), "ego_pose_token", release / "ego_pose.json"
        )
        images = images.select([*IMAGE, *POSITION, *QUATERNION, *MOUNTING, *LENS])
        with write_whole(path) as temporary:
            images.sort("scene", "channel", "timestamp").write_parquet(temporary, row_group_size=_ROW_GROUP)
    return path


def _joined(images: pl.DataFrame, table: pl.DataFrame, key: str, path: Path) -> pl.DataFrame:
    missing = images.join(table, on=key, how="anti")
    if len(missing):
        raise InputError(f"{path}: no row with token {missing[key][0]}, which {missing['filename'][0]} refers to")
    return images.join(table, on=key, how="left")


def _read_calibrations(release: Path) -> pl.DataFrame:
    """Lens and mounting of every camera, by the token of the calibration."""
    channels = {
        row["token"]: row["channel"]
        for row in read_rows(release / "sensor.json", {"token": str, "channel": str, "modality": str})
        if row["modality"] == "camera"
    }
    path = release / "calibrated_sensor.json"
    fields = {"token": str, "sensor_token": str, "translation": list, "rotation": list, "camera_intrinsic": list}
    rows = []
    for row in read_rows(path, fields):
        if row["sensor_token"] not in channels:
            continue
        matrix = np.array(row["camera_intrinsic"])
        if matrix.shape != (3, 3) or matrix[0, 1] != 0.0 or min(matrix[0, 0], matrix[1, 1]) <= 0.0:
            raise InputError(f"{path}: token {row['token']}: camera_intrinsic must be a 3 x 3 matrix without skew")
        lens = [float(matrix[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2))]
        rows.append((row["token"], channels[row["sensor_token"]], *_pose(row, path), *lens))
    schema = {"calibrated_sensor": pl.String, "channel": pl.String} | dict.fromkeys([*MOUNTING, *LENS], pl.Float64)
    return pl.DataFrame(rows, schema, orient="row").unique("calibrated_sensor", keep="first", maintain_order=True)


def _read_scenes(release: Path) -> pl.DataFrame:
    """Name, token, description and place of the scene, by the token of the sample."""
    logs = {row["token"]: row["location"] for row in read_rows(release / "log.json", {"token": str, "location": str})}
    path = release / "scene.json"
    scenes = {}
    for row in read_rows(path, {"token": str, "name": str, "description": str, "log_token": str}):
        if row["log_token"] not in logs:
            raise InputError(f"{path}: scene {row['name']}: log.json has no log_token {row['log_token']}")
        scenes[row["token"]] = (row["name"], row["token"], row["description"], logs[row["log_token"]])
    path = release / "sample.json"
    rows = []
    for row in read_rows(path, {"token": str, "scene_token": str}):
        if row["scene_token"] not in scenes:
            raise InputError(f"{path}: sample {row['token']}: scene.json has no scene_token {row['scene_token']}")
        rows.append((row["token"], *scenes[row["scene_token"]]))
    schema = dict.fromkeys(["sample_token", *SCENE], pl.String)
    return pl.DataFrame(rows, schema, orient="row")


def _read_sample_data(release: Path, calibrations: set[str]) -> pl.DataFrame:
    """The images of the cameras that have one of these calibrations."""
    path = release / "sample_data.json"
    names = ["sample_token", "ego_pose_token", "calibrated_sensor_token", "filename", "timestamp", "width", "height"]
    fields = {name: int if name in ("timestamp", "width", "height") else str for name in names}
    rows = (
        tuple(row[name] for name in names)
        for row in read_rows(path, {"calibrated_sensor_token": str} | fields)
        if row["calibrated_sensor_token"] in calibrations
    )
    schema = {name: pl.Int64 if fields[name] is int else pl.String for name in names}
    images = _collect(rows, schema, path).rename({"calibrated_sensor_token": "calibrated_sensor"})
    outside = images.filter(pl.col("filename").str.contains(r"^/|(^|/)\.\.(/|$)"))["filename"]
    if len(outside):
        raise InputError(f"{path}: filename {outside[0]!r} leaves the data set")
    return images.with_columns(pl.col("width", "height").cast(pl.Int32))


def _read_poses(release: Path, wanted: set[str]) -> pl.DataFrame:
    """Poses of the vehicle in the map, by their token."""
    path = release / "ego_pose.json"
    rows = (
        (row["token"], *_pose(row, path))
        for row in read_rows(path, {"token": str, "translation": list, "rotation": list})
        if row["token"] in wanted
    )
    schema = {"ego_pose_token": pl.String} | dict.fromkeys([*POSITION, *QUATERNION], pl.Float64)
    return _collect(rows, schema, path)


def _collect(rows: Iterator[tuple[Any, ...]], schema: dict[str, Any], path: Path) -> pl.DataFrame:
    """A table of many rows, of which few are ever Python objects."""
    batches = iter(lambda: list(islice(rows, _BATCH)), [])
    try:
        parts = [pl.DataFrame(batch, schema, orient="row") for batch in batches]
    except (OverflowError, TypeError, pl.exceptions.PolarsError) as error:
        raise InputError(f"{path}: holds an integer of more than 64 bits ({error}); copy it again") from error
    return pl.concat(parts) if parts else pl.DataFrame(schema=schema)


def _pose(row: dict[str, Any], path: Path) -> list[float]:
    """Translation and quaternion w, x, y, z."""
    if len(row["translation"]) != 3 or len(row["rotation"]) != 4:
        raise InputError(f"{path}: token {row['token']}: translation must hold 3 numbers and rotation 4")
    if abs(np.linalg.norm(row["rotation"]) - 1.0) > 1e-3:
        raise InputError(f"{path}: token {row['token']}: rotation must be a quaternion of length 1")
    return [*row["translation"], *row["rotation"]]
