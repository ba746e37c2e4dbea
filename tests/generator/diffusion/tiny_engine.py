"""A tiny engine with random weights that says something of all it is told, and a street to generate views of."""

from dataclasses import replace

import numpy as np
import torch

from olt_generator.cameras import FthetaCamera
from olt_generator.diffusion.backbone import build_autoencoder
from olt_generator.diffusion.conditioned_model import build_model
from olt_generator.diffusion.config import CONFIGS
from olt_generator.diffusion.engine_folder import EngineFacts, save_engine
from olt_generator.poses import camera_pose_in_rig, planar_pose
from olt_generator.seeds import make_generator
from olt_generator.trajectory import Trajectory
from olt_generator.views.backend import Target
from olt_generator.views.front_view import FrontView

FACTS = EngineFacts(CONFIGS["tiny"], 48, 32, 100_000, owns_backbone=True)
FRONT = FthetaCamera.equidistant(64, 40, 32.0, 26.0, 34.0)
SIDE = FthetaCamera.equidistant(48, 32, 24.0, 20.0, 26.0)
REAR = FthetaCamera.equidistant(48, 32, 40.0, 20.0, 26.0)
NAMES = ("cross_left_120fov", "cross_right_120fov", "rear_left_70fov", "rear_right_70fov", "rear_tele_30fov")
CROSS_LEFT, CROSS_RIGHT, REAR_LEFT, REAR_RIGHT, REAR_TELE = (f"camera_{name}" for name in NAMES)
YAWS = {CROSS_LEFT: 66.0, CROSS_RIGHT: -66.0, REAR_LEFT: 150.0, REAR_RIGHT: -150.0, REAR_TELE: 180.0}
TARGETS = {
    name: Target(REAR if "rear" in name else SIDE, camera_pose_in_rig([2.0, 0.0, 1.0], 0.0, 0.0, np.radians(yaw)))
    for name, yaw in YAWS.items()
}


def write_engine(folder, facts=FACTS, seed=0):
    """Write an engine whose zero-initialised layers say something too."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        model, autoencoder = build_model(facts.config, seed), build_autoencoder(facts.config.autoencoder)
        for parameter in model.parameters():
            if not parameter.any():
                parameter.data = 0.05 * torch.randn_like(parameter)
        prompt, empty = torch.randn(2, 3, facts.config.backbone.text_dim)
        save_engine(folder, facts, model, autoencoder, prompt, empty)
    return folder


def street(frames):
    """A front view of noise, 1 m a frame, that sees a wall 8 m away."""
    pictures = make_generator("street").integers(0, 256, (frames, FRONT.height, FRONT.width, 3), dtype=np.uint8)
    distance = np.full(pictures.shape[:3], 8.0, np.float32)
    path = Trajectory(100_000 * np.arange(frames), planar_pose(np.arange(frames, dtype=float), 0.0, 0.0))
    return FrontView(pictures, distance, path, FRONT, camera_pose_in_rig([1.7, 0.0, 1.5], 0.0, 0.0, 0.0))


def without_memory(facts=FACTS):
    """The same without a memory bank."""
    config = replace(facts.config, conditioning=replace(facts.config.conditioning, memory=False))
    return replace(facts, config=config)
