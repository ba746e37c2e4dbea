"""The toy VLA as one network, and its checkpoint: a folder with `config.json` and `model.safetensors`."""

import json
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

CONFIG_FILE = "config.json"
WEIGHTS_FILE = "model.safetensors"


class ToyModel(nn.Module):
    """The vision-language model that Stage 1 trains and the action expert that Stage 2 trains."""

    def __init__(self, config: ToyPolicyConfig) -> None:
        super().__init__()
        self.config = config
        self.vlm = VisionLanguageModel(config)
        self.expert = ActionExpert(config)


def save_model(folder: Path, model: ToyModel) -> None:
    """Write a checkpoint; the folder appears whole and replaces an older one."""
    with write_whole_folder(folder) as temporary:
        save_file({name: tensor.contiguous() for name, tensor in model.state_dict().items()}, temporary / WEIGHTS_FILE)
        (temporary / CONFIG_FILE).write_text(json.dumps(model.config.model_dump(), indent=2) + "\n")


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
        InputError: the weights are absent or damaged.
    """
    path = find_whole_folder(folder) / WEIGHTS_FILE
    try:
        return load_file(path)
    except (OSError, SafetensorError) as error:
        raise InputError(f"{path}: cannot read these weights ({error}); train the policy again") from error


def load_tensors(module: nn.Module, tensors: dict[str, Tensor], where: Path) -> None:
    """Give a module its tensors; every name and shape must match on both sides.

    A loader that skips names which do not match trains on an untouched model without a word
    (docs/formats/sft_recipes.md); this one refuses.

    Raises:
        InputError: a tensor is missing, unknown or of another shape.
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
    module.load_state_dict(tensors)
