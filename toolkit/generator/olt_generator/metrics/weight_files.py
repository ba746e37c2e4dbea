"""Tensors of trained networks, read from local files without running any code in them."""

import pickle
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from olt_generator.errors import InputError


class Weights(dict[str, Tensor]):
    """The float32 tensors of the file `path` by name; asking for one that it does not hold is an `InputError`."""

    def __init__(self, path: Path, tensors: dict[str, Tensor]) -> None:
        super().__init__(tensors)
        self.path = path

    def __missing__(self, name: str) -> Tensor:
        raise InputError(f"{self.path}: holds no tensor {name!r}; these are the weights of another network")


def read_weights(path: Path, device: str = "cpu") -> Weights:
    """Read a `.safetensors` file, or a state dictionary saved by torch, bare or under the key "state_dict".

    Raises:
        InputError: the file is missing, damaged, or holds anything but tensors.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such weights file; download it and give its path")
    try:
        if path.suffix == ".safetensors":
            tensors = load_file(path)
        else:
            tensors = torch.load(path, map_location="cpu", weights_only=True)
    except SafetensorError as error:
        raise InputError(f"{path}: not a readable safetensors file ({error}); copy or download it again") from error
    except (pickle.UnpicklingError, RuntimeError, EOFError, ValueError) as error:
        raise InputError(
            f"{path}: not a file of plain tensors; save it as safetensors or a state dictionary"
        ) from error
    if isinstance(tensors, dict) and "state_dict" in tensors:
        tensors = tensors["state_dict"]
    if not isinstance(tensors, dict) or not all(isinstance(value, Tensor) for value in tensors.values()):
        raise InputError(f"{path}: holds something else than a dictionary of tensors; save the state dictionary alone")
    return Weights(path, {name: tensor.to(device).float() for name, tensor in tensors.items()})
