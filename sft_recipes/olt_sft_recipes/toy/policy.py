"""The toy policy drives (contract `olt_toolkit.policy.contract.Policy`)."""

from dataclasses import dataclass
from pathlib import Path

import torch

from olt_generator.errors import InputError
from olt_generator.poses import Array, planar_pose
from olt_sft_recipes.toy.action_expert import ACTION_SIZE
from olt_sft_recipes.toy.checkpoint import ToyModel, read_model
from olt_sft_recipes.toy.image_encoder import Sight
from olt_sft_recipes.toy.inputs import encode_inputs, pad_route, planar_poses, select_images
from olt_sft_recipes.toy.occupancy import Occupancy
from olt_sft_recipes.toy.patience import Patience
from olt_sft_recipes.toy.plan_choice import choose_plan
from olt_sft_recipes.toy.route_line import RouteLine
from olt_toolkit.policy.action_space import actions_to_trajectory, estimate_initial_speed
from olt_toolkit.policy.contract import FUTURE_STEPS, Observation, PlannedTrajectory


@dataclass(frozen=True)
class Drawn:
    """What the policy would do, before it chooses.

    Attributes:
        xyz, rotation: (k, 64, 3) and (k, 64, 3, 3) of the plans in the rig frame, metres.
        speed: now, m/s, at least 0.
        sight: what it makes of the images.
        line: the middle of its route grid.
    """

    xyz: Array
    rotation: Array
    speed: float
    sight: Sight
    line: RouteLine

    @property
    def plans(self) -> Array:
        """The plans (k, 64, 3) as x, y in metres and yaw."""
        return planar_poses(self.xyz, self.rotation)

    def occupancy(self) -> Occupancy:
        """What the sight thinks is taken."""
        return Occupancy.of(self.sight, self.line)


class ToyPolicy:
    """Drives with the toy model."""

    name = "toy"

    def __init__(self, model: ToyModel) -> None:
        self.model = model.eval().requires_grad_(False)
        self.cameras = model.config.contract.cameras
        self.image_size = (model.config.image_height, model.config.image_width)
        self._patience = Patience()
        self._chooses = model.config.chooses_plan and bool(model.vlm.sight_taught.item())

    def reset(self, seed: int, scene: str) -> None:
        """Forget for how long it has stood."""
        self._patience = Patience()

    def plan(self, observation: Observation) -> PlannedTrajectory:
        """Draw some planned trajectories and choose one.

        Raises:
            InputError: the observation holds no images.
        """
        drawn = self.draw(observation)
        if not self._chooses:
            return PlannedTrajectory(drawn.xyz[0], drawn.rotation[0])
        way_worth = self._patience.way_worth(observation.time_us, drawn.speed)
        x, y, yaw = choose_plan(drawn.plans, drawn.speed, drawn.occupancy(), way_worth).T
        chosen = planar_pose(x, y, yaw)
        return PlannedTrajectory(chosen[:, :3, 3], chosen[:, :3, :3])

    def draw(self, observation: Observation) -> Drawn:
        """Draw the planned trajectories of an observation.

        Raises:
            InputError: the observation holds no images.
        """
        if observation.images is None:
            raise InputError("the toy policy drives by its cameras; the observation holds no images")
        config = self.model.config
        images = select_images(observation.images, config)[None]
        history = planar_poses(observation.history_xyz, observation.history_rotation)[None]
        routes = pad_route(observation.route_xy)[None]
        generator = torch.Generator().manual_seed(observation.seed)
        noise = torch.randn(config.plans_drawn, FUTURE_STEPS, ACTION_SIZE, generator=generator)
        if config.chooses_plan:
            noise[0] = 0.0  # leads to the middle of what it would do
        inputs = encode_inputs(images, history, routes, config)
        with torch.inference_mode():
            prefix = self.model.vlm.read_prefix(inputs)
            actions = self.model.expert.sample(noise, prefix.repeated(len(noise))).double().numpy()
        speed = float(estimate_initial_speed(observation.history_xyz, observation.history_rotation))
        xyz, rotation = actions_to_trajectory(actions, speed)
        return Drawn(xyz, rotation, max(speed, 0.0), prefix.sight, RouteLine.of(inputs.along[0]))


def load_toy(path: str | None) -> ToyPolicy:
    """Build the policy `toy:FOLDER` (entry point of the group `olt.policies`) from a checkpoint.

    Raises:
        InputError: no folder is given, or it is no trained policy or damaged.
    """
    if not path:
        raise InputError("policy toy: give the folder of a trained policy, toy:FOLDER; `olt sft train` makes one")
    torch.set_num_threads(1)  # sums come out the same on any number of cores
    return ToyPolicy(read_model(Path(path)))
