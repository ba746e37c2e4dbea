"""Whether cameras are mounted as their names say, and lenses are lenses; a policy knows cameras by name alone."""

from collections.abc import Iterator

import numpy as np
import pandas as pd
from numpy.polynomial import Polynomial

from olt_generator.cameras import Camera
from olt_generator.poses import Array
from olt_toolkit.clips import pai_tables as tables
from olt_toolkit.clips.pai_layout import CAMERA_INTRINSICS, SENSOR_EXTRINSICS
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.verification.findings import Finding, judge, not_compared, state
from olt_toolkit.clips.verification.motion_table import QUATERNION_ERROR
from olt_toolkit.rigs.rig import (
    CROSS_LEFT,
    CROSS_RIGHT,
    FRONT_TELE,
    FRONT_WIDE,
    REAR_LEFT,
    REAR_RIGHT,
    REAR_TELE,
    MountedCamera,
    VehicleDimensions,
)

LOOKS_TO: dict[str, tuple[float, float]] = {
    FRONT_WIDE: (0.0, 45.0),
    FRONT_TELE: (0.0, 30.0),
    CROSS_LEFT: (70.0, 50.0),
    CROSS_RIGHT: (-70.0, 50.0),
    REAR_LEFT: (135.0, 45.0),
    REAR_RIGHT: (-135.0, 45.0),
    REAR_TELE: (180.0, 45.0),
}
"""Degrees from straight ahead, positive to the left, to which each camera looks, and how far it may be off. Between
rigs of vehicles, cross cameras differ by 40 degrees; the limits keep each camera on its side."""
LARGEST_ROLL = 0.35
"""rad about the optical axis: a camera that hangs askew by 20 degrees is seen at once."""
LARGEST_PITCH = 0.6
"""rad up or down: steeper cameras look at the ground or the sky."""
HIGHEST = 4.5
"""m above the ground: the highest vehicles that may drive are 4.0 to 4.3 m."""
BESIDE = 0.3
"""m that a camera may stand out of its vehicle, as on mirrors and roof racks."""
WRONG_SIDE = 0.1
"""m over the middle by which a camera of one side may be mounted on the other."""
NARROWER = 0.9
"""Field of view of a tele camera against that of the wide one."""
LENS_ERROR = 1.0
"""px by which the polynomials to and from the image may differ within it."""
_LENS_NODES = 257
_SIDES = {CROSS_LEFT: 1.0, REAR_LEFT: 1.0, CROSS_RIGHT: -1.0, REAR_RIGHT: -1.0}


def check_calibration(store: ClipStore, clip_id: str) -> Iterator[Finding]:
    """Mounting and lens of every camera, and the size of the vehicle."""
    where = f"{store.root}: clip {clip_id}"
    yield _check_quaternions(store, clip_id, where)
    vehicle = store.read_vehicle(clip_id)
    yield _check_vehicle(vehicle, where)
    lenses = store.read_rows(clip_id, CAMERA_INTRINSICS)
    cameras = {name: store.read_camera(clip_id, name) for name in store.info(clip_id).views}
    for name, mounted in cameras.items():
        yield from check_mounting(name, mounted, vehicle, f"{where}: {name}")
        yield from check_lens(_lens_row(lenses, clip_id, name), f"{where}: {name}")
    if {FRONT_WIDE, FRONT_TELE} <= cameras.keys():
        wide, tele = (field_of_view(cameras[name].camera) for name in (FRONT_WIDE, FRONT_TELE))
        detail = f"of the wide view's field: tele {np.degrees(tele):.0f}, wide {np.degrees(wide):.0f} degrees across"
        yield judge("tele narrower than wide", where, tele / wide, NARROWER, detail)
    else:
        yield not_compared("tele narrower than wide", where, "the clip has not both front cameras")


def check_mounting(name: str, mounted: MountedCamera, vehicle: VehicleDimensions, where: str) -> Iterator[Finding]:
    """Whether a camera looks where its name says, upright, from a place on the vehicle."""
    right, down, ahead = mounted.T_rig_camera[:3, :3].T
    centre, reach = LOOKS_TO[name]
    yaw = float(np.degrees(np.arctan2(ahead[1], ahead[0])))
    off = abs((yaw - centre + 180.0) % 360.0 - 180.0)
    detail = f"degrees off {centre:g} to the left, it looks to {yaw:.0f}; is it another camera's mounting?"
    yield judge("looks where its name says", where, off, reach, detail)
    pitch = float(abs(np.arcsin(np.clip(ahead[2], -1.0, 1.0))))
    yield judge(
        "camera level", where, pitch, LARGEST_PITCH, "rad up or down; is z of the camera ahead, and of the rig up?"
    )
    roll = float(abs(np.arctan2(right[2], -down[2])))
    yield judge("camera upright", where, roll, LARGEST_ROLL, "rad about its axis; x of a camera is right, y down")
    yield _check_place(mounted.T_rig_camera[:3, 3], vehicle, where)
    if name in _SIDES:
        over = max(0.0, -_SIDES[name] * float(mounted.T_rig_camera[1, 3]))
        detail = "m on the other side of the vehicle than its name says; y is to the left"
        yield judge("camera on its side", where, over, WRONG_SIDE, detail)


def check_lens(row: dict[str, float], where: str) -> Iterator[Finding]:
    """Whether a row of the lens table has its axis in the image, and two rising polynomials that invert each other."""
    size, centre = (
        np.array([row[name] for name in names], np.float64) for names in (["width", "height"], ["cx", "cy"])
    )
    inside = bool((size > 0.0).all() and (centre >= 0.0).all() and (centre < size).all())
    yield state("principal point", where, inside, f"at {centre.tolist()} of {size.tolist()} pixels")
    reach = float(np.linalg.norm(np.maximum(centre, size - 1.0 - centre)))
    radius = np.linspace(0.0, reach, _LENS_NODES)
    forward, backward = (Polynomial([row[name] for name in names]) for names in (tables.FORWARD, tables.BACKWARD))
    angle = backward(radius)
    falls = bool((np.diff(angle) <= 0.0).any() or (np.diff(forward(angle)) <= 0.0).any())
    yield state("lens rises", where, not falls, f"both polynomials, to the corner at {reach:.0f} px")
    error = float(np.abs(forward(angle) - radius).max())
    detail = "px between a radius and the radius of its angle; are both polynomials of one lens and image size?"
    yield judge("lens polynomials agree", where, error, LENS_ERROR, detail)


def field_of_view(camera: Camera) -> float:
    """Angle (rad) between the rays of the leftmost and the rightmost pixel of the middle row."""
    middle = 0.5 * (camera.height - 1)
    rays = camera.rays(np.array([[0.0, middle], [0.5 * (camera.width - 1), middle], [camera.width - 1.0, middle]]))
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    halves = np.arccos(np.clip((rays[[0, 2]] * rays[1]).sum(axis=-1), -1.0, 1.0))
    return float(halves.sum())


def _lens_row(lenses: pd.DataFrame, clip_id: str, camera: str) -> dict[str, float]:
    values = lenses.loc[[(clip_id, camera)], tables.LENS].to_numpy(np.float64)[0]
    return dict(zip(tables.LENS, values.tolist(), strict=True))


def _check_place(position: Array, vehicle: VehicleDimensions, where: str) -> Finding:
    rear = 0.5 * vehicle.length - vehicle.rear_axle_to_bbox_center
    low = np.array([-rear, -0.5 * vehicle.width, 0.0])
    high = np.array([vehicle.length - rear, 0.5 * vehicle.width, max(vehicle.height, HIGHEST - BESIDE)])
    outside = float(np.maximum(low - position, position - high).max())
    detail = f"m outside the vehicle, at {np.round(position, 2).tolist()}; positions are metres from the rear axle"
    return judge("camera on the vehicle", where, max(0.0, outside), BESIDE, detail)


def _check_quaternions(store: ClipStore, clip_id: str, where: str) -> Finding:
    rows = store.read_rows(clip_id, SENSOR_EXTRINSICS)
    error = np.abs(np.linalg.norm(rows[tables.QUATERNION].to_numpy(np.float64), axis=1) - 1.0)
    row = int(np.argmax(error))
    place = f"{where}: {SENSOR_EXTRINSICS}: {rows.index[row][1]}"
    return judge("unit quaternions", place, float(error[row]), QUATERNION_ERROR, "off unit length")


def _check_vehicle(vehicle: VehicleDimensions, where: str) -> Finding:
    """Whether a vehicle has the size of one; the ranges hold small cars and articulated lorries."""
    ranges = {
        "length": (2.0, 26.0),
        "width": (1.0, 3.2),
        "height": (0.9, HIGHEST),
        "wheelbase": (1.0, vehicle.length),
        "track_width": (0.8, vehicle.width),
        "rear_axle_to_bbox_center": (0.0, 0.5 * vehicle.length),
    }
    wrong = [
        f"{name} {getattr(vehicle, name):g} m, not {low:g} to {high:g}"
        for name, (low, high) in ranges.items()
        if not low <= getattr(vehicle, name) <= high
    ]
    return state("vehicle size", f"{where}: vehicle_dimensions", not wrong, "; ".join(wrong) or "of a road vehicle")
