"""Road users of OpenSCENARIO: their boxes, from the scenario or from its catalogues."""

from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from xml.etree.ElementTree import Element

from olt_closed_loop.scenes.sources.openscenario.parameters import declared, resolve
from olt_closed_loop.scenes.sources.tracks import LARGEST_BOX
from olt_closed_loop.scenes.sources.xml_files import child, number_of, read_xml, text_of
from olt_generator.errors import InputError
from olt_toolkit.rigs.rig import VehicleDimensions

ROOT = "OpenSCENARIO"
_MOST_CATALOGUES = 100
_LABELS = {
    "car": "automobile",
    "van": "automobile",
    "truck": "heavy_truck",
    "semitrailer": "trailer",
    "trailer": "trailer",
    "bus": "bus",
    "motorbike": "rider",
    "bicycle": "rider",
    "train": "train_or_tram_car",
    "tram": "train_or_tram_car",
    "pedestrian": "person",
    "wheelchair": "person",
    "animal": "animal",
    "obstacle": "protruding_object",
    "barrier": "barrier",
    "pole": "protruding_object",
}
_CATEGORIES = {
    "Vehicle": "vehicleCategory",
    "Pedestrian": "pedestrianCategory",
    "MiscObject": "miscObjectCategory",
}


@dataclass(frozen=True)
class Entity:
    """A road user: its box, whose middle is `ahead` metres before and `left` metres beside its reference point.

    Attributes:
        name, label: as in a scene.
        length, width, height: metres.
        ahead, left: metres.
        axles: wheelbase and track width; None for what has no axles.
        controller: name of what is meant to drive it, None if the story alone moves it.
    """

    name: str
    label: str
    length: float
    width: float
    height: float
    ahead: float
    left: float
    axles: tuple[float, float] | None
    controller: str | None

    @property
    def vehicle(self) -> VehicleDimensions | None:
        """Its size as an ego, whose reference point is its rear axle; None if it has no axles."""
        if self.axles is None:
            return None
        wheelbase, track = self.axles
        return VehicleDimensions(self.length, self.width, self.height, self.ahead, wheelbase, track)

    @property
    def front(self) -> float:
        """How far it reaches before its reference point, metres."""
        return self.ahead + 0.5 * self.length

    @property
    def rear(self) -> float:
        """How far it reaches behind its reference point, metres."""
        return 0.5 * self.length - self.ahead


class Catalogues:
    """The catalogues of a scenario."""

    def __init__(self, path: Path, locations: Element | None) -> None:
        """Of the scenario at `path`, whose resolved `CatalogLocations` are given."""
        folders = locations.findall("*/Directory") if locations is not None else []
        self._folders = [beside(path, text_of(one, "path", "Directory")) for one in folders]

    def entry(self, reference: Element) -> Element:
        """The resolved element that a `CatalogReference` means.

        Raises:
            InputError: there is no such entry, or a catalogue is damaged.
        """
        catalogue, name = (text_of(reference, one, "CatalogReference") for one in ("catalogName", "entryName"))
        given = {
            text_of(one, "parameterRef", "ParameterAssignment"): text_of(one, "value", "ParameterAssignment")
            for one in reference.findall("ParameterAssignments/ParameterAssignment")
        }
        for folder in self._folders:
            for path in sorted(folder.glob("*.xosc"))[:_MOST_CATALOGUES]:
                root = read_xml(path, "OpenSCENARIO catalogue", ROOT)
                found = root.find("Catalog")
                if found is None or found.get("name") != catalogue:
                    continue
                for element in found:
                    if element.get("name") == name:
                        return _resolve_entry(element, given)
        raise InputError(f"catalogue {catalogue:.60} has no entry {name:.60} in the folders that the scenario names")


def _resolve_entry(element: Element, given: dict[str, str]) -> Element:
    """An entry with its declared parameters, of which some are given."""
    values = {**declared(element, {}), **given}
    copy = Element(element.tag, element.attrib)
    copy.extend([part for part in element if part.tag != "ParameterDeclarations"])
    return resolve(copy, values)


def beside(path: Path, name: str) -> Path:
    """A path that a scenario file names, from its folder on; an `InputError` for an absolute one."""
    named = PurePosixPath(name)
    if named.is_absolute() or "\0" in name or "\\" in name or ":" in name or len(name) > 500:
        raise InputError(f"path {name!r:.80} is not relative to the scenario; give one that is")
    return path.parent / named


def read_entity(element: Element, catalogues: Catalogues) -> Entity:
    """A `ScenarioObject` (resolved).

    Raises:
        InputError: it is of a kind that is not read, or its box has no size.
    """
    name = text_of(element, "name", "ScenarioObject")
    where = f"entity {name:.60}"
    kinds = [part for part in element if part.tag != "ObjectController"]
    if len(kinds) != 1:
        raise InputError(f"{where}: {len(kinds)} descriptions; one is expected")
    described = catalogues.entry(kinds[0]) if kinds[0].tag == "CatalogReference" else kinds[0]
    if described.tag not in _CATEGORIES:
        raise InputError(f"{where}: <{described.tag:.60}> is not read; {', '.join(_CATEGORIES)} are")
    category = text_of(described, _CATEGORIES[described.tag], where)
    if category not in _LABELS:
        raise InputError(f"{where}: category {category:.60} is not known")
    box = child(described, "BoundingBox", where)
    center, sides = child(box, "Center", where), child(box, "Dimensions", where)
    length, width, height = (number_of(sides, side, where) for side in ("length", "width", "height"))
    ahead, left = number_of(center, "x", where), number_of(center, "y", where)
    if not all(0.0 < side <= LARGEST_BOX for side in (length, width, height)) or max(abs(ahead), abs(left)) > length:
        raise InputError(f"{where}: a box of {length:g} x {width:g} x {height:g} m around ({ahead:g}, {left:g})")
    axles = _read_axles(described, where) if described.tag == "Vehicle" else None
    controller = element.find("ObjectController/*")
    return Entity(
        name,
        _LABELS[category],
        length,
        width,
        height,
        ahead - (axles[2] if axles else 0.0),
        left,
        axles[:2] if axles else None,
        None if controller is None else controller.get("entryName", controller.get("name", "a controller")),
    )


def _read_axles(vehicle: Element, where: str) -> tuple[float, float, float]:
    """Wheelbase, track width, and the place of the rear axle."""
    front, rear = child(vehicle, "Axles/FrontAxle", where), child(vehicle, "Axles/RearAxle", where)
    place = number_of(rear, "positionX", where)
    wheelbase, track = number_of(front, "positionX", where) - place, number_of(rear, "trackWidth", where)
    if not (0.0 < wheelbase <= LARGEST_BOX and 0.0 <= track <= LARGEST_BOX):
        raise InputError(f"{where}: a wheelbase of {wheelbase:g} m and a track of {track:g} m")
    return wheelbase, track, place
