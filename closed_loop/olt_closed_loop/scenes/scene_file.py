"""Scene files: a scene as an OpenUSD stage.

    /World            name, category, factors, assumptions
    /World/Road       lanes, edges, drivable, route: polylines; stop lines, crossings and lights where there are any
    /World/Ego        recorded motion of the rig, size of the vehicle
    /World/Hills      height of the ground; missing where it is level
    /World/Agents/*   label, size and recorded motion of each agent
    /World/Looks      payload: the file beside it that holds what only rendering needs

`read_scene` leaves the payload alone, so nothing of it is opened, parsed or kept unless a renderer asks. Values of ours
are custom attributes in the namespace `olt:` and keep double precision; USD's own schemas hold points in single
precision, so those are written for viewers and never read back.
"""

# pxr is compiled and has no type stubs: this module and `scenes.layers` are the ones that touch it.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, Vt

from olt_closed_loop.scenes.layers import open_layer, payload_beside
from olt_closed_loop.scenes.looks import Looks, SceneryBox, generate_looks
from olt_closed_loop.scenes.maps.attributes import (
    LANE_OPTIONS,
    Value,
    crossing_of,
    crossing_values,
    lane_of,
    lane_values,
    light_of,
    light_values,
    stop_line_of,
    stop_line_values,
)
from olt_closed_loop.scenes.scene import Agent, Hills, Scene
from olt_closed_loop.scenes.scene_checks import check_scene
from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_generator.poses import Array
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig import VehicleDimensions

Prim: TypeAlias = Any
"""A `pxr.Usd.Prim`."""
Part = TypeVar("Part")

# Time codes are microseconds, which a double holds exactly for 285 years.
TIME_CODES_PER_SECOND = 1e6
_LATEST_US = 2.0**53
_LOOKS = "/World/Looks"
_TEXTS = ("name", "category", "factors", "assumptions")
_COLORS = ("zenith", "horizon", "grass", "gravel", "asphalt", "paint")

Triple = tuple[float, float, float]


def write_scene(scene: Scene, path: Path) -> Path:
    """Write a scene to `path` (.usda or .usdc) and its looks to `<stem>.looks` beside it; returns `path`."""
    looks = generate_looks(scene) if scene.looks is None else read_looks(Path(scene.looks))
    looks_path = path.with_name(f"{path.stem}.looks{path.suffix}")
    stage = _new_stage("/World")
    _write(stage.GetPrimAtPath("/World"), **{name: getattr(scene, name) for name in _TEXTS})
    _write_road(stage, scene)
    _write_ego(stage, scene)
    if scene.hills is not None:
        _write(stage.DefinePrim("/World/Hills"), **vars(scene.hills))
    UsdGeom.Scope.Define(stage, "/World/Agents")
    for index, agent in enumerate(scene.agents):
        # The prim's name is only a number, because ids of recorded data need not be valid prim names.
        _write_agent(stage, f"/World/Agents/agent_{index:03d}", agent)
    stage.DefinePrim(_LOOKS).GetPayloads().AddPayload(f"./{looks_path.name}")
    _write_looks(looks, looks_path)
    _save(stage, path)
    return path


def _write_road(stage: Any, scene: Scene) -> None:
    for place in ("/World/Road", "/World/Road/Lanes", "/World/Road/Edges", "/World/Road/Drivable"):
        UsdGeom.Scope.Define(stage, place)
    for index, lane in enumerate(scene.lanes):
        _write_line(stage, f"Lanes/lane_{index:03d}", lane.center, **lane_values(lane))
    for place, lines in (("Edges/edge", scene.road_edges), ("Drivable/outline", scene.drivable)):
        for index, line in enumerate(lines):
            _write_line(stage, f"{place}_{index:03d}", line, points=line)
    _write_line(stage, "Route", scene.route, points=scene.route)
    for index, line in enumerate(scene.stop_lines):
        _write_line(stage, f"StopLines/line_{index:03d}", line.points, **stop_line_values(line))
    for index, place in enumerate(scene.crossings):
        _write_line(stage, f"Crossings/crossing_{index:03d}", place.outline, **crossing_values(place))
    for index, light in enumerate(scene.lights):
        _write(stage.DefinePrim(f"/World/Road/Lights/light_{index:03d}"), **light_values(light))


def _write_line(stage: Any, place: str, line: Array, **values: Value) -> None:
    """A polyline (n, 3) of the road for viewers, and what is read of it."""
    curve = UsdGeom.BasisCurves.Define(stage, f"/World/Road/{place}")
    curve.CreateTypeAttr(UsdGeom.Tokens.linear)
    curve.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(line, dtype=np.float32)))
    curve.CreateCurveVertexCountsAttr([len(line)])
    _write(curve.GetPrim(), **values)


def _write_ego(stage: Any, scene: Scene) -> None:
    vehicle, body = scene.vehicle, UsdGeom.Xform.Define(stage, "/World/Ego")
    motion = body.AddTransformOp()
    for time_us, pose in zip(scene.ego.timestamps_us.tolist(), scene.ego.T_world_rig, strict=True):
        motion.Set(Gf.Matrix4d(pose.T), time_us)  # USD multiplies row vectors
    _write(body.GetPrim(), **{name: float(value) for name, value in asdict(vehicle).items()})
    center = (vehicle.rear_axle_to_bbox_center, 0.0, vehicle.height / 2)
    _write_box(stage, "/World/Ego/Box", (vehicle.length, vehicle.width, vehicle.height), center)


def _write_agent(stage: Any, place: str, agent: Agent) -> None:
    body = UsdGeom.Xform.Define(stage, place)
    position = body.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble)
    turn = body.AddRotateZOp(UsdGeom.XformOp.PrecisionDouble)
    for time_us, (x, y, z, yaw) in zip(agent.timestamps_us.tolist(), agent.poses.tolist(), strict=True):
        position.Set(Gf.Vec3d(x, y, z), time_us)
        turn.Set(float(np.degrees(yaw)), time_us)
    size = (float(agent.length), float(agent.width), float(agent.height))
    _write(body.GetPrim(), id=agent.id, label=agent.label, length=size[0], width=size[1], height=size[2])
    _write_box(stage, f"{place}/Box", size, (0.0, 0.0, 0.0))


def _write_looks(looks: Looks, path: Path) -> None:
    def rows(triples: Iterable[Triple]) -> Array:
        return np.array(list(triples), dtype=np.float64).reshape(-1, 3)

    stage = _new_stage("/Looks")
    _write(
        stage.GetPrimAtPath("/Looks"),
        texture_seed=looks.texture_seed,
        cloudiness=looks.cloudiness,
        sun_direction=np.array(looks.sun_direction),
        colors=rows(getattr(looks, name) for name in _COLORS),
        agent_ids=tuple(looks.agent_colors),
        agent_colors=rows(looks.agent_colors.values()),
        scenery_kind=tuple(box.kind for box in looks.scenery),
        scenery_yaw=np.array([box.yaw for box in looks.scenery]),
        scenery_center=rows(box.center for box in looks.scenery),
        scenery_size=rows(box.size for box in looks.scenery),
        scenery_color=rows(box.color for box in looks.scenery),
    )
    _save(stage, path)


def _new_stage(root: str) -> Any:
    """An empty stage in metres, z up, microseconds, whose default prim is `root`; payloads stay unloaded."""
    stage = Usd.Stage.CreateInMemory(Usd.Stage.LoadNone)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.SetTimeCodesPerSecond(TIME_CODES_PER_SECOND)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, root).GetPrim())
    return stage


def _save(stage: Any, path: Path) -> None:
    with write_whole(path) as temporary:
        stage.GetRootLayer().Export(str(temporary))


def _write(prim: Prim, **values: Value) -> None:
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


def _write_box(stage: Any, place: str, size: Triple, center: Triple) -> None:
    """A box of the given size (length, width, height) in metres around `center`, for viewers."""
    cube = UsdGeom.Cube.Define(stage, place)
    cube.CreateSizeAttr(1.0)
    cube.AddTranslateOp().Set(Gf.Vec3d(*center))
    cube.AddScaleOp().Set(Gf.Vec3f(*size))


def read_scene(path: Path) -> Scene:
    """Read a scene without its looks.

    Raises:
        InputError: the file is not a scene file, is damaged, lacks a prim or attribute, points to other files or prims
            (`scenes.layers`), or holds what no scene can (`scenes.scene_checks`).
    """
    with _refusing_damage(path):
        scene = _read_scene(path)
        try:
            check_scene(scene)
        except InputError as error:
            raise InputError(f"{path}: {error}") from error
        return scene


def _read_scene(path: Path) -> Scene:
    reader = _Reader(path)
    world, ego = reader.prim("/World"), reader.prim("/World/Ego")
    sizes = [field.name for field in fields(VehicleDimensions)]
    times_us, matrices = reader.samples(ego, "xformOp:transform")
    edges, outlines = (
        tuple(reader.values(prim, "points")[0] for prim in reader.children(f"/World/Road/{place}"))
        for place in ("Edges", "Drivable")
    )
    return Scene(
        **dict(zip(_TEXTS, reader.values(world, *_TEXTS), strict=True)),
        vehicle=VehicleDimensions(*reader.values(ego, *sizes)),
        ego=Trajectory(times_us, np.swapaxes(matrices, 1, 2)),
        agents=tuple(reader.agent(prim) for prim in reader.children("/World/Agents")),
        lanes=reader.parts("Lanes", lane_of, "id center left right successors", LANE_OPTIONS),
        road_edges=edges,
        drivable=outlines,
        route=reader.values(reader.prim("/World/Road/Route"), "points")[0],
        looks=str(path),
        hills=reader.hills(),
        stop_lines=reader.parts("StopLines", stop_line_of, "id points lanes", ("control",)),
        crossings=reader.parts("Crossings", crossing_of, "id outline lanes", ("zebra",)),
        lights=reader.parts("Lights", light_of, "id lanes timestamps_us states", ("position",)),
    )


def read_looks(path: Path) -> Looks:
    """Read the looks of the scene at `path` by loading the payload of its scene file.

    Raises:
        InputError: the file is not a scene file, or the payload is missing, damaged or lacks an attribute.
    """
    with _refusing_damage(path):
        return _read_looks(path)


def _read_looks(path: Path) -> Looks:
    reader = _Reader(path, with_payloads=True)
    prim = reader.prim(_LOOKS)

    def triples(*names: str) -> list[list[Triple]]:
        return [[(x, y, z) for x, y, z in rows.tolist()] for rows in reader.values(prim, *names)]

    sun, texture_seed, cloudiness = reader.values(prim, "sun_direction", "texture_seed", "cloudiness")
    agents, kinds, yaws = reader.values(prim, "agent_ids", "scenery_kind", "scenery_yaw")
    colors, agent_colors = triples("colors", "agent_colors")
    centers, sizes, box_colors = triples("scenery_center", "scenery_size", "scenery_color")
    boxes = zip(kinds, centers, sizes, yaws.tolist(), box_colors, strict=True)
    return Looks(
        texture_seed=int(texture_seed),
        sun_direction=tuple(sun.tolist()),
        cloudiness=float(cloudiness),
        agent_colors=dict(zip(agents, agent_colors, strict=True)),
        scenery=tuple(SceneryBox(*box) for box in boxes),
        **dict(zip(_COLORS, colors, strict=True)),
    )


@contextmanager
def _refusing_damage(path: Path) -> Iterator[None]:
    """Turn what USD tells of a damaged file, and values of another kind than a scene has, into an `InputError`."""
    try:
        yield
    except (Tf.ErrorException, AttributeError, IndexError, OverflowError, TypeError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: damaged, or no scene ({reason:.300}); write the scene again") from error


class _Reader:
    """Reads prims of one scene file; every complaint is an `InputError` that names the file and the prim."""

    def __init__(self, path: Path, with_payloads: bool = False) -> None:
        layer = open_layer(path, payload_at=_LOOKS)
        if with_payloads:
            open_layer(payload_beside(layer, _LOOKS, path))
        stage = Usd.Stage.Open(layer, Usd.Stage.LoadAll if with_payloads else Usd.Stage.LoadNone)
        found = (UsdGeom.GetStageMetersPerUnit(stage), UsdGeom.GetStageUpAxis(stage), stage.GetTimeCodesPerSecond())
        if found != (1.0, UsdGeom.Tokens.z, TIME_CODES_PER_SECOND):
            raise InputError(
                f"{path}: metersPerUnit, upAxis and timeCodesPerSecond are {found[0]:g}, {found[1]}, {found[2]:g}; "
                f"a scene has 1, Z, {TIME_CODES_PER_SECOND:.0f}"
            )
        self.path, self.stage = path, stage

    def prim(self, place: str) -> Prim:
        prim = self.stage.GetPrimAtPath(place)
        if not prim:
            raise InputError(f"{self.path}: prim {place} is missing; write the scene again")
        return prim

    def children(self, place: str) -> list[Prim]:
        return list(self.prim(place).GetChildren())

    def attribute(self, prim: Prim, name: str) -> Any:
        attribute = prim.GetAttribute(name)
        if not attribute or not attribute.HasAuthoredValue():
            raise InputError(f"{self.path}: prim {prim.GetPath()} lacks attribute {name}; write the scene again")
        return attribute

    def values(self, prim: Prim, *names: str) -> list[Any]:
        """What `_write` wrote: texts, numbers, tuples of texts, and arrays (n,) or (n, 3) of doubles."""
        found = [self.attribute(prim, f"olt:{name}").Get() for name in names]
        kinds = {
            Vt.StringArray: lambda texts: tuple(map(str, texts)),
            Vt.DoubleArray: np.array,
            Vt.Vec3dArray: np.array,
        }
        values = [kinds[type(value)](value) if type(value) in kinds else value for value in found]
        for name, value in zip(names, values, strict=True):
            if isinstance(value, np.ndarray | float) and not np.isfinite(value).all():
                raise InputError(f"{self.path}: attribute {name} of prim {prim.GetPath()} is not finite")
        return values

    def samples(self, prim: Prim, name: str) -> tuple[NDArray[np.int64], Array]:
        """Times (n,) in microseconds and values (n, ...) of an animated attribute."""
        attribute = self.attribute(prim, name)
        times = attribute.GetTimeSamples()
        if not times:
            raise InputError(f"{self.path}: attribute {name} of prim {prim.GetPath()} has no time samples")
        if not all(-_LATEST_US <= time <= _LATEST_US and time == int(time) for time in times):
            raise InputError(
                f"{self.path}: attribute {name} of prim {prim.GetPath()} has times that are no microseconds"
            )
        values = np.array([attribute.Get(time) for time in times], dtype=np.float64)
        if not np.isfinite(values).all():
            raise InputError(f"{self.path}: attribute {name} of prim {prim.GetPath()} is not finite")
        return np.array(times, dtype=np.int64), values

    def parts(
        self, place: str, make: Callable[[dict[str, Any]], Part], names: str, options: tuple[str, ...]
    ) -> tuple[Part, ...]:
        """Parts of the road at a place, of values that each has and of those that it may have."""
        parent = self.stage.GetPrimAtPath(f"/World/Road/{place}")
        if not parent:
            return ()
        found = []
        for prim in parent.GetChildren():
            given = [name for name in options if prim.GetAttribute(f"olt:{name}").HasAuthoredValue()]
            known = [*names.split(), *given]
            try:
                found.append(make(dict(zip(known, self.values(prim, *known), strict=True))))
            except InputError as error:
                raise InputError(f"{self.path}: prim {prim.GetPath()}: {error}; write the scene again") from error
        return tuple(found)

    def hills(self) -> Hills | None:
        prim = self.stage.GetPrimAtPath("/World/Hills")
        return Hills(*self.values(prim, *(field.name for field in fields(Hills)))) if prim else None

    def agent(self, prim: Prim) -> Agent:
        times_us, positions = self.samples(prim, "xformOp:translate")
        turn_times_us, turns = self.samples(prim, "xformOp:rotateZ")
        if not np.array_equal(times_us, turn_times_us):
            raise InputError(f"{self.path}: prim {prim.GetPath()} has position and turn at different times")
        poses = np.concatenate([positions, np.radians(turns)[:, None]], axis=1)
        described = self.values(prim, "id", "label", "length", "width", "height")
        return Agent(*described, timestamps_us=times_us, poses=poses)
