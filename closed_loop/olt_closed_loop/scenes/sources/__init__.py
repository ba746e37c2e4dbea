"""Recorded drives of public data sets as scenes. What a recording does not say, and was assumed, a scene tells itself.

What they must hold, and what is refused: docs/formats/recorded_drives.md.

| source | recognised by |
| --- | --- |
| Argoverse 2 sensor log | a folder with `city_SE3_egovehicle.feather`, and `annotations[_with_ego].feather` in it |
| Argoverse 2 motion scenario | a folder with `scenario_*.parquet` |
| nuScenes scenario (ScenarioNet) | a file `*.json.gz` or `*.json`, or a folder of them |
"""

from pathlib import Path

from olt_closed_loop.scenes.scene import Scene
from olt_generator.errors import InputError


def find_recordings(path: Path) -> list[Path]:
    """The recorded drives at a path, in alphabetical order: itself, or the scenario files in the folder.

    Raises:
        InputError: there is none.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file or folder; give a recorded drive")
    if _is_scenario(path) or _is_sensor_log(path) or any(path.glob("scenario_*.parquet")):
        return [path]
    found = sorted(path.glob("*.json.gz")) or sorted(path.glob("*.json")) if path.is_dir() else []
    if not found:
        pickled = path.suffix == ".pkl" or (path.is_dir() and any(path.glob("*.pkl")))
        why = "; pickles are not opened, as they can run code: write what they hold as JSON" if pickled else ""
        raise InputError(
            f"{path}: no recorded drive; give the folder of an Argoverse 2 sensor log or motion scenario, "
            f"or a nuScenes scenario (.json.gz){why}"
        )
    return found


def read_recording(path: Path) -> Scene:
    """Read one recorded drive as a scene.

    Raises:
        InputError: it is not a recorded drive, several of them, or damaged.
    """
    found = find_recordings(path)
    if len(found) > 1:
        raise InputError(f"{path}: holds {len(found)} recorded drives; give one of {', '.join(f.name for f in found)}")
    if _is_scenario(found[0]):
        from olt_closed_loop.scenes.sources.nuscenes import read_scenario

        return read_scenario(found[0])
    from olt_closed_loop.scenes.sources.argoverse2 import read_motion_scenario, read_sensor_log

    return read_sensor_log(found[0]) if _is_sensor_log(found[0]) else read_motion_scenario(found[0])


def _is_scenario(path: Path) -> bool:
    return path.is_file() and path.name.endswith((".json", ".json.gz"))


def _is_sensor_log(path: Path) -> bool:
    return (path / "city_SE3_egovehicle.feather").is_file()
