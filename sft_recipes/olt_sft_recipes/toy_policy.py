"""The toy vision-language-action policy: Alpamayo's parts in small, trained in a minute on one processor core.

Read in this order: `toy_inputs` (what it sees), `image_encoder`, `language_model`, `action_expert`, `training`.
"""

import json
from pathlib import Path

import torch
from pydantic import ValidationError
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from olt_generator.errors import InputError
from olt_generator.files import write_whole_folder
from olt_sft_recipes.action_expert import ACTION_SIZE
from olt_sft_recipes.toy_config import ToyPolicyConfig
from olt_sft_recipes.toy_inputs import encode_inputs, look_at, planar_poses
from olt_sft_recipes.toy_model import ToyModel
from olt_toolkit.policy.action_space import actions_to_trajectory, estimate_initial_speed
from olt_toolkit.policy.contract import FUTURE_STEPS, Observation, PlannedTrajectory
from olt_toolkit.rigs.rig import POLICY_CAMERAS

CONFIG_FILE = "config.json"
WEIGHTS_FILE = "model.safetensors"


class ToyPolicy:
    """Drives with the toy model (contract `olt_toolkit.policy.contract.Policy`)."""

    name = "toy"
    cameras = POLICY_CAMERAS

    def __init__(self, model: ToyModel) -> None:
        self.model = model.eval().requires_grad_(False)
        self.image_size = (model.config.image_height, model.config.image_width)

    @classmethod
    def load(cls, folder: Path) -> "ToyPolicy":
        """Open a policy folder that `train_two_stages` wrote.

        Raises:
            InputError: the folder is no trained policy, or is damaged.
        """
        return cls(read_model(folder))

    def plan(self, observation: Observation) -> PlannedTrajectory:
        """Draw one plan; the same observation gives the same plan.

        Raises:
            InputError: the observation holds no images.
        """
        if observation.images is None:
            raise InputError("the toy policy drives by its cameras; the observation holds no images")
        images = look_at(observation.images, self.model.config)
        history = planar_poses(observation.history_xyz, observation.history_rotation)
        noise = torch.randn(1, FUTURE_STEPS, ACTION_SIZE, generator=torch.Generator().manual_seed(observation.seed))
        with torch.inference_mode():
            cache = self.model.cache(encode_inputs(images[None], history[None]))
            actions = self.model.expert.sample(noise, cache)[0].double().numpy()
        speed = estimate_initial_speed(observation.history_xyz, observation.history_rotation)
        return PlannedTrajectory(*actions_to_trajectory(actions, speed))


def load_toy(path: str | None) -> ToyPolicy:
    """Build the policy `toy:FOLDER` (entry point of the group `olt.policies`).

    Raises:
        InputError: no folder is given, or it is no trained policy.
    """
    if not path:
        raise InputError("policy toy: give the folder of a trained policy, toy:FOLDER; `olt sft train` makes one")
    torch.set_num_threads(1)  # sums come out the same on any number of cores
    return ToyPolicy.load(Path(path))


def save_model(folder: Path, model: ToyModel) -> None:
    """Write `config.json` and `model.safetensors`; the folder appears whole and replaces an older one."""
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
    """Sizes of the model in a checkpoint folder.

    Raises:
        InputError: there is no valid `config.json`.
    """
    path = folder / CONFIG_FILE
    try:
        return ToyPolicyConfig.model_validate_json(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give the folder of a trained policy") from error
    except ValidationError as error:
        raise InputError(f"{path}: not the configuration of a toy policy ({error.errors()[0]['msg']})") from error


def read_tensors(folder: Path) -> dict[str, Tensor]:
    """All tensors of a checkpoint folder.

    Raises:
        InputError: the weights are absent or damaged.
    """
    path = folder / WEIGHTS_FILE
    try:
        return load_file(path)
    except (OSError, SafetensorError) as error:
        raise InputError(f"{path}: cannot read these weights ({error}); train the policy again") from error


def load_tensors(module: nn.Module, tensors: dict[str, Tensor], where: Path) -> None:
    """Give a module its tensors; every name and shape must match on both sides.

    Raises:
        InputError: a tensor is missing, unknown or of another shape.
    """
    expected = module.state_dict()
    missing, unknown = expected.keys() - tensors.keys(), tensors.keys() - expected.keys()
    if missing or unknown:
        names = ", ".join(sorted(missing | unknown)[:3])
        raise InputError(f"{where}: {len(missing)} tensors are missing and {len(unknown)} unknown ({names}, ...)")
    for name, tensor in tensors.items():
        if tensor.shape != expected[name].shape:
            raise InputError(f"{where}: {name} is {tuple(tensor.shape)}, the model has {tuple(expected[name].shape)}")
    module.load_state_dict(tensors)
