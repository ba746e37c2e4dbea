"""`olt generate train`: an engine trained by one command, on given drives or on drives that it makes itself."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from olt_toolkit.commands.parallel_options import WorkersOption

if TYPE_CHECKING:
    from olt_generator.diffusion.config import EngineConfig
    from olt_generator.diffusion.training_settings import TrainingSettings
    from olt_generator.progress import Progress
    from olt_toolkit.recordings.drives import DatasetPlace

# Drives of the synthetic world on which an engine is trained that is given none.
DRIVES = """\
categories: [nominal, work_zone, cyclists, uncommon_vehicle]
seed: {seed}
count: {count}
duration: 4.0
frame_rate: 10.0
"""


def train(
    out: Annotated[Path, typer.Option(help="Folder of the run; a run that was stopped goes on.")],
    config: Annotated[str, typer.Option(help="tiny, 1.3B, or a YAML file that changes one of them.")] = "tiny",
    data: Annotated[
        Path | None,
        typer.Option(
            help="Data set whose drives have all six views and motion, or folder of a released cache; synthetic drives "
            "by default."
        ),
    ] = None,
    drives: Annotated[int, typer.Option(min=1, help="Synthetic drives of each of four kinds, without --data.")] = 40,
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
    steps: Annotated[
        int | None, typer.Option(min=1, help="Steps of the model, others than the configuration's.")
    ] = None,
    backbone: Annotated[Path | None, typer.Option(help="Folder of Wan2.1-VACE as diffusers writes it.")] = None,
    text: Annotated[
        Path | None,
        typer.Option(
            help="safetensors file with the UMT5 embeddings `prompt` and `empty`, (tokens, width), for --backbone."
        ),
    ] = None,
    workers: WorkersOption = None,
) -> None:
    """Make or read drives, warp their views, and train; the engine lies in the subfolder `engine`."""
    from olt_generator.diffusion.released_cache import ReleasedCache, is_released_cache
    from olt_generator.errors import InputError
    from olt_toolkit.clips.engine_training import Weights, train_engine, train_on_released
    from olt_toolkit.runtime.console import print_line
    from olt_toolkit.runtime.workers import default_workers

    engine, settings = read_training(config)
    if steps is not None:
        settings = replace(settings, optimizer=replace(settings.optimizer, steps=steps))
    if (backbone is None) != (text is None):
        raise InputError("--backbone and --text: give both or none")
    weights = None if backbone is None or text is None else Weights(backbone, text)
    if data is not None and is_released_cache(data):
        folder = train_on_released(ReleasedCache(data), engine, settings, out, seed, _show_stage, weights)
    else:
        place = _place_drives(data, out, drives, seed)
        folder = train_engine(place, engine, settings, out, seed, _show_stage, weights, workers or default_workers())
    print_line(f"engine: {folder}")


def read_training(config: str) -> "tuple[EngineConfig, TrainingSettings]":
    """Sizes and training of a configuration by name or file.

    A file is a mapping with `base` (a name) and what differs from it, under `engine` and `training`.

    Raises:
        InputError: there is no such name or file, or a value in it has no sense.
    """
    from pydantic import TypeAdapter, ValidationError

    from olt_generator.diffusion.config import CONFIGS, EngineConfig, find_config
    from olt_generator.diffusion.training_settings import TRAININGS, TrainingSettings
    from olt_generator.errors import InputError
    from olt_toolkit.runtime.yaml_files import read_yaml_mapping

    path = Path(config)
    if config in CONFIGS or path.suffix not in (".yaml", ".yml"):
        return find_config(config), TRAININGS[config]
    told = read_yaml_mapping(path, "training configuration", ("base", "engine", "training"))
    unknown = told.keys() - {"base", "engine", "training"}
    if unknown or told.get("base") not in CONFIGS:
        raise InputError(f"{path}: give base ({', '.join(CONFIGS)}), and engine or training where they differ")
    base = str(told["base"])
    try:
        engine = TypeAdapter(EngineConfig).validate_python(_changed(CONFIGS[base], told.get("engine", {}), path))
        training = TypeAdapter(TrainingSettings).validate_python(
            _changed(TRAININGS[base], told.get("training", {}), path)
        )
    except ValidationError as error:
        first = error.errors()[0]
        raise InputError(f"{path}: {'.'.join(str(part) for part in first['loc'])}: {first['msg']}") from error
    return engine, training


def _changed(base: Any, changes: Any, path: Path) -> dict[str, Any]:
    """The fields of a dataclass as a mapping, with changes laid over them."""
    from dataclasses import asdict, is_dataclass

    from olt_generator.errors import InputError

    fields = asdict(base)
    if not isinstance(changes, dict) or not changes.keys() <= fields.keys():
        raise InputError(f"{path}: {changes!r:.80}: give a mapping with some of {', '.join(fields)}")
    for name, value in changes.items():
        own = getattr(base, name)
        fields[name] = _changed(own, value, path) if is_dataclass(own) else value
    return fields


def _place_drives(data: Path | None, out: Path, count: int, seed: int) -> "DatasetPlace":
    from olt_generator.files import make_folder, write_whole
    from olt_toolkit.recordings.drives import DatasetPlace

    folder = make_folder(out / "drives")
    if data is not None:
        return DatasetPlace(data, folder)
    with write_whole(folder / "synthetic.yaml") as temporary:
        temporary.write_text(DRIVES.format(seed=1000 * seed, count=count))
    return DatasetPlace(folder)


@contextmanager
def _show_stage(name: str) -> "Iterator[Progress]":
    from olt_toolkit.runtime.console import show_progress

    with show_progress(name) as (on_progress, _):
        yield on_progress
