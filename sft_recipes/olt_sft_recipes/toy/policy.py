"""The toy policy drives (contract `olt_toolkit.policy.contract.Policy`)."""

from pathlib import Path

import torch

from olt_generator.errors import InputError
from olt_sft_recipes.toy.action_expert import ACTION_SIZE
from olt_sft_recipes.toy.checkpoint import ToyModel, read_model
from olt_sft_recipes.toy.inputs import encode_inputs, planar_poses, select_images
from olt_toolkit.policy.action_space import actions_to_trajectory, estimate_initial_speed
from olt_toolkit.policy.contract import FUTURE_STEPS, Observation, PlannedTrajectory


class ToyPolicy:
    """Drives with the toy model."""

    name = "toy"

    def __init__(self, model: ToyModel) -> None:
        self.model = model.eval().requires_grad_(False)
        self.cameras = model.config.contract.cameras
        self.image_size = (model.config.image_height, model.config.image_width)

    def reset(self, seed: int, scene: str) -> None:
        """Nothing is kept between calls."""

    def plan(self, observation: Observation) -> PlannedTrajectory:
        """Draw one planned trajectory; the same observation gives the same one.

        Raises:
            InputError: the observation holds no images.
        """
        if observation.images is None:
            raise InputError("the toy policy drives by its cameras; the observation holds no images")
        images = select_images(observation.images, self.model.config)
        history = planar_poses(observation.history_xyz, observation.history_rotation)
        noise = torch.randn(1, FUTURE_STEPS, ACTION_SIZE, generator=torch.Generator().manual_seed(observation.seed))
        with torch.inference_mode():
            cache = self.model.vlm.prefix_cache(encode_inputs(images[None], history[None]))
            actions = self.model.expert.sample(noise, cache)[0].double().numpy()
        speed = estimate_initial_speed(observation.history_xyz, observation.history_rotation)
        return PlannedTrajectory(*actions_to_trajectory(actions, speed))


def load_toy(path: str | None) -> ToyPolicy:
    """Build the policy `toy:FOLDER` (entry point of the group `olt.policies`) from a checkpoint.

    Raises:
        InputError: no folder is given, or it is no trained policy or damaged.
    """
    if not path:
        raise InputError("policy toy: give the folder of a trained policy, toy:FOLDER; `olt sft train` makes one")
    torch.set_num_threads(1)  # sums come out the same on any number of cores
    return ToyPolicy(read_model(Path(path)))
