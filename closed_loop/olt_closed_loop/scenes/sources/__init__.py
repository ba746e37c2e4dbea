"""Recorded drives of public data sets as scenes. What a recording does not say, and was assumed, a scene tells itself.

What they must hold, and what is refused: docs/formats/recorded_drives.md.

| source | recognised by |
| --- | --- |
| Argoverse 2 sensor log | a folder with `city_SE3_egovehicle.feather`, and `annotations[_with_ego].feather` in it |
| Argoverse 2 motion scenario | a folder with `scenario_*.parquet` |
| nuScenes or Waymo scenario (ScenarioNet) | a file `*.json.gz` or `*.json` |
| Waymo motion scenario | a file with `.tfrecord` in its name |
| CommonRoad scenario | a file `*.xml` |
| OpenSCENARIO scenario, OpenDRIVE road network | a file `*.xosc`, `*.xodr` |
| NuRec scene (AlpaSim) | a file `*.usdz` |

`FILE#PART` names a scenario of a file with several (Waymo), or who of a scenario is the ego (CommonRoad, OpenSCENARIO).
"""

from pathlib import Path

from olt_closed_loop.scenes.scene import Scene
from olt_generator.errors import InputError

_ENDINGS = (".json", ".json.gz", ".xml", ".xosc", ".usdz", ".xodr")
"""Of files that each hold a drive; in a folder those of the first ending that there is are its drives."""


def split_part(path: Path) -> tuple[Path, str | None]:
    """A file and what of it is meant: `FILE#PART` is that part, if there is no file of the whole name."""
    name, mark, part = path.name.rpartition("#")
    return (path.with_name(name), part) if mark and name and part and not path.exists() else (path, None)


def find_recordings(path: Path) -> list[Path]:
    """The recorded drives at a path, in alphabetical order: itself, those in the folder, or those in the file.

    Raises:
        InputError: there is none.
    """
    file, part = split_part(path)
    if not file.exists():
        raise InputError(f"{path}: no such file or folder; give a recorded drive")
    if file.is_file():
        if _is_shard(file) and part is None:
            from olt_closed_loop.scenes.sources.waymo_motion import scenario_ids

            return [file.with_name(f"{file.name}#{name}") for name in scenario_ids(file)]
        if _is_shard(file) or file.name.endswith(_ENDINGS):
            return [path]
    elif _is_sensor_log(path) or any(path.glob("scenario_*.parquet")):
        return [path]
    found = _files(path) if path.is_dir() else []
    if not found:
        pickled = path.suffix == ".pkl" or (path.is_dir() and any(path.glob("*.pkl")))
        why = "; pickles are not opened, as they can run code: write what they hold as JSON" if pickled else ""
        raise InputError(
            f"{path}: no recorded drive; give the folder of an Argoverse 2 sensor log or motion scenario, or a file of "
            f"nuScenes (.json.gz), Waymo (.tfrecord), CommonRoad (.xml), OpenSCENARIO (.xosc) or NuRec (.usdz){why}"
        )
    return found


def _files(folder: Path) -> list[Path]:
    for ending in (".json.gz", *_ENDINGS):
        if found := sorted(folder.glob(f"*{ending}")):
            return found
    shards = sorted(path for path in folder.iterdir() if path.is_file() and _is_shard(path))
    return [scenario for shard in shards for scenario in find_recordings(shard)]


def read_recording(path: Path) -> Scene:
    """Read one recorded drive as a scene.

    Raises:
        InputError: it is not a recorded drive, several of them, or damaged.
    """
    found = find_recordings(path)
    if len(found) > 1:
        raise InputError(f"{path}: holds {len(found)} recorded drives; give one of {', '.join(f.name for f in found)}")
    file, part = split_part(found[0])
    if _is_shard(file):
        from olt_closed_loop.scenes.sources.waymo_motion import read_waymo_scenario

        return read_waymo_scenario(file, part)
    if file.suffix == ".xml":
        from olt_closed_loop.scenes.sources.commonroad import read_commonroad

        return read_commonroad(file, part)
    if file.suffix == ".xosc":
        from olt_closed_loop.scenes.sources.openscenario.reading import read_openscenario

        return read_openscenario(file, part)
    if part is not None:
        raise InputError(f"{path}: {file.name} has no parts to choose from; leave #{part:.40} out")
    return _read_whole(file)


def _read_whole(path: Path) -> Scene:
    if path.suffix == ".xodr":
        from olt_closed_loop.scenes.sources.opendrive_drive import read_road_drive

        return read_road_drive(path)
    if path.suffix == ".usdz":
        from olt_closed_loop.scenes.sources.nurec import read_nurec

        return read_nurec(path)
    if path.is_file():
        from olt_closed_loop.scenes.sources.nuscenes import read_scenario

        return read_scenario(path)
    from olt_closed_loop.scenes.sources.argoverse2 import read_motion_scenario, read_sensor_log

    return read_sensor_log(path) if _is_sensor_log(path) else read_motion_scenario(path)


def _is_shard(path: Path) -> bool:
    return ".tfrecord" in path.name


def _is_sensor_log(path: Path) -> bool:
    return (path / "city_SE3_egovehicle.feather").is_file()
