"""The toy VLA as one network, and its checkpoint: a folder with `config.json`, shards of weights and their index.

Weights stand in `model-00001-of-0000n.safetensors`, and `model.safetensors.index.json` says which tensor is in which:
the form that the public recipes read, also where one shard holds all (docs/formats/sft_recipes.md).
"""

import json
from collections.abc import Mapping
from pathlib import Path

from pydantic import ValidationError
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from olt_generator.errors import InputError
from olt_generator.files import find_whole_folder, write_whole_folder
from olt_sft_recipes.toy.action_expert import ActionExpert
from olt_sft_recipes.toy.config import ToyPolicyConfig
from olt_sft_recipes.toy.language_model import VisionLanguageModel
from olt_toolkit.runtime.json_files import read_json

CONFIG_FILE = "config.json"
INDEX_FILE = "model.safetensors.index.json"
SHARD_BYTES = 5_000_000_000
"""A shard is full at so many bytes, as transformers has it."""

_SINGLE_FILE = "model.safetensors"  # of releases before there were shards
_MOST_INDEX_BYTES = 1 << 26


class ToyModel(nn.Module):
    """The vision-language model that Stage 1 trains and the action expert that Stage 2 trains."""

    def __init__(self, config: ToyPolicyConfig) -> None:
        super().__init__()
        self.config = config
        self.vlm = VisionLanguageModel(config)
        self.expert = ActionExpert(config)


def save_model(folder: Path, model: ToyModel, shard_bytes: int = SHARD_BYTES) -> None:
    """Write a checkpoint; the folder appears whole and replaces an older one."""
    with write_whole_folder(folder) as temporary:
        write_model(temporary, model, shard_bytes)


def write_model(folder: Path, model: ToyModel, shard_bytes: int = SHARD_BYTES) -> None:
    """Write the files of a model into a folder that is being made."""
    shards = _divide({name: tensor.contiguous() for name, tensor in model.state_dict().items()}, shard_bytes)
    where = {}
    for number, shard in enumerate(shards, 1):
        file = f"model-{number:05d}-of-{len(shards):05d}.safetensors"
        save_file(shard, folder / file, metadata={"format": "pt"})
        where |= dict.fromkeys(shard, file)
    size = sum(_size(tensor) for shard in shards for tensor in shard.values())
    index = {"metadata": {"total_size": size}, "weight_map": where}
    (folder / INDEX_FILE).write_text(json.dumps(index, indent=2) + "\n")
    (folder / CONFIG_FILE).write_text(json.dumps(model.config.model_dump(), indent=2) + "\n")


def _divide(tensors: dict[str, Tensor], shard_bytes: int) -> list[dict[str, Tensor]]:
    """Shards in the order of the tensors, each as full as it may be."""
    shards: list[dict[str, Tensor]] = [{}]
    room = shard_bytes
    for name, tensor in tensors.items():
        if shards[-1] and _size(tensor) > room:
            shards.append({})
            room = shard_bytes
        shards[-1][name] = tensor
        room -= _size(tensor)
    return shards


def _size(tensor: Tensor) -> int:
    return tensor.numel() * tensor.element_size()


def read_model(folder: Path) -> ToyModel:
    """The model that `save_model` wrote.

    Raises:
        InputError: see `read_config`, `read_tensors` and `load_tensors`.
    """
    model = ToyModel(read_config(folder))
    load_tensors(model, read_tensors(folder), folder)
    return model


def read_config(folder: Path) -> ToyPolicyConfig:
    """Sizes of the model of a checkpoint.

    Raises:
        InputError: there is no valid `config.json`.
    """
    path = find_whole_folder(folder) / CONFIG_FILE
    try:
        return ToyPolicyConfig.model_validate_json(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give the folder of a trained policy") from error
    except ValidationError as error:
        raise InputError(f"{path}: not the configuration of a toy policy ({error.errors()[0]['msg']})") from error


def read_tensors(folder: Path) -> dict[str, Tensor]:
    """All tensors of a checkpoint.

    Raises:
        InputError: the weights are absent or damaged, or are not what their index says.
    """
    folder = find_whole_folder(folder)
    if not (folder / INDEX_FILE).exists() and (folder / _SINGLE_FILE).exists():
        return _read_shard(folder / _SINGLE_FILE)
    where = _read_index(folder / INDEX_FILE)
    tensors: dict[str, Tensor] = {}
    for file in sorted(set(where.values())):
        shard = _read_shard(folder / file)
        if shard.keys() != {name for name, place in where.items() if place == file}:
            raise InputError(
                f"{folder / file}: does not hold the tensors that {INDEX_FILE} says; copy the folder again"
            )
        tensors |= shard
    return tensors


def _read_index(path: Path) -> Mapping[str, str]:
    """Name of the shard by name of the tensor."""
    index = read_json(path, "index of weights", _MOST_INDEX_BYTES)
    where = index.get("weight_map") if isinstance(index, dict) else None
    if not isinstance(where, dict) or not where:
        raise InputError(f"{path}: weight_map: names no tensors; copy the folder again")
    for file in where.values():
        if not isinstance(file, str) or Path(file).name != file or not file.endswith(".safetensors"):
            raise InputError(f"{path}: weight_map: {file!r:.60} is no file of this folder; copy the folder again")
    return where


def _read_shard(path: Path) -> dict[str, Tensor]:
    try:
        return load_file(path)
    except (OSError, SafetensorError) as error:
        raise InputError(f"{path}: cannot read these weights ({error}); train the policy again") from error


def load_tensors(module: nn.Module, tensors: dict[str, Tensor], where: Path) -> None:
    """Give a module its tensors; every name and shape must match on both sides, and every number be finite.

    A loader that skips names which do not match trains on an untouched model without a word
    (docs/formats/sft_recipes.md); this one refuses.

    Raises:
        InputError: a tensor is missing, unknown, of another shape or not finite.
    """
    expected = module.state_dict()
    missing, unknown = expected.keys() - tensors.keys(), tensors.keys() - expected.keys()
    if missing or unknown:
        names = ", ".join(sorted(missing | unknown)[:3])
        raise InputError(
            f"{where}: {len(missing)} tensors are missing and {len(unknown)} unknown ({names}, ...); "
            "train the policy again"
        )
    for name, tensor in tensors.items():
        if tensor.shape != expected[name].shape:
            raise InputError(f"{where}: {name} is {tuple(tensor.shape)}, the model has {tuple(expected[name].shape)}")
        if not tensor.isfinite().all():
            raise InputError(f"{where}: {name} holds a number that is not finite; train the policy again")
    module.load_state_dict(tensors)
