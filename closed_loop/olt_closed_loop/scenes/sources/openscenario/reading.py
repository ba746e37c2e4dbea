"""Scenarios of OpenSCENARIO as scenes: carried out once, and what happened is the recording.

The ego's own way is that of the scenario without its controller: it keeps its speed and lane unless the story says
otherwise. Nobody brakes for anybody, so the recorded drive may hit something; the gate says so.
"""

from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.scenes.sources.assembly import RecordedDrive, assemble_scene
from olt_closed_loop.scenes.sources.opendrive import RoadNetwork, read_road_network
from olt_closed_loop.scenes.sources.openscenario.entities import ROOT, Catalogues, Entity, beside, read_entity
from olt_closed_loop.scenes.sources.openscenario.motion import Mover, Roads
from olt_closed_loop.scenes.sources.openscenario.parameters import declared, resolve
from olt_closed_loop.scenes.sources.openscenario.storyboard import Storyboard
from olt_closed_loop.scenes.sources.openscenario.world import STEP, World
from olt_closed_loop.scenes.sources.tracks import Track
from olt_closed_loop.scenes.sources.xml_files import child, read_xml, text_of
from olt_generator.errors import InputError
from olt_generator.poses import Array, planar_pose
from olt_generator.trajectory import Trajectory
from olt_toolkit.rigs.rig import VehicleDimensions

MOST_SECONDS = 120.0
MOST_ENTITIES = 200
_RECORD_EVERY = 2
_EGO_NAMES = ("ego", "host", "hero", "egovehicle", "ego_vehicle")


def read_openscenario(path: Path, ego: str | None = None) -> Scene:
    """Carry out one scenario and make a scene of it.

    It lasts until its stop trigger holds, the ego's lanes end, or MOST_SECONDS are over.

    Args:
        path: the `.xosc` file; the road network and catalogues that it names lie beside it.
        ego: name of the entity that is the ego; by default the one called Ego.

    Raises:
        InputError: the file is no scenario, or uses what is not read; it is named.
    """
    root = read_xml(path, "OpenSCENARIO scenario", ROOT)
    try:
        return _read(path, root, ego)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _read(path: Path, root: Element, ego: str | None) -> Scene:
    distribution = root.find("ParameterValueDistribution")
    if distribution is not None:
        named = distribution.find("ScenarioFile")
        file = "" if named is None else named.get("filepath", "")
        raise InputError(f"a distribution of parameters, not a scenario; give what it varies ({file:.200})")
    if root.find("Catalog") is not None:
        raise InputError("a catalogue, not a scenario; give a scenario that uses it")
    resolved = resolve(root, declared(root, {}))
    logic = child(child(resolved, "RoadNetwork", ROOT), "LogicFile", "RoadNetwork")
    roads = beside(path, text_of(logic, "filepath", "LogicFile"))
    if roads.suffix != ".xodr":
        raise InputError(f"LogicFile {roads.name:.80} is no OpenDRIVE file (.xodr)")
    network = read_road_network(roads)
    catalogues = Catalogues(path, resolved.find("CatalogLocations"))
    objects = child(resolved, "Entities", ROOT).findall("ScenarioObject")
    if len(objects) > MOST_ENTITIES:
        raise InputError(f"{len(objects)} entities; up to {MOST_ENTITIES} are read")
    entities = [read_entity(one, catalogues) for one in objects]
    world = World(Roads(network), catalogues, {one.name: Mover(one, Roads(network)) for one in entities})
    if len(world.movers) < len(entities):
        raise InputError("two entities of one name")
    driver, vehicle = _find_ego(entities, ego)
    storyboard = Storyboard(child(resolved, "Storyboard", ROOT), world)
    tracks, ending = _carry_out(storyboard, world, driver.name)
    return assemble_scene(_drive(path, network, entities, driver, vehicle, tracks, ending))


def _find_ego(entities: list[Entity], name: str | None) -> tuple[Entity, VehicleDimensions]:
    wanted = (name.lower(),) if name is not None else _EGO_NAMES
    for entity in entities:
        if entity.name.lower() in wanted and entity.vehicle is not None:
            return entity, entity.vehicle
    known = ", ".join(entity.name for entity in entities if entity.vehicle is not None)
    raise InputError(f"no vehicle is called {name or 'Ego'}; vehicles are {known:.200}; say which is the ego")


def _carry_out(storyboard: Storyboard, world: World, driver: str) -> tuple[dict[str, Array], str]:
    """Time, x, y and heading (n, 4) of every road user while it was there, and how the scenario ended."""
    rows: dict[str, list[tuple[float, float, float, float]]] = {name: [] for name in world.movers}
    present = [mover for mover in world.movers.values() if mover.place is not None]
    ending = f"it was ended after {MOST_SECONDS:g} s"
    for step in range(round(MOST_SECONDS / STEP) + 1):
        world.step = step
        if step % _RECORD_EVERY == 0:
            for mover in present:
                pose = mover.pose
                rows[mover.entity.name].append((world.time, pose.x, pose.y, pose.heading))
        if not storyboard.advance():
            ending = "it ended by its own stop trigger"
            break
        gone = [mover for mover in present if not mover.move(STEP)]
        present = [mover for mover in world.movers.values() if mover.place is not None]
        if any(mover.entity.name == driver for mover in gone):
            ending = "it was ended where the ego's lanes end"
            break
    return {name: np.array(known) for name, known in rows.items() if known}, ending


def _drive(
    path: Path,
    network: RoadNetwork,
    entities: list[Entity],
    driver: Entity,
    vehicle: VehicleDimensions,
    tracks: dict[str, Array],
    ending: str,
) -> RecordedDrive:
    if driver.name not in tracks:
        raise InputError(f"entity {driver.name:.60} is the ego and is put nowhere")
    lanes, areas = network.lanes()
    controlled = ", ".join(f"{one.name} ({one.controller})" for one in entities if one.controller)
    notes = [
        f"a scenario that was written, not recorded; {ending}",
        "everybody follows the story, and else keeps lane and speed; nobody brakes for anybody",
        f"controllers are not carried out: {controlled:.200}" if controlled else "",
        *network.notes,
    ]
    times, x, y, heading = tracks[driver.name].T
    return RecordedDrive(
        name=f"openscenario_{path.stem}",
        vehicle=vehicle,
        ego=Trajectory(_microseconds(times), planar_pose(x, y, heading)),
        agents=[_agent(one, tracks[one.name]) for one in entities if one is not driver and one.name in tracks],
        lanes=lanes,
        areas=areas,
        assumptions=tuple(note for note in notes if note),
    )


def _agent(entity: Entity, track: Array) -> Track:
    times, x, y, heading = track.T
    cos, sin = np.cos(heading), np.sin(heading)
    poses = np.column_stack(
        [
            x + cos * entity.ahead - sin * entity.left,
            y + sin * entity.ahead + cos * entity.left,
            np.full(len(x), 0.5 * entity.height),
            heading,
        ]
    )
    return Track(entity.name, entity.label, entity.length, entity.width, entity.height, _microseconds(times), poses)


def _microseconds(seconds: Array) -> np.ndarray:
    return np.round(seconds * 1e6).astype(np.int64)
