"""The few things that are read from and written to scene files in OpenUSD, typed, and checked where they are read.

Values of ours are custom attributes in the namespace `olt:` and keep double precision; USD's own schemas hold points in
single precision, so those are written for viewers and never read back.
"""

# pxr is compiled and has no type stubs: this is the one module that touches it.
# pyright: reportAttributeAccessIssue=false

from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, Vt

from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_generator.poses import Array

Stage: TypeAlias = Any
"""A `pxr.Usd.Stage`."""

Prim: TypeAlias = Any
"""A `pxr.Usd.Prim`."""

# Time codes are microseconds, which a double holds exactly for 285 years.
TIME_CODES_PER_SECOND = 1e6


def new_stage(root: str) -> Stage:
    """An empty stage in metres, z up, microseconds, whose default prim is `root`; payloads stay unloaded."""
    stage = Usd.Stage.CreateInMemory(Usd.Stage.LoadNone)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.SetTimeCodesPerSecond(TIME_CODES_PER_SECOND)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, root).GetPrim())
    return stage


def save_stage(stage: Stage, path: Path) -> None:
    """Write the stage's root layer as one whole file; .usda is text, .usdc binary."""
    with write_whole(path) as temporary:
        stage.GetRootLayer().Export(str(temporary))


class Reader:
    """Reads prims of one scene file; every complaint names the file and the prim.

    Raises:
        InputError: the file is missing, is not a stage, or not one that `new_stage` could have begun.
    """

    def __init__(self, path: Path, with_payloads: bool = False) -> None:
        if not path.is_file():
            raise InputError(f"{path}: no such file; give the .usda or .usdc file of a scene")
        try:
            stage = Usd.Stage.Open(str(path), Usd.Stage.LoadAll if with_payloads else Usd.Stage.LoadNone)
        except Tf.ErrorException as error:
            raise InputError(f"{path}: not a USD stage; give the .usda or .usdc file of a scene") from error
        found = (UsdGeom.GetStageMetersPerUnit(stage), UsdGeom.GetStageUpAxis(stage), stage.GetTimeCodesPerSecond())
        if found != (1.0, UsdGeom.Tokens.z, TIME_CODES_PER_SECOND):
            raise InputError(
                f"{path}: metersPerUnit, upAxis and timeCodesPerSecond are {found[0]:g}, {found[1]}, {found[2]:g}; "
                f"a scene has 1, Z, {TIME_CODES_PER_SECOND:.0f}"
            )
        self.path, self.stage = path, stage

    def prim(self, place: str) -> Prim:
        """The prim at an absolute path.

        Raises:
            InputError: there is none.
        """
        prim = self.stage.GetPrimAtPath(place)
        if not prim:
            raise InputError(f"{self.path}: prim {place} is missing; write the scene again")
        return prim

    def children(self, place: str) -> list[Prim]:
        """The prims below a place, in order."""
        return list(self.prim(place).GetChildren())

    def attribute(self, prim: Prim, name: str) -> Any:
        """An attribute that has a value.

        Raises:
            InputError: it is missing or empty.
        """
        attribute = prim.GetAttribute(name)
        if not attribute or not attribute.HasAuthoredValue():
            raise InputError(f"{self.path}: prim {prim.GetPath()} lacks attribute {name}; write the scene again")
        return attribute

    def values(self, prim: Prim, *names: str) -> list[Any]:
        """The values of some of our attributes."""
        return [self.attribute(prim, f"olt:{name}").Get() for name in names]

    def texts(self, prim: Prim, name: str) -> tuple[str, ...]:
        """A list of texts."""
        (value,) = self.values(prim, name)
        return tuple(str(text) for text in value)

    def trajectory(self, prim: Prim) -> tuple[NDArray[np.int64], Array]:
        """Times (n,) and poses (n, 4, 4) of what `write_trajectory` wrote."""
        timestamps_us, matrices = self.samples(prim, "xformOp:transform")
        return timestamps_us, np.swapaxes(matrices, 1, 2)

    def upright_motion(self, prim: Prim) -> tuple[NDArray[np.int64], Array]:
        """Times (n,) and poses (n, 4) of what `write_upright_motion` wrote.

        Raises:
            InputError: position and turn are not sampled at the same times.
        """
        timestamps_us, positions = self.samples(prim, "xformOp:translate")
        turn_times, turns = self.samples(prim, "xformOp:rotateZ")
        if not np.array_equal(timestamps_us, turn_times):
            raise InputError(f"{self.path}: prim {prim.GetPath()} has position and turn at different times")
        return timestamps_us, np.concatenate([positions, np.radians(turns)[:, None]], axis=1)

    def arrays(self, prim: Prim, *names: str) -> list[Array]:
        """Arrays (n,) or (n, 3) of doubles."""
        return [np.array(value, dtype=np.float64) for value in self.values(prim, *names)]

    def samples(self, prim: Prim, name: str) -> tuple[NDArray[np.int64], Array]:
        """Times (n,) in microseconds and values (n, ...) of an animated attribute.

        Raises:
            InputError: the attribute is missing or has no samples.
        """
        attribute = self.attribute(prim, name)
        times = attribute.GetTimeSamples()
        if not times:
            raise InputError(f"{self.path}: attribute {name} of prim {prim.GetPath()} has no time samples")
        return np.array(times, dtype=np.int64), np.array([attribute.Get(time) for time in times], dtype=np.float64)


def write_values(prim: Prim, **values: str | int | float | tuple[str, ...] | Array) -> None:
    """Write texts, numbers, lists of texts, and arrays (n,) or (n, 3) of doubles as attributes of ours."""
    kinds = {str: Sdf.ValueTypeNames.String, int: Sdf.ValueTypeNames.Int64, float: Sdf.ValueTypeNames.Double}
    for name, value in values.items():
        if isinstance(value, tuple):
            kind, content = Sdf.ValueTypeNames.StringArray, Vt.StringArray(list(value))
        elif isinstance(value, np.ndarray):
            rows = np.ascontiguousarray(value, dtype=np.float64)
            if rows.ndim == 1:
                kind, content = Sdf.ValueTypeNames.DoubleArray, Vt.DoubleArray.FromNumpy(rows)
            else:
                kind, content = Sdf.ValueTypeNames.Double3Array, Vt.Vec3dArray.FromNumpy(rows)
        else:
            kind, content = kinds[type(value)], value
        prim.CreateAttribute(f"olt:{name}", kind, custom=True).Set(content)


def write_group(stage: Stage, place: str) -> None:
    """Define a prim that only holds others."""
    UsdGeom.Scope.Define(stage, place)


def write_payload(stage: Stage, place: str, file_name: str) -> None:
    """Define a prim whose content is the default prim of a file in the same folder."""
    stage.DefinePrim(place).GetPayloads().AddPayload(f"./{file_name}")


def write_curve(stage: Stage, place: str, points: Array) -> Prim:
    """Define a polyline (n, 3) for viewers; returns its prim."""
    curve = UsdGeom.BasisCurves.Define(stage, place)
    curve.CreateTypeAttr(UsdGeom.Tokens.linear)
    curve.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(points, dtype=np.float32)))
    curve.CreateCurveVertexCountsAttr([len(points)])
    return curve.GetPrim()


def write_trajectory(stage: Stage, place: str, timestamps_us: NDArray[np.int64], poses: Array) -> Prim:
    """Define a body that moves by poses (n, 4, 4); returns its prim."""
    body = UsdGeom.Xform.Define(stage, place)
    motion = body.AddTransformOp()
    for time_us, pose in zip(timestamps_us.tolist(), poses, strict=True):
        motion.Set(Gf.Matrix4d(pose.T), time_us)  # USD multiplies row vectors
    return body.GetPrim()


def write_upright_motion(stage: Stage, place: str, timestamps_us: NDArray[np.int64], poses: Array) -> Prim:
    """Define a body that moves by poses (n, 4) x, y, z, yaw; returns its prim."""
    body = UsdGeom.Xform.Define(stage, place)
    position = body.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble)
    turn = body.AddRotateZOp(UsdGeom.XformOp.PrecisionDouble)
    for time_us, (x, y, z, yaw) in zip(timestamps_us.tolist(), poses.tolist(), strict=True):
        position.Set(Gf.Vec3d(x, y, z), time_us)
        turn.Set(float(np.degrees(yaw)), time_us)
    return body.GetPrim()


def write_box(stage: Stage, place: str, size: tuple[float, float, float], center: tuple[float, float, float]) -> None:
    """Define a box of the given size (length, width, height) around `center`, for viewers."""
    cube = UsdGeom.Cube.Define(stage, place)
    cube.CreateSizeAttr(1.0)
    cube.AddTranslateOp().Set(Gf.Vec3d(*center))
    cube.AddScaleOp().Set(Gf.Vec3f(*size))
