"""Settings of one stage of a public recipe: a Hydra file, the overrides that say the same, and what differs from it."""

import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Any

from olt_datasets.mixtures.training_arithmetic import TrainingStage
from olt_generator.errors import InputError
from olt_sft_recipes.launch.public_recipes import Stage
from olt_toolkit.runtime.yaml_files import read_yaml_mapping

_FOLDER = Path(str(files("olt_sft_recipes.launch")))
# What Hydra's grammar reads as a text without quotes, and a range of chunks.
_PLAIN = re.compile(r"(?!(?:true|false|null|nan|inf)$)[A-Za-z_./][\w./-]*|\d+-\d+", re.IGNORECASE)
_KEY = re.compile(r"[A-Za-z_]\w*")
_BUILTIN = _FOLDER / "stages"
# With these, steps and checkpoints would be others than a launch counts.
_UNCOUNTED = ("trainer.max_steps", "trainer.save_strategy", "trainer.dataloader_drop_last", "trainer.output_dir")


@dataclass(frozen=True)
class StageSettings:
    """One stage.

    Attributes:
        path: the file that it was read from.
        config_name: the shipped configuration that it starts from.
        groups: groups of configurations that are added to it, such as {"models@model": "ar1_5_base"}.
        values: what is set, by dotted key; a mapping whose keys hold dots is one value.
    """

    path: Path
    config_name: str
    groups: Mapping[str, str]
    values: Mapping[str, Any]

    def training(self, devices: int) -> TrainingStage:
        """How the stage divides its samples over so many devices."""
        batch, accumulation, epochs = (
            self._integer(f"trainer.{name}")
            for name in ("per_device_train_batch_size", "gradient_accumulation_steps", "num_train_epochs")
        )
        return TrainingStage(devices, batch, accumulation, epochs)

    @property
    def is_builtin(self) -> bool:
        """Whether it comes with this package, and was not given."""
        return self.path.parent == _BUILTIN

    def number(self, key: str) -> float:
        """A value that must be a number above 0; InputError names the file."""
        value = self.values.get(key)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
            raise InputError(f"{self.path}: {key} is {value!r}; write a number above 0")
        return value

    def _integer(self, key: str) -> int:
        if not isinstance(value := self.values.get(key), int) or isinstance(value, bool) or value < 1:
            raise InputError(f"{self.path}: {key} is {value!r}; write a whole number above 0")
        return value


@dataclass(frozen=True)
class Difference:
    """A key that a launch sets otherwise than the shipped recipe, whose value is None where it is not in the table."""

    key: str
    shipped: str | None
    launched: str
    reason: str


def builtin_stage_settings(policy: str, stage: Stage) -> StageSettings:
    """The settings of the paper's table."""
    return read_stage_settings(_BUILTIN / f"{policy.replace('-', '_')}_stage{stage}.yaml", stage)


def read_stage_settings(path: Path, stage: Stage) -> StageSettings:
    """Read a stage from a Hydra file: `defaults` names the shipped configuration, everything else is set in it.

    Raises:
        InputError: the file cannot be read, does not start from a shipped configuration, is of the other stage, sets
            what a launch sets itself or cannot count with, or lacks the values by which steps are counted.
    """
    content = read_yaml_mapping(path, "stage of a public recipe", ("defaults", "trainer", "model"))
    defaults = content.pop("defaults", None)
    if not isinstance(defaults, list) or not defaults or not isinstance(defaults[0], str) or "_self_" not in defaults:
        raise InputError(f"{path}: `defaults` is a list of the shipped configuration, such as sft_stage1, and _self_")
    groups: dict[str, str] = {}
    for entry in defaults[1:]:
        if entry == "_self_":
            continue
        if not isinstance(entry, dict) or not all(isinstance(name, str) for pair in entry.items() for name in pair):
            raise InputError(f"{path}: defaults: {entry!r}; write GROUP@PLACE: NAME")
        groups |= {name.removeprefix("/"): value for name, value in entry.items()}
    settings = StageSettings(path, defaults[0], groups, flatten(content, path))
    other = f"stage{3 - stage}"
    if other in settings.config_name or (stage == 1 and "model.cotrain_vlm" in settings.values):
        raise InputError(f"{path}: is a file of the other stage; give it as --{other}")
    if taken := [key for key, value in settings.values.items() if _is_taken(stage, key, value)]:
        raise InputError(
            f"{path}: {', '.join(taken)}: a launch sets this itself, or could not count its steps with it; remove it"
        )
    if stage == 2 and settings.values.get("model.cotrain_vlm") is not False:
        raise InputError(f"{path}: model.cotrain_vlm must be false: Stage 2 trains the action expert alone")
    settings.training(1)
    for key in ("trainer.learning_rate", "trainer.save_steps"):
        settings.number(key)
    return settings


def _is_taken(stage: Stage, key: str, value: Any) -> bool:
    if key == "trainer.log_level":
        return value != "info"
    if key == "trainer.deepspeed" and stage == 1:
        return value != "configs/deepspeed/zero2.json"
    prefixes = ("data.", "paths.", "hydra.", "lora.", "model.")
    return key in _UNCOUNTED or (key.startswith(prefixes) and key != "model.cotrain_vlm")


def flatten(content: Mapping[Any, Any], path: Path, prefix: str = "") -> dict[str, Any]:
    """The values of nested mappings by dotted key."""
    flat: dict[str, Any] = {}
    for key, value in content.items():
        if not isinstance(key, str) or not _KEY.fullmatch(key):
            raise InputError(f"{path}: {prefix}{key!s}: is no key of a configuration")
        if isinstance(value, dict) and not any("." in str(inner) for inner in value):
            flat |= flatten(value, path, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def shipped_values(policy: str, stage: Stage) -> dict[str, Any]:
    """What the shipped recipe sets, by dotted key, as far as a launch touches it."""
    return read_yaml_mapping(_FOLDER / "shipped.yaml", "table of shipped values", ())[f"{policy} stage {stage}"]


def find_differences(
    policy: str, stage: Stage, values: Mapping[str, Any], of_adapters: Collection[str] = ()
) -> list[Difference]:
    """Where a launch with these values, some of which adapters need, differs from the shipped recipe, and why."""
    shipped, builtin = shipped_values(policy, stage), builtin_stage_settings(policy, stage).values
    reasons = read_yaml_mapping(_FOLDER / "differences.yaml", "table of differences", ())
    differences = []
    for key, value in sorted(values.items()):
        if key not in shipped or shipped[key] != value:
            launched = to_hydra(value)
            if key in of_adapters:
                places = (f"{key} of adapters", "lora")
            elif builtin.get(key, value) == value:
                places = (f"{key}={launched}", key)
            else:
                places = ()
            reason = next((reasons[place] for place in places if place in reasons), "set in the file that was given")
            differences.append(Difference(key, to_hydra(shipped[key]) if key in shipped else None, launched, reason))
    return differences


def to_overrides(
    policy: str, stage: Stage, values: Mapping[str, Any], groups: Mapping[str, str] = MappingProxyType({})
) -> list[str]:
    """Hydra's overrides: groups first; `++` sets or adds a key that is not in the table, as the recipe has more."""
    shipped = shipped_values(policy, stage)
    of_groups = tuple(f"{group.partition('@')[2] or group}." for group in groups)
    added = [f"+{group}={name}" for group, name in groups.items()]
    return added + [
        f"{'' if key in shipped or key.startswith(of_groups) else '++'}{key}={to_hydra(value)}"
        for key, value in sorted(values.items())
    ]


def to_hydra(value: Any) -> str:
    """A value in the grammar of Hydra's overrides.

    Raises:
        InputError: a text holds `$`, which Hydra would take for an interpolation, or a control character.
    """
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, dict):
        return "{" + ",".join(f"{key}:{to_hydra(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ",".join(map(to_hydra, value)) + "]"
    text = str(value)
    if "$" in text or not text.isprintable():
        raise InputError(f"{text!r}: Hydra cannot be given this text; choose a name without $ and control characters")
    if _PLAIN.fullmatch(text):
        return text
    # Backslashes are plain, except before a quote.
    return "'" + re.sub(r"(\\*)(?='|$)", r"\1\1", text).replace("'", r"\'") + "'"
