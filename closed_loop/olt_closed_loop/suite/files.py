"""Suites: which scenes are driven together, under which category, and how much each weighs.

    name: my_suite
    scenes:
      - {scene: longtail/closed_lane, weight: 2}
      - {scene: recordings/junction.usda, category: complex_intersection, factors: [weak_markings]}

A scene is the path of a scene file or of a recorded drive (beside the suite's file, if not absolute), CATEGORY:SEED, or
longtail/NAME. Weights are 1, and category and factors the scene's own, where the file does not say.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from olt_closed_loop.suite.catalogue import EVENTS, LONGTAIL, Entry, find_event
from olt_closed_loop.suite.scenes import PREFIX
from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_toolkit.runtime.yaml_files import read_yaml_mapping

KEYS, SCENE_KEYS = ("name", "scenes"), ("scene", "weight", "category", "factors")
MOST_SCENES = 10_000


@dataclass(frozen=True)
class SuiteScene:
    """One scene of a suite.

    Attributes:
        source: what `evaluation.evaluation.load_scene` loads.
        weight: how much it counts in weighted means, greater than 0.
        category: under which category it counts; None for the scene's own.
        factors: which factors hold; None for the scene's own.
    """

    source: str
    weight: float = 1.0
    category: str | None = None
    factors: tuple[str, ...] | None = None


@dataclass(frozen=True)
class Suite:
    """A named set of scenes."""

    name: str
    scenes: tuple[SuiteScene, ...]

    @property
    def sources(self) -> list[str]:
        """What the scenes are, in order."""
        return [scene.source for scene in self.scenes]


def built_in_suites() -> dict[str, Suite]:
    """The suites that need no file: the 53, each category by itself, and all that the catalogue has."""
    categories = dict.fromkeys(entry.category for entry in EVENTS.values())
    groups: dict[str, Sequence[str]] = {"longtail": LONGTAIL, "all": tuple(EVENTS)}
    groups |= {one: [name for name, entry in EVENTS.items() if entry.category == one] for one in categories}
    return {name: Suite(name, tuple(_scene_of(EVENTS[event]) for event in events)) for name, events in groups.items()}


def suite_of(events: Sequence[str], name: str) -> Suite:
    """A suite of events of the catalogue.

    Raises:
        InputError: one is not in the catalogue.
    """
    return Suite(name, tuple(_scene_of(find_event(event)) for event in events))


def _scene_of(entry: Entry) -> SuiteScene:
    return SuiteScene(f"{PREFIX}{entry.name}", 1.0, entry.category, entry.factors)


def find_suite(name: str) -> Suite:
    """A built-in suite, or the one of a YAML file.

    Raises:
        InputError: it is neither, or the file does not hold a suite.
    """
    known = built_in_suites()
    if name in known:
        return known[name]
    if Path(name).suffix not in (".yaml", ".yml"):
        raise InputError(f"suite {name!r}: give a YAML file, or one of {', '.join(known)}")
    return read_suite(Path(name))


def read_suite(path: Path) -> Suite:
    """Read a suite's file; the scenes themselves are not opened.

    Raises:
        InputError: it cannot be read, a key or value is not one of a suite, or a scene comes twice.
    """
    content = read_yaml_mapping(path, "suite", KEYS)
    _refuse_unknown(content, KEYS, f"{path}")
    name, scenes = content.get("name", path.stem), content.get("scenes")
    if not isinstance(name, str) or not name:
        raise InputError(f"{path}: name is {name!r}; give a text")
    if not isinstance(scenes, list) or not 0 < len(scenes) <= MOST_SCENES:
        raise InputError(f"{path}: scenes is a list of 1 to {MOST_SCENES} mappings with the key scene")
    read = tuple(_read_scene(scene, f"{path}: scene {index}", path.parent) for index, scene in enumerate(scenes))
    sources = [scene.source for scene in read]
    twice = next((source for source in sources if sources.count(source) > 1), None)
    if twice is not None:
        raise InputError(f"{path}: scene {twice} comes twice; give it a weight instead")
    return Suite(name, read)


def _read_scene(content: Any, where: str, folder: Path) -> SuiteScene:
    if not isinstance(content, dict):
        raise InputError(f"{where}: give a mapping with the keys {', '.join(SCENE_KEYS)}")
    _refuse_unknown(content, SCENE_KEYS, where)
    source, weight = content.get("scene"), content.get("weight", 1.0)
    category, factors = content.get("category"), content.get("factors")
    if not isinstance(source, str) or not source:
        raise InputError(f"{where}: scene is {source!r}; give a scene file, CATEGORY:SEED or {PREFIX}NAME")
    if isinstance(weight, bool) or not isinstance(weight, int | float) or not np.isfinite(weight) or weight <= 0.0:
        raise InputError(f"{where}: weight is {weight!r}; give a number greater than 0")
    if category is not None and (not isinstance(category, str) or not category):
        raise InputError(f"{where}: category is {category!r}; give a text, or leave it out")
    if factors is not None and not (isinstance(factors, list) and all(isinstance(one, str) for one in factors)):
        raise InputError(f"{where}: factors is {factors!r}; give a list of texts, or leave it out")
    if source.startswith(PREFIX):
        find_event(source.removeprefix(PREFIX).partition(":")[0])
    beside = folder / source
    return SuiteScene(
        str(beside) if beside.exists() else source,
        float(weight),
        category,
        None if factors is None else tuple(factors),
    )


def _refuse_unknown(content: dict[Any, Any], keys: Sequence[str], where: str) -> None:
    unknown = [str(key) for key in content if key not in keys]
    if unknown:
        raise InputError(f"{where}: key {unknown[0]!r} is not one of {', '.join(keys)}")


def write_suite(suite: Suite, path: Path) -> None:
    """Write a suite's file; scenes under its folder are named from there."""
    rows = []
    for scene in suite.scenes:
        source = Path(scene.source)
        inside = source.is_relative_to(path.parent)
        row: dict[str, Any] = {"scene": str(source.relative_to(path.parent)) if inside else scene.source}
        row |= {"weight": scene.weight}
        row |= {} if scene.category is None else {"category": scene.category}
        row |= {} if scene.factors is None else {"factors": list(scene.factors)}
        rows.append(row)
    text = yaml.safe_dump({"name": suite.name, "scenes": rows}, sort_keys=False, width=120)
    with write_whole(path) as temporary:
        temporary.write_text(text)
