"""Camera rigs kept as data: one YAML file a rig in `rigs/`.

    name: example
    assumed: [...]            # a sentence for everything that is not measured
    vehicle: {length: ..., width: ..., height: ..., rear_axle_to_bbox_center: ..., wheelbase: ..., track_width: ...}
    cameras:
      front:
        size: [1920, 1080]
        lens: {model: pinhole, focal: [fx, fy], centre: [cx, cy]}
        position: [x, y, z]                 # metres in the rig frame (see olt_toolkit.rigs.rig)
        quaternion_xyzw: [x, y, z, w]       # or roll_pitch_yaw_degrees, as olt_generator.poses.camera_pose_in_rig

The lens models are pinhole, perspective (a centred pinhole by its field of view), brown_conrady, kannala_brandt,
ftheta and equidistant; their fields are those of the classes below.
"""

from functools import lru_cache
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, Literal, cast

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from olt_generator.cameras import BrownConradyCamera, Camera, FthetaCamera, KannalaBrandtCamera, PinholeCamera
from olt_generator.errors import InputError
from olt_generator.poses import camera_pose_in_rig, pose_from_quaternion
from olt_toolkit.rigs.rig import MountedCamera, Rig, VehicleDimensions
from olt_toolkit.runtime.yaml_files import read_yaml_mapping

_FOLDER = "rigs"

Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Pair = tuple[Number, Number]
Triple = tuple[Number, Number, Number]


def rig_names() -> list[str]:
    """The rigs that come with the package."""
    folder = files("olt_toolkit") / _FOLDER
    return sorted(entry.name.removesuffix(".yaml") for entry in folder.iterdir() if entry.name.endswith(".yaml"))


def load_rig(name: str) -> Rig:
    """A rig that comes with the package; what its file assumes is in `Rig.assumptions`.

    Raises:
        InputError: there is no such rig.
    """
    if name not in rig_names():
        raise InputError(f"no rig {name!r}; there are {', '.join(rig_names())}, and `read_rig` reads others from YAML")
    with as_file(files("olt_toolkit") / _FOLDER / f"{name}.yaml") as path:
        return read_rig(path)


@lru_cache(maxsize=1)
def pav_rig() -> Rig:
    """The nominal seven-camera PhysicalAI-AV rig, 1920 x 1080, read once; real clips carry their own calibration."""
    return load_rig("pav")


def read_rig(path: Path) -> Rig:
    """Read a rig of one's own.

    Raises:
        InputError: the file cannot be read, is not YAML, or a field is wrong; names the file and the field.
    """
    content = read_yaml_mapping(path, "rig", _RigFile.model_fields)
    try:
        rig = _RigFile.model_validate(content)
        cameras = {name: camera.mounted() for name, camera in rig.cameras.items()}
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise InputError(f"{path}: {place}: {first['msg']}") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return Rig(rig.name, cameras, VehicleDimensions(**rig.vehicle.model_dump()), rig.assumed)


class _Part(BaseModel):
    """A part of a rig file: no unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class _Focal(_Part):
    focal: tuple[Positive, Positive]
    centre: Pair


class _Pinhole(_Focal):
    model: Literal["pinhole"]

    def camera(self, width: int, height: int) -> Camera:
        return PinholeCamera(width, height, *self.focal, *self.centre)


class _Perspective(_Part):
    model: Literal["perspective"]
    horizontal_field_of_view_degrees: Positive

    def camera(self, width: int, height: int) -> Camera:
        field_of_view = float(np.radians(self.horizontal_field_of_view_degrees))
        return PinholeCamera.from_field_of_view(width, height, field_of_view)


class _BrownConrady(_Focal):
    """Distortion k1, k2, p1, p2, k3 and, for the rational model, k4, k5, k6."""

    model: Literal["brown_conrady"]
    distortion: Annotated[tuple[Number, ...], Field(min_length=5, max_length=8)]

    def camera(self, width: int, height: int) -> Camera:
        return BrownConradyCamera(width, height, *self.focal, *self.centre, *self.distortion)


class _KannalaBrandt(_Focal):
    """Distortion k1 ... k4."""

    model: Literal["kannala_brandt"]
    distortion: tuple[Number, Number, Number, Number]

    def camera(self, width: int, height: int) -> Camera:
        return KannalaBrandtCamera(width, height, *self.focal, *self.centre, *self.distortion)


class _Ftheta(_Part):
    """Polynomials in ascending powers; where both are given, `primary` says which one is the lens."""

    model: Literal["ftheta"]
    centre: Pair
    radius_to_angle: tuple[Number, ...]
    angle_to_radius: tuple[Number, ...] | None = None
    primary: Literal["forward", "backward"] | None = None

    @model_validator(mode="after")
    def _check(self) -> "_Ftheta":
        if (self.angle_to_radius is None) != (self.primary is None):
            raise ValueError("'angle_to_radius' and 'primary' belong together: give both or none")
        return self

    def camera(self, width: int, height: int) -> Camera:
        if self.angle_to_radius is None or self.primary is None:
            return FthetaCamera.from_radius_to_angle(width, height, *self.centre, self.radius_to_angle)
        polynomials = self.angle_to_radius, self.radius_to_angle
        return FthetaCamera(width, height, *self.centre, *polynomials, primary=self.primary)


class _Equidistant(_Part):
    model: Literal["equidistant"]
    centre: Pair
    pixels_per_radian: Positive

    def camera(self, width: int, height: int) -> Camera:
        return FthetaCamera.equidistant(width, height, *self.centre, self.pixels_per_radian)


_Lens = _Pinhole | _Perspective | _BrownConrady | _KannalaBrandt | _Ftheta | _Equidistant


class _Camera(_Part):
    size: tuple[Annotated[int, Field(gt=0)], Annotated[int, Field(gt=0)]]
    lens: Annotated[_Lens, Field(discriminator="model")]
    position: Triple
    quaternion_xyzw: tuple[Number, Number, Number, Number] | None = None
    roll_pitch_yaw_degrees: Triple | None = None

    @model_validator(mode="after")
    def _check(self) -> "_Camera":
        if (self.quaternion_xyzw is None) == (self.roll_pitch_yaw_degrees is None):
            raise ValueError("give exactly one of 'quaternion_xyzw' and 'roll_pitch_yaw_degrees'")
        if self.quaternion_xyzw is not None and abs(np.linalg.norm(self.quaternion_xyzw) - 1.0) > 1e-3:
            raise ValueError("'quaternion_xyzw' must have length 1")
        return self

    def mounted(self) -> MountedCamera:
        if self.quaternion_xyzw is not None:
            pose = pose_from_quaternion(self.quaternion_xyzw, self.position)
        else:
            angles = np.radians(cast(Triple, self.roll_pitch_yaw_degrees))
            pose = camera_pose_in_rig(self.position, *angles)
        return MountedCamera(self.lens.camera(*self.size), pose)


class _Vehicle(_Part):
    length: Positive
    width: Positive
    height: Positive
    rear_axle_to_bbox_center: Number
    wheelbase: Positive
    track_width: Positive


class _RigFile(_Part):
    name: Annotated[str, Field(min_length=1)]
    assumed: tuple[str, ...]
    vehicle: _Vehicle
    cameras: Annotated[dict[str, _Camera], Field(min_length=1)]
