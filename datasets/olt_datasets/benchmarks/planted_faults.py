"""Faults that are planted into a store of two good clips, to measure how many of each kind verification finds.

Unless a fault is one of the files themselves, the checksums fit it, as if the clips had been built so: the content
alone can tell. `FAULTS` is the list; other modules add to it with lists of their own (`list_faults`).
"""

import stat
import struct
import warnings
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from olt_datasets.benchmarks.store_surgery import (
    change_calibration,
    change_member,
    change_members,
    change_motion,
    change_times,
    chunk_path,
    trust,
)
from olt_datasets.benchmarks.video_surgery import cut_frames, freeze_frames, shift_start, shrink_frames
from olt_toolkit.clips.pai_layout import (
    CAMERA_INTRINSICS,
    CLIP_INDEX,
    EGOMOTION,
    FEATURE_PRESENCE,
    FEATURE_TABLE,
    SENSOR_EXTRINSICS,
    STORED,
    VEHICLE_DIMENSIONS,
    VIDEO,
)
from olt_toolkit.rigs.rig import CROSS_LEFT, CROSS_RIGHT, FRONT_TELE, FRONT_WIDE

Generator = np.random.Generator
Plant = Callable[[Path, str, str, Generator], None]
"""Changes the store at a folder: the fault is in the first clip, and the other one is there to swap with."""


@dataclass(frozen=True)
class Fault:
    """One kind of fault.

    Attributes:
        name: in words.
        plant: puts it into a store.
        expected_checks: names of the checks that should find it; one that fails is enough.
        groups: the groups of checks that are run to look for it.
    """

    name: str
    plant: Plant
    expected_checks: tuple[str, ...]
    groups: tuple[str, ...]


_POSITION, _VELOCITY, _ACCELERATION = ["x", "y", "z"], ["vx", "vy", "vz"], ["ax", "ay", "az"]
_QUATERNION = ["qx", "qy", "qz", "qw"]


def _motion(change: Callable[[pd.DataFrame, Generator], pd.DataFrame]) -> Plant:
    return lambda root, clip, _, generator: change_motion(root, clip, lambda table: change(table, generator))


def _scaled(columns: list[str], factor: float) -> Plant:
    return _motion(lambda table, _: table.assign(**{name: factor * table[name] for name in columns}))


def _rotated(change: Callable[[Rotation], Rotation]) -> Plant:
    def turn(table: pd.DataFrame, _: Generator) -> pd.DataFrame:
        table[_QUATERNION] = change(Rotation.from_quat(np.array(table[_QUATERNION]))).as_quat()
        return table

    return _motion(turn)


def _yaw_in_degrees(rotation: Rotation) -> Rotation:
    yaw, pitch, roll = rotation.as_euler("ZYX").T
    return Rotation.from_euler("ZYX", np.stack([np.degrees(yaw), pitch, roll], axis=1))


def _reversed_poses(table: pd.DataFrame, _: Generator) -> pd.DataFrame:
    columns = [*_POSITION, *_QUATERNION]
    table[columns] = table[columns].to_numpy()[::-1]
    return table


def _reversed_all(table: pd.DataFrame, _: Generator) -> pd.DataFrame:
    for columns, sign in ((_POSITION, 1), (_QUATERNION, 1), (_VELOCITY, -1), (_ACCELERATION, 1), (["curvature"], -1)):
        table[columns] = sign * table[columns].to_numpy()[::-1]
    start = Rotation.from_quat(np.array(table[_QUATERNION].iloc[0])).inv()
    table[_POSITION] = start.apply(np.array(table[_POSITION] - table[_POSITION].iloc[0]))
    table[_QUATERNION] = (start * Rotation.from_quat(np.array(table[_QUATERNION]))).as_quat()
    for columns in (_VELOCITY, _ACCELERATION):
        table[columns] = start.apply(np.array(table[columns]))
    return table


def _teleported(table: pd.DataFrame, generator: Generator) -> pd.DataFrame:
    row = int(generator.integers(len(table) // 4, 3 * len(table) // 4))
    angle = generator.uniform(-np.pi, np.pi)
    table.loc[table.index[row:], ["x", "y"]] += 2.0 * np.array([np.cos(angle), np.sin(angle)])
    return table


def _with_row_repeated(table: pd.DataFrame, _: Generator) -> pd.DataFrame:
    """Where the vehicle is fastest: a row of one that stands is like the others."""
    speed = np.linalg.norm(table[_VELOCITY].to_numpy(), axis=1)
    row = 1 + int(np.argmax(speed[1:-1]))
    names = [name for name in table.columns if name != "timestamp"]
    table.loc[table.index[row], names] = table.loc[table.index[row - 1], names].to_numpy()
    return table


def _with_times_doubled(table: pd.DataFrame, _: Generator) -> pd.DataFrame:
    return pd.concat([table.iloc[:10], table.iloc[9:]])


def _with_number_missing(table: pd.DataFrame, generator: Generator) -> pd.DataFrame:
    table.loc[table.index[int(generator.integers(len(table)))], "x"] = np.nan
    return table


def _in_rig_frame(table: pd.DataFrame, _: Generator) -> pd.DataFrame:
    rotation = Rotation.from_quat(np.array(table[_QUATERNION])).inv()
    for columns in (_VELOCITY, _ACCELERATION):
        table[columns] = rotation.apply(np.array(table[columns]))
    return table


def _shifted(seconds: float) -> Plant:
    return _motion(lambda table, _: table.assign(timestamp=table["timestamp"] + round(1e6 * seconds)))


def _camera_times(change: Callable[[pd.Series], pd.Series]) -> Plant:
    def plant(root: Path, clip: str, _: str, generator: Generator) -> None:
        camera = str(generator.choice([CROSS_LEFT, FRONT_WIDE, CROSS_RIGHT, FRONT_TELE]))
        change_times(
            root,
            clip,
            camera,
            lambda table: table.assign(timestamp=change(pd.Series(table["timestamp"])).astype("int64")),
        )

    return plant


def _frame_dropped(times: pd.Series) -> pd.Series:
    late = np.arange(len(times)) >= len(times) // 2
    return times + np.where(late, int(times.diff().median()), 0)


def _video(change: Callable[[bytes], bytes], trusted: bool = True) -> Plant:
    def plant(root: Path, clip: str, _: str, __: Generator) -> None:
        if trusted:
            change_member(root, FRONT_WIDE, VIDEO, clip, change)
        else:
            name = STORED[FRONT_WIDE].member(VIDEO, clip)
            change_members(root, FRONT_WIDE, lambda members: members | {name: change(members[name])})

    return plant


def _flip_bit(data: bytes) -> bytes:
    place = 2 * len(data) // 3
    return data[:place] + bytes([data[place] ^ 0x10]) + data[place + 1 :]


def _flip_bit_on_disk(root: Path, clip: str, _: str, __: Generator) -> None:
    path, name = chunk_path(root, FRONT_WIDE), STORED[FRONT_WIDE].member(VIDEO, clip)
    with zipfile.ZipFile(path) as archive:
        member = archive.getinfo(name)
    data = bytearray(path.read_bytes())
    data[member.header_offset + 200 + member.compress_size // 2] ^= 0x10
    path.write_bytes(bytes(data))


def _swap_between_clips(feature: str, alias: str, trusted: bool = False) -> Plant:
    def plant(root: Path, clip: str, other: str, _: Generator) -> None:
        first, second = (STORED[feature].member(alias, each) for each in (clip, other))
        change_members(root, feature, lambda found: found | {first: found[second], second: found[first]})
        for each in (clip, other) if trusted else ():
            trust(root, each)

    return plant


def _swap_cameras(root: Path, clip: str, _: str, __: Generator) -> None:
    names = {camera: STORED[camera].member(VIDEO, clip) for camera in (CROSS_LEFT, CROSS_RIGHT)}
    videos: dict[str, bytes] = {}
    for camera, name in names.items():
        with zipfile.ZipFile(chunk_path(root, camera)) as archive:
            videos[camera] = archive.read(name)
    for camera, other in ((CROSS_LEFT, CROSS_RIGHT), (CROSS_RIGHT, CROSS_LEFT)):
        change_members(root, camera, lambda found, c=camera, o=other: found | {names[c]: videos[o]})


def _strange_member(name: str, mode: int = stat.S_IFREG | 0o644, data: bytes = b"x") -> Plant:
    def plant(root: Path, _: str, __: str, ___: Generator) -> None:
        entry = zipfile.ZipInfo(name)
        entry.external_attr = mode << 16
        with zipfile.ZipFile(chunk_path(root, EGOMOTION), "a", zipfile.ZIP_STORED) as archive:
            archive.writestr(entry, data)

    return plant


def _bomb(root: Path, _: str, __: str, ___: Generator) -> None:
    with zipfile.ZipFile(chunk_path(root, EGOMOTION), "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("zeros.parquet", bytes(32 << 20))


def _doubled_member(root: Path, clip: str, _: str, __: Generator) -> None:
    path, name = chunk_path(root, EGOMOTION), STORED[EGOMOTION].member(EGOMOTION, clip)
    with warnings.catch_warnings(), zipfile.ZipFile(path, "a") as archive:
        warnings.simplefilter("ignore")
        archive.writestr(name, archive.read(name))


def _false_size(root: Path, clip: str, _: str, __: Generator) -> None:
    """Declare 3 GiB for a member, in the directory at the end of the archive."""
    path, name = chunk_path(root, EGOMOTION), STORED[EGOMOTION].member(EGOMOTION, clip)
    data = bytearray(path.read_bytes())
    entry = data.rindex(b"PK\x01\x02", 0, data.rindex(name.encode()))
    data[entry + 24 : entry + 28] = struct.pack("<I", 3 << 30)
    path.write_bytes(bytes(data))


def _missing_member(root: Path, clip: str, _: str, __: Generator) -> None:
    name = STORED[CROSS_LEFT].member(VIDEO, clip)
    change_members(root, CROSS_LEFT, lambda found: {each: data for each, data in found.items() if each != name})


def _table(name: str, change: Callable[[pd.DataFrame, str], pd.DataFrame]) -> Plant:
    def plant(root: Path, clip: str, _: str, __: Generator) -> None:
        change(pd.read_parquet(root / name), clip).to_parquet(root / name)

    return plant


def _other_features(root: Path, _: str, __: str, ___: Generator) -> None:
    text = (root / FEATURE_TABLE).read_text()
    (root / FEATURE_TABLE).write_text(text.replace(CROSS_LEFT, "camera_left"))


def _calibration(name: str, change: Callable[[pd.DataFrame], pd.DataFrame]) -> Plant:
    return lambda root, clip, _, __: change_calibration(root, clip, name, change)


def _swap_rows(first: str, second: str) -> Callable[[pd.DataFrame], pd.DataFrame]:
    def swap(table: pd.DataFrame) -> pd.DataFrame:
        keys = [(table.index[0][0], name) for name in (first, second)]
        table.loc[keys] = table.loc[keys[::-1]].to_numpy()
        return table

    return swap


def _turn_mountings(change: Callable[[Rotation], Rotation]) -> Callable[[pd.DataFrame], pd.DataFrame]:
    def turn(table: pd.DataFrame) -> pd.DataFrame:
        table[_QUATERNION] = change(Rotation.from_quat(np.array(table[_QUATERNION]))).as_quat()
        return table

    return turn


def _swap_polynomials(table: pd.DataFrame) -> pd.DataFrame:
    forward, backward = ([f"{part}_poly_{power}" for power in range(5)] for part in ("fw", "bw"))
    table[[*forward, *backward]] = table[[*backward, *forward]].to_numpy()
    return table


_COLUMNS = ("velocity column", "acceleration column", "curvature column")
_DRIVEN = ("speed", "acceleration", "jerk")
_ANCHOR = ("anchor position", "anchor heading")
_MOTION, _TIMES, _VIDEOS, _FILES, _TABLES = ("motion",), ("times",), ("videos",), ("files",), ("tables",)

FAULTS: tuple[Fault, ...] = (
    Fault("positions in cm", _scaled(_POSITION, 100.0), (*_DRIVEN, *_COLUMNS), _MOTION),
    Fault("positions in feet", _scaled(_POSITION, 3.281), (*_DRIVEN, *_COLUMNS), _MOTION),
    Fault(
        "all lengths in feet but 1/m",
        _scaled([*_POSITION, *_VELOCITY, *_ACCELERATION], 3.281),
        (*_DRIVEN, *_COLUMNS),
        _MOTION,
    ),
    Fault("velocities in km/h", _scaled(_VELOCITY, 3.6), _COLUMNS, _MOTION),
    Fault("accelerations in g", _scaled(_ACCELERATION, 1 / 9.81), _COLUMNS, _MOTION),
    Fault(
        "heading in degrees",
        _rotated(_yaw_in_degrees),
        ("along the heading", "turns with its way", "curvature of the way", *_COLUMNS),
        _MOTION,
    ),
    Fault("y to the right", _scaled(["y"], -1.0), ("along the heading", "turns with its way", *_COLUMNS), _MOTION),
    Fault(
        "rotations transposed",
        _rotated(lambda each: each.inv()),
        ("along the heading", "turns with its way", *_COLUMNS),
        _MOTION,
    ),
    Fault(
        "quaternions w x y z",
        _motion(
            lambda table, _: table.assign(
                **dict(zip(_QUATERNION, table[["qw", "qx", "qy", "qz"]].to_numpy().T, strict=True))
            )
        ),
        ("upright",),
        _MOTION,
    ),
    Fault("quaternions not of unit length", _scaled(_QUATERNION, 1.01), ("unit quaternions",), _MOTION),
    Fault(
        "rig turned by 90 degrees",
        _rotated(lambda each: each * Rotation.from_euler("z", 90, degrees=True)),
        ("along the heading", "anchor heading"),
        _MOTION,
    ),
    Fault(
        "y and z exchanged",
        _motion(lambda table, _: table.rename(columns={"y": "z", "z": "y"})),
        ("along the heading", "turns with its way", "upright", *_COLUMNS),
        _MOTION,
    ),
    Fault("poses reversed in time", _motion(_reversed_poses), (*_ANCHOR, *_COLUMNS), _MOTION),
    Fault("all reversed in time", _motion(_reversed_all), ("drives forward",), _MOTION),
    Fault(
        "poses in the world's frame",
        _motion(lambda table, _: table.assign(x=table["x"] + 4.2e5, y=table["y"] + 5.4e6)),
        _ANCHOR,
        _MOTION,
    ),
    Fault("a jump of 2 m", _motion(_teleported), (*_DRIVEN, *_COLUMNS), _MOTION),
    Fault("a row repeated", _motion(_with_row_repeated), ("repeated poses",), _MOTION),
    Fault("a time twice", _motion(_with_times_doubled), ("readable for motion",), _MOTION),
    Fault("rows out of order", _motion(lambda table, _: table.iloc[::-1]), ("readable for motion",), _MOTION),
    Fault("a number missing", _motion(_with_number_missing), ("readable for motion",), _MOTION),
    Fault("velocity in the rig frame", _motion(_in_rig_frame), _COLUMNS, _MOTION),
    Fault("curvature positive to the right", _scaled(["curvature"], -1.0), _COLUMNS, _MOTION),
    Fault("poses 0.1 s late", _shifted(0.1), (*_ANCHOR, "frames within the motion", "duration"), ("motion", "times")),
    Fault("poses 1 s late", _shifted(1.0), (*_ANCHOR, "frames within the motion", "duration"), ("motion", "times")),
    Fault(
        "pose times in ms",
        _motion(lambda table, _: table.assign(timestamp=table["timestamp"] // 1000)),
        ("time unit of poses",),
        _TIMES,
    ),
    Fault("motion of another clip", _swap_between_clips(EGOMOTION, EGOMOTION), ("checksums",), _FILES),
    Fault("a camera 0.1 s late", _camera_times(lambda times: times + 100_000), ("cameras on one clock",), _TIMES),
    Fault("a camera 1 s late", _camera_times(lambda times: times + 1_000_000), ("cameras on one clock",), _TIMES),
    Fault(
        "a camera's clock 2 % fast",
        _camera_times(lambda times: (times * 1.02).round()),
        ("cameras on one clock",),
        _TIMES,
    ),
    Fault("frame times in ms", _camera_times(lambda times: times // 1000), ("time unit of frames",), _TIMES),
    Fault("a frame dropped", _camera_times(_frame_dropped), ("no frame missing",), _TIMES),
    Fault(
        "frame times out of order",
        _camera_times(lambda times: times.iloc[::-1].reset_index(drop=True)),
        ("readable for times",),
        _TIMES,
    ),
    Fault("videos of two clips swapped", _swap_between_clips(FRONT_WIDE, VIDEO), ("checksums",), _FILES),
    Fault("videos of two cameras swapped", _swap_cameras, ("checksums",), _FILES),
    Fault(
        "video cut short",
        _video(lambda data: data[: 2 * len(data) // 3]),
        ("video decodes", "frames for timestamps"),
        _VIDEOS,
    ),
    Fault("video with frames missing", _video(cut_frames), ("frames for timestamps",), _VIDEOS),
    Fault("video of another size", _video(shrink_frames), ("frame size",), _VIDEOS),
    Fault("video frozen for 0.5 s", _video(freeze_frames), ("no image repeated",), _VIDEOS),
    Fault("video that starts late", _video(shift_start), ("container times",), _VIDEOS),
    Fault("a bit flipped on disk", _flip_bit_on_disk, ("readable files",), _FILES),
    Fault("a bit flipped before packing", _video(_flip_bit, trusted=False), ("checksums",), _FILES),
    Fault("member with ../", _strange_member("../evil.parquet"), ("safe member names",), _TABLES),
    Fault("member with an absolute name", _strange_member("/etc/evil"), ("safe member names",), _TABLES),
    Fault("member with a backslash", _strange_member("..\\evil.parquet"), ("safe member names",), _TABLES),
    Fault(
        "member that is a link",
        _strange_member("link.parquet", stat.S_IFLNK | 0o777, b"/etc/passwd"),
        ("plain members",),
        _TABLES,
    ),
    Fault("member that is there twice", _doubled_member, ("members once",), _TABLES),
    Fault(
        "member of a clip that is not there",
        _strange_member("0" * 8 + ".egomotion.parquet"),
        ("no other members",),
        _TABLES,
    ),
    Fault("decompression bomb", _bomb, ("member ratio",), _TABLES),
    Fault("member that claims 3 GiB", _false_size, ("member size",), _TABLES),
    Fault("member missing", _missing_member, ("members of clips",), _TABLES),
    Fault(
        "clip missing from the index",
        _table(CLIP_INDEX, lambda table, clip: table.drop(index=clip)),
        ("clips in the index",),
        _TABLES,
    ),
    Fault(
        "unknown clip in the index",
        _table(
            CLIP_INDEX,
            lambda table, clip: pd.concat([table, table.loc[[clip]].rename(index={clip: clip[:-4] + "0000"})]),
        ),
        ("no other clips in the index",),
        _TABLES,
    ),
    Fault(
        "split of another clip",
        _table(CLIP_INDEX, lambda table, _: table.assign(split="test")),
        ("splits of the index",),
        _TABLES,
    ),
    Fault(
        "presence of a camera wrong",
        _table(FEATURE_PRESENCE, lambda table, _: table.assign(**{CROSS_LEFT: False})),
        ("presence",),
        _TABLES,
    ),
    Fault("features of other files", _other_features, ("features",), _TABLES),
    Fault(
        "left and right mounting swapped",
        _calibration(SENSOR_EXTRINSICS, _swap_rows(CROSS_LEFT, CROSS_RIGHT)),
        ("looks where its name says", "camera on its side"),
        ("calibration",),
    ),
    Fault(
        "mountings from rig to camera",
        _calibration(SENSOR_EXTRINSICS, _turn_mountings(lambda each: each.inv())),
        ("looks where its name says", "camera upright", "camera level"),
        ("calibration",),
    ),
    Fault(
        "mountings w x y z",
        _calibration(
            SENSOR_EXTRINSICS,
            lambda table: table.assign(
                **dict(zip(_QUATERNION, table[["qw", "qx", "qy", "qz"]].to_numpy().T, strict=True))
            ),
        ),
        ("looks where its name says", "camera upright", "camera level"),
        ("calibration",),
    ),
    Fault(
        "camera axes of the rig",
        _calibration(
            SENSOR_EXTRINSICS,
            _turn_mountings(lambda each: each * Rotation.from_matrix([[0, -1, 0], [0, 0, -1], [1, 0, 0]])),
        ),
        ("looks where its name says", "camera upright", "camera level"),
        ("calibration",),
    ),
    Fault(
        "mounting positions in mm",
        _calibration(
            SENSOR_EXTRINSICS, lambda table: table.assign(**{name: 1000.0 * table[name] for name in _POSITION})
        ),
        ("camera on the vehicle",),
        ("calibration",),
    ),
    Fault(
        "lenses of tele and wide swapped",
        _calibration(CAMERA_INTRINSICS, _swap_rows(FRONT_WIDE, FRONT_TELE)),
        ("tele narrower than wide",),
        ("calibration",),
    ),
    Fault(
        "lens of another image size",
        _calibration(CAMERA_INTRINSICS, lambda table: table.assign(width=1920, height=1080)),
        ("frame size", "readable for videos"),
        ("videos",),
    ),
    Fault(
        "lens centre of another image size",
        _calibration(CAMERA_INTRINSICS, lambda table: table.assign(cx=960.0, cy=540.0)),
        ("principal point", "readable for calibration"),
        ("calibration",),
    ),
    Fault(
        "lens polynomials swapped",
        _calibration(CAMERA_INTRINSICS, _swap_polynomials),
        ("lens polynomials agree", "readable for calibration"),
        ("calibration",),
    ),
    Fault(
        "vehicle in mm",
        _calibration(VEHICLE_DIMENSIONS, lambda table: 1000.0 * table),
        ("vehicle size",),
        ("calibration",),
    ),
)
