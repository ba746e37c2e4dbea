"""The tables of a PhysicalAI-AV clip: how they are made of a clip's parts, and read back strictly.

Columns and units: docs/formats/physicalai_av.md. Tables that are looked up by clip carry it as a pandas
index, because the public readers find clips through that index.
"""

import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from olt_generator.cameras import FthetaCamera
from olt_generator.errors import InputError
from olt_generator.poses import Array, pose_from_quaternion
from olt_generator.trajectory import Trajectory
from olt_toolkit.clips.clip import CameraStream, EgoMotion
from olt_toolkit.clips.parquet_files import open_parquet, read_rows
from olt_toolkit.rigs.ftheta_fit import fit_ftheta
from olt_toolkit.rigs.rig import MountedCamera, VehicleDimensions

_WIDEST = 20_000
QUATERNION = ["qx", "qy", "qz", "qw"]
POSITION = ["x", "y", "z"]
VELOCITY = ["vx", "vy", "vz"]
ACCELERATION = ["ax", "ay", "az"]
FORWARD = [f"fw_poly_{power}" for power in range(5)]
BACKWARD = [f"bw_poly_{power}" for power in range(5)]
LENS = ["width", "height", "cx", "cy", *FORWARD, *BACKWARD]
# What pandas and Arrow raise where the metadata contradict the columns.
_NOT_PANDAS = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError, pa.ArrowException)
DIMENSIONS = ["length", "width", "height", "rear_axle_to_bbox_center", "wheelbase", "track_width"]


def egomotion_table(motion: EgoMotion) -> pd.DataFrame:
    """The table `{clip}.egomotion.parquet`."""
    T_anchor_rig = motion.trajectory.T_world_rig
    columns = {"timestamp": motion.trajectory.timestamps_us}
    columns |= _columns(QUATERNION, Rotation.from_matrix(T_anchor_rig[:, :3, :3]).as_quat())
    columns |= _columns(POSITION, T_anchor_rig[:, :3, 3])
    columns |= _columns(VELOCITY, motion.velocity) | _columns(ACCELERATION, motion.acceleration)
    return pd.DataFrame(columns | {"curvature": motion.curvature})


def read_egomotion(data: bytes, where: str) -> EgoMotion:
    """Read `{clip}.egomotion.parquet`; an `InputError` where a column is missing, or times or poses cannot be used."""
    table = read_table(data, ["timestamp", *QUATERNION, *POSITION, *VELOCITY, *ACCELERATION, "curvature"], where)
    timestamps_us = _timestamps(table, where)
    quaternion, position = _array(table, QUATERNION, where), _array(table, POSITION, where)
    if np.any(np.linalg.norm(quaternion, axis=1) < 0.5):
        raise InputError(f"{where}: columns qx, qy, qz, qw hold quaternions that are not unit length")
    return EgoMotion(
        Trajectory(timestamps_us, pose_from_quaternion(quaternion, position)),
        _array(table, VELOCITY, where),
        _array(table, ACCELERATION, where),
        _array(table, ["curvature"], where)[:, 0],
    )


def read_timestamps(data: bytes, where: str) -> NDArray[np.int64]:
    """The (n,) clip times of `{clip}.<camera>.timestamps.parquet`; an `InputError` where they do not increase."""
    return _timestamps(read_table(data, ["timestamp"], where), where)


def intrinsics_table(clip_id: str, streams: Mapping[str, CameraStream]) -> pd.DataFrame:
    """Rows of `camera_intrinsics` for one clip; an `InputError` where f-theta polynomials cannot hold a lens."""
    rows = {}
    for name, stream in streams.items():
        try:
            camera = fit_ftheta(stream.camera).camera
        except InputError as error:
            raise InputError(f"{name}: {error}") from error
        values = (camera.width, camera.height, camera.cx, camera.cy, *camera.fw_poly, *camera.bw_poly)
        rows[clip_id, name] = dict(zip(LENS, values, strict=True))
    return _indexed(rows, ["clip_id", "camera_name"])


def extrinsics_table(clip_id: str, streams: Mapping[str, CameraStream]) -> pd.DataFrame:
    """Rows of `sensor_extrinsics` for one clip: camera to rig."""
    rows = {}
    for name, stream in streams.items():
        quaternion = Rotation.from_matrix(stream.T_rig_camera[:3, :3]).as_quat()
        values = (*quaternion.tolist(), *stream.T_rig_camera[:3, 3].tolist())
        rows[clip_id, name] = dict(zip([*QUATERNION, *POSITION], values, strict=True))
    return _indexed(rows, ["clip_id", "sensor_name"])


def vehicle_table(clip_id: str, vehicle: VehicleDimensions) -> pd.DataFrame:
    """Row of `vehicle_dimensions` for one clip."""
    row = {name: float(getattr(vehicle, name)) for name in DIMENSIONS}
    return pd.DataFrame([row], index=pd.Index([clip_id], name="clip_id"))


def read_mounted_camera(intrinsics: Path, extrinsics: Path, clip_id: str, camera: str) -> MountedCamera:
    """Lens and mounting of one camera of one clip; an `InputError` where a file, column, index or row is missing."""
    mounting = [*QUATERNION, *POSITION]
    key = (clip_id, camera)
    lens = _row(read_indexed(intrinsics, LENS, ["clip_id", "camera_name"]), key, LENS, intrinsics)
    pose = _row(read_indexed(extrinsics, mounting, ["clip_id", "sensor_name"]), key, mounting, extrinsics)
    if any(lens[side] not in range(1, _WIDEST + 1) for side in ("width", "height")):
        raise InputError(
            f"{intrinsics}: row {key} is a picture of {lens['width']:g} x {lens['height']:g} pixels; no camera has that"
        )
    forward, backward = (tuple(lens[name] for name in names) for names in (FORWARD, BACKWARD))
    model = FthetaCamera(int(lens["width"]), int(lens["height"]), lens["cx"], lens["cy"], forward, backward)
    return MountedCamera(
        fit_ftheta(model).camera,
        pose_from_quaternion([pose[name] for name in QUATERNION], [pose[name] for name in POSITION]),
    )


def read_vehicle(path: Path, clip_id: str) -> VehicleDimensions:
    """Read the size of a clip's vehicle; an `InputError` where the file, a column, the index or the row is missing."""
    return VehicleDimensions(**_row(read_indexed(path, DIMENSIONS, ["clip_id"]), clip_id, DIMENSIONS, path))


def read_indexed(path: Path, columns: list[str], index: list[str]) -> pd.DataFrame:
    """Read a table with the given columns and pandas index; an `InputError` where it has not both."""
    frame, names = to_pandas(read_table(path, columns, str(path)), path)
    if names != index:
        raise InputError(
            f"{path}: its index is {names or 'missing'}; it must be {', '.join(index)}, written as a pandas index"
        )
    if not all(pd.api.types.is_hashable(key) for key in frame.index):
        raise InputError(f"{path}: its index {', '.join(index)} holds lists; it must hold words")
    if not frame.index.is_unique:
        repeated = frame.index[frame.index.duplicated()][0]
        raise InputError(f"{path}: {', '.join(index)} {repeated} is there more than once")
    return frame


def to_pandas(table: pa.Table, path: Path) -> tuple[pd.DataFrame, list[str]]:
    """A table and the columns of its index, as the metadata that pandas wrote tell; `InputError` where they cannot."""
    try:
        return table.to_pandas(), (table.schema.pandas_metadata or {}).get("index_columns", [])
    except _NOT_PANDAS as error:
        raise InputError(f"{path}: its metadata for pandas are damaged ({error!r}); write it again") from error


def read_table(source: Path | bytes, columns: list[str], where: str) -> pa.Table:
    """Read a Parquet table; an `InputError` where it cannot be read or lacks one of these columns."""
    with open_parquet(source, where) as file:
        missing = [name for name in columns if name not in file.schema_arrow.names]
        if missing:
            raise InputError(f"{where}: column {', '.join(missing)} is missing")
        return read_rows(file, where)


def to_bytes(frame: pd.DataFrame) -> bytes:
    """A table as Parquet, its index with it."""
    buffer = io.BytesIO()
    frame.to_parquet(buffer)
    return buffer.getvalue()


def _columns(names: list[str], values: Array) -> dict[str, Array]:
    return {name: values[:, column] for column, name in enumerate(names)}


def _indexed(rows: dict[tuple[str, str], dict[str, float]], names: list[str]) -> pd.DataFrame:
    return pd.DataFrame(list(rows.values()), index=pd.MultiIndex.from_tuples(list(rows), names=names))


def _row(frame: pd.DataFrame, key: str | tuple[str, str], columns: list[str], path: Path) -> dict[str, float]:
    if key not in frame.index:
        raise InputError(f"{path}: no row for {key if isinstance(key, str) else ', '.join(key)}")
    try:
        values = frame[columns].to_numpy(dtype=np.float64)[frame.index.get_loc(key)]
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: row {key} holds what is no number ({error})") from error
    if not np.isfinite(values).all():
        raise InputError(f"{path}: row {key} holds values that are not finite")
    return dict(zip(columns, values.tolist(), strict=True))


def _timestamps(table: pa.Table, where: str) -> NDArray[np.int64]:
    column = table.column("timestamp")
    if not pa.types.is_signed_integer(column.type) or column.null_count:
        raise InputError(f"{where}: column timestamp is {column.type}; it must be int64 microseconds, none missing")
    timestamps_us = column.to_numpy().astype(np.int64)
    if len(timestamps_us) < 2 or np.any(np.diff(timestamps_us) <= 0):
        raise InputError(f"{where}: column timestamp must hold at least two strictly increasing times")
    return timestamps_us


def _array(table: pa.Table, names: list[str], where: str) -> Array:
    """Columns as (n, len(names)) float64."""
    for name in names:
        column = table.column(name)
        if not pa.types.is_floating(column.type) or column.null_count:
            raise InputError(f"{where}: column {name} is {column.type}; it must be a float column, none missing")
    values = np.stack([table.column(name).to_numpy().astype(np.float64) for name in names], axis=-1)
    if not np.isfinite(values).all():
        raise InputError(f"{where}: columns {', '.join(names)} hold values that are not finite")
    return values
